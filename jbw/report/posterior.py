"""What the data said about each parameter, step by step and sampler by sampler."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes

from jbw.errors import DataError
from jbw.report.result import Parameter, laws_of, node, of_joint, of_law, parameter
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
from jbw.report.text import axis_label


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


def names_by(tree: xr.DataTree, sources: Iterable[Source]) -> list[str]:
    """Return the parameters of the joint that any of these routes sampled, damping first.

    Raises:
        DataError: If none of them was run.
    """
    groups = (node(tree, f"{source.path}/posterior") for source in sources)
    found = [each.name for group in groups if group is not None
             for each in of_joint(group.to_dataset())]  # fmt: skip
    if not found:
        raise DataError("The result has no posterior from this step.")
    return [name for name in dict.fromkeys(found) if name != "omega_n"]


def third_order_densities(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw prior and posterior of zeta, alpha and delta from Step 3, every sampler (3 axes)."""
    names = names_by(tree, THIRD_ORDER)
    axes = panels(ax, 1, len(names), height=2.9)
    for each, name in zip(axes[0], names, strict=True):
        _densities(each, tree, THIRD_ORDER, name)
    axes[0, 0].set_ylabel("density over prior density [-]")
    legend(axes, ax)
    return axes


def opening_density(tree: xr.DataTree, ax: Axes | None = None) -> Axes:
    """Draw prior and posterior of gamma from Step 4, alone and with all parameters free."""
    (name, *_) = names_by(tree, OPENING)
    axes = panels(ax, 1, 1, height=3.0)
    _densities(axes[0, 0], tree, (*OPENING, JOINT), name)
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
    ax.set_xlabel(axis_label(known[0][1].symbol, known[0][1].unit))
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
    """Draw the 99 % interval of each parameter by every route, the truth as a line."""
    sources = (*THIRD_ORDER, *OPENING, JOINT)
    names = names_by(tree, sources)
    present = [each for each in sources if node(tree, f"{each.path}/posterior") is not None]
    axes = panels(ax, 1, len(names), height=1.2 + 0.3 * len(present), sharey=True)
    for each, name in zip(axes[0], names, strict=True):
        _forest(each, tree, present, name)
    axes[0, 0].set_yticks(range(len(present)), [each.label for each in present])
    axes[0, 0].set_ylim(len(present) - 0.4, -0.6)
    return axes


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
        ax.set_xlabel(axis_label(shown.symbol, shown.unit))
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
    if laws_of(tree)[:1] != ("bouc_wen",):
        raise DataError("The law of this joint has no such pair of parameters.")
    third = [each for each in reversed(THIRD_ORDER) if _pair(tree, each) is not None]
    present = [each for each in (third, [JOINT] if _pair(tree, JOINT) else []) if each]
    if not present:
        raise DataError("The result has no posterior of the pair.")
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


def _constant_product(ax: Axes, stiffness: Parameter, softening: Parameter) -> None:
    """Draw the curve of the draws' median product across the prior box."""
    if stiffness.box is None or softening.box is None:
        return
    product = np.nanmedian(stiffness.draws * softening.draws)
    x = np.linspace(*softening.box, 200)
    label = f"{stiffness.symbol} {softening.symbol} = const"
    ax.plot(x, product / x, color=INK, lw=1.0, ls="--", label=label)
    ax.set(xlim=softening.box, ylim=stiffness.box)


def _pair(tree: xr.DataTree, source: Source) -> tuple[Parameter, Parameter] | None:
    """Return the two parameters of a posterior of which weak motion knows the product, or None."""
    group = node(tree, f"{source.path}/posterior")
    found = [] if group is None else of_law(group.to_dataset())
    return (found[0], found[1]) if len(found) > 1 else None


def _cloud(ax: Axes, tree: xr.DataTree, source: Source, most: int = 2000) -> None:
    """Draw one parameter of the pair against the other, `most` draws at most, and the truth."""
    pair = _pair(tree, source)
    if pair is None:
        return
    every = max(1, pair[0].draws.size // most)
    y, x = (each.draws.reshape(-1)[::every] for each in pair)
    ax.plot(x, y, ".", ms=2.5, color=source.colour, alpha=0.4, mew=0, rasterized=True)
    ax.plot([], [], "o", ms=5, color=source.colour, label=source.label)
    if pair[0].truth is not None and pair[1].truth is not None:
        ax.plot(pair[1].truth, pair[0].truth, "P", ms=8, color=INK, mec="white", label="truth")
    y_label, x_label = (axis_label(each.symbol, each.unit) for each in pair)
    ax.set(xlabel=x_label, ylabel=y_label)


POINTS = 400


def marginal_density(
    draws: Float[np.ndarray, "..."], box: tuple[float, float] | None
) -> tuple[Float[np.ndarray, " point"], Float[np.ndarray, " point"]]:
    r"""Kernel density estimate of draws, reflected at the bounds of their box.

    $$p(x) = \frac{1}{n h} \sum_i \varphi\!\left(\frac{x - x_i}{h}\right), \qquad
      h = 0.9 \min(s, \mathrm{IQR}/1.34)\, n^{-1/5}$$

    Args:
        draws: Draws [unit of the parameter]; those that are not finite are left out.
        box: Prior interval, or None for an unbounded parameter.

    Returns:
        Points [unit] and density [1/unit]; for draws that never move, a narrow peak.

    Reference:
        Silverman, Density Estimation (1986), eq. (3.31).
    """
    values = np.asarray(draws, float).reshape(-1)
    values = values[np.isfinite(values)]
    spread = np.ptp(values) or max(abs(values[0]), 1.0) * 1e-6
    quartiles = np.subtract(*np.quantile(values, [0.75, 0.25])) / 1.34
    width = 0.9 * min(filter(None, (values.std(), quartiles)), default=0.0) * values.size**-0.2
    width = max(width, spread / POINTS)
    low, high = values.min() - 4.0 * width, values.max() + 4.0 * width
    if box is not None:
        low, high = max(low, box[0]), min(high, box[1])
        values = np.concatenate([values, 2.0 * box[0] - values, 2.0 * box[1] - values])
    points = np.linspace(low, high, POINTS)
    # Draws are counted in fine cells first: the cost no longer grows with points times draws.
    counts, edges = np.histogram(values, 8 * POINTS, (low - 5.0 * width, high + 5.0 * width))
    centres = 0.5 * (edges[1:] + edges[:-1])
    weights = np.exp(-0.5 * ((points[:, None] - centres) / width) ** 2)
    return points, weights @ counts / (np.asarray(draws).size * width * np.sqrt(2.0 * np.pi))
