"""Figures of what the data show about each parameter, and of the reliability of the chains."""

import textwrap
from collections.abc import Iterable, Sequence
from itertools import chain, product
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes

from jbw.errors import DataError
from jbw.report import style
from jbw.report.messages import figures as labels
from jbw.report.result import (
    PosteriorParameter,
    branch,
    laws_of,
    node,
    of_joint,
    of_law,
    parameters,
)
from jbw.report.style import Panels, finish, panels, title
from jbw.report.text import axis_label, plain

POINTS = 400  # number of points of a density, and of a running mean
BINS = 20  # number of bins in a histogram of ranks
# largest number of parameters in a trace figure; the joint's parameters come first
MOST = 12
MOST_DRAWS = 2000  # largest number of draws in a scatter plot


class ShownPosterior(NamedTuple):
    """A posterior of the run: its place in the tree, its label and its line style."""

    path: str
    label: str
    colour: str
    line: str


THIRD_ORDER = (
    ShownPosterior("steps/third_order_paper", labels.STEP_3_PUBLISHED, style.VERMILION, "--"),
    ShownPosterior("steps/third_order_walk", "Step 3, tuned walk", style.PURPLE, "-."),
    ShownPosterior("steps/third_order_nuts", "Step 3, NUTS", style.BLUE, "-"),
)
OPENING = (
    ShownPosterior("steps/opening_paper", labels.STEP_4_PUBLISHED, style.VERMILION, "--"),
    ShownPosterior("steps/opening_nuts", labels.STEP_4_NUTS, style.BLUE, "-"),
)
JOINT = ShownPosterior("", "Step 4, all parameters", style.GREEN, "-")


def _sampled(
    tree: xr.DataTree, sources: Iterable[ShownPosterior]
) -> dict[ShownPosterior, dict[str, PosteriorParameter]]:
    """Return the sampled parameters of the joint by name, for each posterior of the run."""
    groups = {source: node(tree, f"{source.path}/posterior") for source in sources}
    by_source = {
        source: {parameter.name: parameter for parameter in of_joint(group.to_dataset())}
        for source, group in groups.items()
        if group is not None
    }
    if not any(by_source.values()):
        raise DataError(
            f"The result has no posterior of a joint from {' or '.join(s.label for s in sources)}.",
            remedy="Identify the campaign again, with all steps.",
        )
    return by_source


def _names(by_source: dict[ShownPosterior, dict[str, PosteriorParameter]]) -> list[str]:
    return [n for n in dict.fromkeys(chain(*by_source.values())) if n != "omega_n"]


def third_order_densities(tree: xr.DataTree, ax: Any = None) -> Panels:
    """What does the third-order kernel show about ζ, α and δ?

    Posterior densities relative to the prior: a value of 1 means that the data add nothing. Bars
    are 99 % intervals with their medians. Narrow peaks that differ between samplers come from
    chains that did not move, not from the data.
    """
    by_source = _sampled(tree, THIRD_ORDER)
    return _densities(by_source, _names(by_source), ax)


def opening_density(tree: xr.DataTree, ax: Axes | None = None) -> Axes:
    """What does the opening of the loop show about γ?

    Posterior density of γ relative to its prior, first with the other parameters fixed at their
    estimates, then with all of them free. The two densities differ because fixed parameters are
    treated as exactly known, although they are uncertain.
    """
    names = _names(_sampled(tree, OPENING))
    return _densities(_sampled(tree, (*OPENING, JOINT)), names[:1], ax)[0, 0]


def _densities(
    by_source: dict[ShownPosterior, dict[str, PosteriorParameter]], names: list[str], ax: Any
) -> Panels:
    axes = panels(ax, 1, len(names), height=2.9)
    for panel, name in zip(axes[0], names, strict=True):
        _density(panel, [(source, of[name]) for source, of in by_source.items() if name in of])
    return finish(axes, ax, ylabels=labels.DENSITY)


def _density(ax: Axes, posteriors: Sequence[tuple[ShownPosterior, PosteriorParameter]]) -> None:
    """Draw the densities of one parameter relative to its prior, with 99 % intervals below.

    The prior has the density 1.
    """
    draws = np.concatenate([parameter.draws.reshape(-1) for _, parameter in posteriors])
    span = (float(np.nanmin(draws)), float(np.nanmax(draws)))
    low, high = next(
        (parameter.box for _, parameter in posteriors if parameter.box is not None), span
    )
    ax.plot([low, low, high, high], [0, 1, 1, 0], color=style.SOFT, lw=1.0, ls=":", label="prior")
    top = 1.0
    for source, parameter in posteriors:
        points, density = marginal_density(parameter.draws, parameter.box)
        look = {"color": source.colour, "ls": source.line, "lw": 1.4, "label": source.label}
        ax.plot(points, density * (high - low), **look)
        top = max(top, density.max() * (high - low))
    for row, (source, parameter) in enumerate(posteriors, start=1):
        _interval(ax, parameter, source.colour, -0.055 * top * row)
    truth = next(
        (parameter.truth for _, parameter in posteriors if parameter.truth is not None), None
    )
    if truth is not None:
        ax.axvline(truth, color=style.INK, lw=1.0, label="truth of the rig")
    ax.set_ylim(-0.06 * top * (len(posteriors) + 0.8), 1.06 * top)
    ax.set_yticks([tick for tick in ax.get_yticks() if 0 <= tick <= 1.06 * top])
    ax.set_xlabel(axis_label(posteriors[0][1].symbol, posteriors[0][1].unit))
    ax.locator_params(axis="x", nbins=4)


def _interval(ax: Axes, parameter: PosteriorParameter, colour: str, height: float) -> None:
    """Draw the 99 % interval of draws as a bar below the densities, with their median."""
    low, middle, high = np.nanquantile(parameter.draws, [0.005, 0.5, 0.995])
    ax.plot([low, high], [height, height], color=colour, lw=3.0, solid_capstyle="butt", alpha=0.7)
    ax.plot(middle, height, "|", color=style.INK, ms=6)


def routes(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Do Steps 2 to 4 of the paper and the joint posterior agree?

    Medians and 99 % intervals of every parameter from each procedure, within the prior box (grey).
    Vertical lines are the true values, if they are known.
    """
    by_source = _sampled(tree, (*THIRD_ORDER, *OPENING, JOINT))
    names = _names(by_source)
    axes = panels(ax, 1, len(names), height=1.2 + 0.3 * len(by_source), sharey=True)
    for panel, name in zip(axes[0], names, strict=True):
        for row, (source, sampled) in enumerate(by_source.items()):
            if name in sampled:
                _interval(panel, sampled[name], source.colour, row)
        last = next(sampled[name] for sampled in reversed(by_source.values()) if name in sampled)
        panel.set_xlabel(axis_label(last.symbol, last.unit))
        if last.truth is not None:
            panel.axvline(last.truth, color=style.INK, lw=0.8, zorder=1.5)
        if last.box is not None:
            panel.axvspan(*last.box, color=style.SOFT, alpha=0.12, lw=0, zorder=0)
        panel.grid(False, axis="y")
        panel.locator_params(axis="x", nbins=3)
    axes[0, 0].set_yticks(range(len(by_source)), [source.label for source in by_source])
    axes[0, 0].set_ylim(len(by_source) - 0.4, -0.6)
    return axes


def ridge(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Do the data determine α and δ separately?

    Draws of α against δ. If they lie along the dashed curve, only the product α δ is determined.
    Strong sweeps that are fitted with all parameters free determine both factors.

    Panels: Step 3 in the prior box, and the joint posterior enlarged, where the run has them.
    """
    if laws_of(tree)[:1] != ("bouc_wen",):
        raise DataError("The first law of the joint does not have the parameters α and δ.")
    by_source = _sampled(tree, (*reversed(THIRD_ORDER), JOINT))
    # The first two parameters of the law form the product that weak motion determines.
    laws = {source: of_law(sampled.values()) for source, sampled in by_source.items()}
    pairs = {source: (law[0], law[1]) for source, law in laws.items() if len(law) > 1}
    third, joint = ([s for s in pairs if (s == JOINT) == is_joint] for is_joint in (False, True))
    present = [sources for sources in (third, joint) if sources]
    if not present:
        raise DataError(
            "The result has no posterior of α and δ.",
            remedy="Identify with free α and δ: fix neither in the campaign.",
        )
    axes = panels(ax, 1, len(present), height=3.4)
    for panel, sources in zip(axes[0], present, strict=True):
        for source in sources:
            _cloud(panel, source, *pairs[source])
        prior_box = labels.STEP_3_BOX
        title(panel, f"{JOINT.label}, enlarged" if sources is joint else prior_box)
        panel.locator_params(axis="x", nbins=4)
        panel.ticklabel_format(useOffset=False)
    pair = pairs.get(THIRD_ORDER[2]) or pairs.get(THIRD_ORDER[0])
    if pair is not None and pair[0].box is not None and pair[1].box is not None:
        constant = np.nanmedian(pair[0].draws * pair[1].draws)
        x = np.linspace(*pair[1].box, 200)
        label = f"{pair[0].symbol} {pair[1].symbol} = const"
        axes[0, 0].plot(x, constant / x, color=style.INK, lw=1.0, ls="--", label=label)
        axes[0, 0].set(xlim=pair[1].box, ylim=pair[0].box)
    return finish(axes, ax)


def _cloud(
    ax: Axes, source: ShownPosterior, above: PosteriorParameter, along: PosteriorParameter
) -> None:
    """Draw a scatter plot of one parameter against another, with at most `MOST_DRAWS` draws."""
    every = max(1, above.draws.size // MOST_DRAWS)
    y, x = (parameter.draws.reshape(-1)[::every] for parameter in (above, along))
    ax.plot(x, y, ".", ms=2.5, color=source.colour, alpha=0.4, mew=0, rasterized=True)
    ax.plot([], [], "o", ms=5, color=source.colour, label=source.label)
    if above.truth is not None and along.truth is not None:
        ax.plot(along.truth, above.truth, "P", ms=8, color=style.INK, mec="white", label="truth")
    ax.set_xlabel(axis_label(along.symbol, along.unit))
    ax.set_ylabel(axis_label(above.symbol, above.unit))


def marginal_density(
    draws: Float[np.ndarray, "..."], box: tuple[float, float] | None
) -> tuple[Float[np.ndarray, " point"], Float[np.ndarray, " point"]]:
    """Return the kernel density of draws, reflected at the bounds of their uniform prior."""
    # h = 0.9 min(s, IQR / 1.34) n^(-1/5): Silverman, Density Estimation (1986), eq. (3.31).
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
    # Draws are first counted in fine bins, so that the cost does not grow with points times draws.
    counts, edges = np.histogram(values, 8 * POINTS, (low - 5.0 * width, high + 5.0 * width))
    centres = 0.5 * (edges[1:] + edges[:-1])
    weights = np.exp(-0.5 * ((points[:, None] - centres) / width) ** 2)
    return points, weights @ counts / (np.asarray(draws).size * width * np.sqrt(2.0 * np.pi))


def running_means(tree: xr.DataTree, ax: Any = None) -> Panels:
    r"""Have the running means converged?

    The running mean conv(n) of Teloli et al., with one line per chain. A flat line alone proves
    little: if lines become flat at different heights, the chains have not explored the same
    posterior.

    $$\mathrm{conv}(n) = \frac{1}{n} \sum_{i \le n} \int |H_3^i|^2\, d\omega$$

    Each line is divided by the mean of all chains' last values of its sampler.

    Reference:
        Eq. (40).
    """
    axes = panels(ax, 1, 2, height=2.9)
    title(axes[0, 0], "third-order kernel")
    title(axes[0, 1], "velocity")
    for panel, source in [*product(axes[0, :1], THIRD_ORDER), *product(axes[0, 1:], OPENING)]:
        stats = node(tree, f"{source.path}/sample_stats")
        if stats is None or "conv" not in stats.data_vars:
            continue
        conv = np.asarray(stats["conv"].transpose("chain", "draw"), float)
        conv = conv / np.nanmean(conv[:, -1])
        # Lines are thinned to the resolution of the figure.
        shown = np.unique(np.linspace(0, conv.shape[1] - 1, POINTS).astype(int))
        look = {"color": source.colour, "ls": source.line, "lw": 0.9, "alpha": 0.8}
        panel.plot(shown + 1, conv[:, shown].T, **look)[0].set_label(source.label)
    if not any(panel.lines for panel in axes.flat):
        raise DataError("The result has no running mean `conv` in the sample_stats of any step.")
    return finish(axes, ax, labels.DRAW, labels.RUNNING_MEAN)


def trace_rank(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Did the chains of the main posterior mix?

    Good traces look alike and show no trend. Good ranks stay near 1 for every chain.

    Panels: trace and ranks of every parameter in turn (2 axes per parameter).
    """
    shown = parameters(branch(tree, "posterior"))[:MOST]
    axes = panels(ax, len(shown), 2, height=0.5 + 0.85 * len(shown), sharex="col")
    for (trace, rank), parameter in zip(axes, shown, strict=True):
        # Each chain's ranks among the draws of all chains are counted in twenty bins, and divided
        # by the count that uniformly distributed ranks would have.
        ranks = np.argsort(np.argsort(parameter.draws.reshape(-1), kind="stable"), kind="stable")
        chains = zip(parameter.draws, ranks.reshape(parameter.draws.shape), strict=True)
        for (draws, placed), colour in zip(
            chains, style.LEVELS * len(parameter.draws), strict=False
        ):
            # Lines are drawn as an image, because so many vector lines take long to show.
            trace.plot(draws, color=colour, lw=0.4, alpha=0.8, rasterized=True)
            counts, edges = np.histogram(placed, BINS, (0, ranks.size))
            rank.stairs(counts * BINS / draws.size, edges, color=colour, lw=1.0, baseline=None)
        trace.margins(x=0)
        trace.locator_params(axis="y", nbins=3)
        trace.ticklabel_format(axis="y", useOffset=False)
        label = textwrap.fill(plain(axis_label(parameter.symbol, parameter.unit)), 15)
        trace.set_ylabel(label, rotation=0, ha="right", va="center", labelpad=9, fontsize=8)
        rank.axhline(1.0, color=style.SOFT, lw=0.8, ls="--")
        rank.set(ylim=(0.0, max(2.0, rank.get_ylim()[1])), ylabel="share [-]")
        rank.margins(x=0)
    title(axes[0, 0], labels.TRACES)
    title(axes[0, 1], labels.RANKS)
    axes[-1, 0].set_xlabel("draw [-]")
    axes[-1, 1].set_xlabel(labels.RANK)
    return axes
