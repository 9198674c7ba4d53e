"""What the data said about each parameter, step by step and sampler by sampler."""

# Greek letters and the true minus sign are meant.
# ruff: noqa: RUF001

from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from jbw.errors import DataError
from jbw.report.density import marginal_density
from jbw.report.result import Parameter, parameter
from jbw.report.style import (
    BLUE,
    GREEN,
    INK,
    PURPLE,
    SOFT,
    VERMILLION,
    Panels,
    legend,
    panels,
    title,
)
from jbw.report.text import axis_label, symbol


class Source(NamedTuple):
    """One posterior of the run: where it lies and how it is drawn."""

    path: str
    label: str
    colour: str
    line: str


THIRD_ORDER = (
    Source("steps/third_order_paper", "Step 3, walk as published", VERMILLION, "--"),
    Source("steps/third_order_walk", "Step 3, tuned walk", PURPLE, "-."),
    Source("steps/third_order_nuts", "Step 3, NUTS", BLUE, "-"),
)
OPENING = (
    Source("steps/opening_paper", "Step 4, γ alone, walk as published", VERMILLION, "--"),
    Source("steps/opening_nuts", "Step 4, γ alone, NUTS", BLUE, "-"),
)
JOINT = Source("", "Step 4, all parameters", GREEN, "-")


def third_order_densities(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw prior and posterior of zeta, alpha and delta from Step 3, every sampler (3 axes)."""
    axes = panels(ax, 1, 3, height=2.9)
    for each, name in zip(axes[0], ("zeta", "alpha", "delta"), strict=True):
        _densities(each, tree, THIRD_ORDER, name)
    axes[0, 0].set_ylabel("density over prior density [-]")
    legend(axes, ax)
    return axes


def opening_density(tree: xr.DataTree, ax: Axes | None = None) -> Axes:
    """Draw prior and posterior of gamma from Step 4, alone and with all parameters free."""
    axes = panels(ax, 1, 1, height=3.0)
    _densities(axes[0, 0], tree, (*OPENING, JOINT), "gamma")
    axes[0, 0].set_ylabel("density over prior density [-]")
    legend(axes, ax)
    return axes[0, 0]


def _densities(ax: Axes, tree: xr.DataTree, sources: tuple[Source, ...], name: str) -> None:
    """Draw one parameter: the prior as 1, each posterior over it, 99 % intervals below."""
    found = [(each, parameter(tree, f"{each.path}/posterior", name)) for each in sources]
    known = [(source, each) for source, each in found if each is not None]
    if not known:
        raise DataError(f"The result has no posterior of {name} from this step.")
    boxes = [each.box for _, each in known if each.box is not None]
    low, high = boxes[0] if boxes else _reach(known)
    ax.plot([low, low, high, high], [0, 1, 1, 0], color=SOFT, lw=1.0, ls=":", label="prior")
    top = 1.0
    for source, each in known:
        points, density = marginal_density(each.draws, each.box)
        look = {"color": source.colour, "ls": source.line, "lw": 1.4, "label": source.label}
        ax.plot(points, density * (high - low), **look)
        top = max(top, density.max() * (high - low))
    for row, (source, each) in enumerate(known, start=1):
        _interval(ax, each, source.colour, -0.055 * top * row)
    truth = next((each.truth for _, each in known if each.truth is not None), None)
    if truth is not None:
        ax.axvline(truth, color=INK, lw=1.0, label="truth of the rig")
    ax.set_ylim(-0.06 * top * (len(known) + 0.8), 1.06 * top)
    ax.set_yticks([tick for tick in ax.get_yticks() if 0 <= tick <= 1.06 * top])
    ax.set_xlabel(axis_label(symbol(name), known[0][1].unit))
    ax.locator_params(axis="x", nbins=4)


def _reach(known: list[tuple[Source, Parameter]]) -> tuple[float, float]:
    """Return the interval that all draws span, for parameters without a box."""
    draws = np.concatenate([each.draws.reshape(-1) for _, each in known])
    return float(np.nanmin(draws)), float(np.nanmax(draws))


def _interval(ax: Axes, each: Parameter, colour: str, height: float) -> None:
    """Draw the 99 % interval and the median of draws as a bar below the densities."""
    low, middle, high = np.nanquantile(each.draws, [0.005, 0.5, 0.995])
    ax.plot([low, high], [height, height], color=colour, lw=3.0, solid_capstyle="butt", alpha=0.7)
    ax.plot(middle, height, "|", color=INK, ms=6)


def routes(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw the 99 % interval of each parameter by every route, the truth as a line (4 axes)."""
    sources = (*THIRD_ORDER, *OPENING, JOINT)
    present = [each for each in sources if _any(tree, each)]
    if not present:
        raise DataError("The result has no posterior at all.")
    axes = panels(ax, 1, 4, height=1.2 + 0.3 * len(present), sharey=True)
    for each, name in zip(axes[0], ("zeta", "alpha", "delta", "gamma"), strict=True):
        _forest(each, tree, present, name)
    axes[0, 0].set_yticks(range(len(present)), [each.label for each in present])
    axes[0, 0].set_ylim(len(present) - 0.4, -0.6)
    return axes


def _any(tree: xr.DataTree, source: Source) -> bool:
    """Tell whether a posterior holds any of the joint's parameters."""
    names = ("zeta", "alpha", "delta", "gamma")
    return any(parameter(tree, f"{source.path}/posterior", name) for name in names)


def _forest(ax: Axes, tree: xr.DataTree, sources: list[Source], name: str) -> None:
    """Draw one parameter's intervals, a row for each route that has it."""
    shown: Parameter | None = None
    for row, source in enumerate(sources):
        each = parameter(tree, f"{source.path}/posterior", name)
        if each is None:
            continue
        _interval(ax, each, source.colour, row)
        shown = each
    if shown is not None:
        ax.set_xlabel(axis_label(symbol(name), shown.unit))
        if shown.truth is not None:
            ax.axvline(shown.truth, color=INK, lw=0.8, zorder=1.5)
        if shown.box is not None:
            ax.axvspan(*shown.box, color=SOFT, alpha=0.12, lw=0, zorder=0)
    ax.grid(False, axis="y")
    ax.locator_params(axis="x", nbins=3)


def ridge(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw alpha against delta: Step 3 with the curve alpha delta = const, and all together.

    Panels: Step 3 in the prior box, the joint posterior at its own scale (2 axes; 1 where the run
    has but one of them).
    """
    third = [each for each in reversed(THIRD_ORDER) if _pair(tree, each) is not None]
    present = [each for each in (third, [JOINT] if _pair(tree, JOINT) else []) if each]
    if not present:
        raise DataError("The result has no posterior of alpha and delta.")
    axes = panels(ax, 1, len(present), height=3.4)
    for each, sources in zip(axes[0], present, strict=True):
        for source in sources:
            _cloud(each, tree, source)
        alone = sources == [JOINT]
        title(each, JOINT.label + ", enlarged" if alone else "Step 3, within the prior box")
        each.locator_params(axis="x", nbins=4)
        each.ticklabel_format(useOffset=False)
    pair = _pair(tree, THIRD_ORDER[2]) or _pair(tree, THIRD_ORDER[0])
    if pair is not None:
        _constant_product(axes[0, 0], *pair)
    legend(axes, ax)
    return axes


def _constant_product(ax: Axes, alpha: Parameter, delta: Parameter) -> None:
    """Draw the curve of the draws' median alpha delta across the prior box."""
    if alpha.box is None or delta.box is None:
        return
    product = np.nanmedian(alpha.draws * delta.draws)
    x = np.linspace(*delta.box, 200)
    ax.plot(x, product / x, color=INK, lw=1.0, ls="--", label="α δ = const")
    ax.set(xlim=delta.box, ylim=alpha.box)


def _pair(tree: xr.DataTree, source: Source) -> tuple[Parameter, Parameter] | None:
    """Return alpha and delta of a posterior, or None."""
    alpha, delta = (
        parameter(tree, f"{source.path}/posterior", name) for name in ("alpha", "delta")
    )
    return None if alpha is None or delta is None else (alpha, delta)


def _cloud(ax: Axes, tree: xr.DataTree, source: Source, most: int = 2000) -> None:
    """Draw the draws of alpha against delta, `most` at most, and the truth."""
    pair = _pair(tree, source)
    if pair is None:
        return
    alpha, delta = pair
    every = max(1, alpha.draws.size // most)
    x, y = delta.draws.reshape(-1)[::every], alpha.draws.reshape(-1)[::every]
    ax.plot(x, y, ".", ms=2.5, color=source.colour, alpha=0.4, mew=0, rasterized=True)
    ax.plot([], [], "o", ms=5, color=source.colour, label=source.label)
    if alpha.truth is not None and delta.truth is not None:
        ax.plot(delta.truth, alpha.truth, "P", ms=8, color=INK, mec="white", label="truth")
    ax.set(xlabel=axis_label("δ", delta.unit), ylabel=axis_label("α", alpha.unit))
