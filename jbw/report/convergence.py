"""Whether the chains can be trusted: running means, traces and ranks."""

import textwrap
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes

from jbw.errors import DataError
from jbw.report.posterior import OPENING, THIRD_ORDER, Source
from jbw.report.result import branch, node, parameters
from jbw.report.style import LEVELS, SOFT, Panels, legend, panels, plain, title
from jbw.report.text import axis_label

BINS = 20
MOST = 12
"""Parameters drawn at most; the first are the joint's, Table 1 has the others."""


def running_means(tree: xr.DataTree, ax: Any = None) -> Panels:
    r"""Draw conv(n_s), each chain a line: H3 from Step 3, the velocity from Step 4 (2 axes).

    $$\mathrm{conv}(n) = \frac{1}{n} \sum_{i \le n} \int |H_3^i|^2\, d\omega$$

    Each line is divided by the mean of all chains' last values of its sampler.

    Reference:
        Eq. (40).
    """
    axes = panels(ax, 1, 2, height=2.9)
    drawn = [
        [_conv(each, tree, source) for source in sources]
        for each, sources in zip(axes[0], (THIRD_ORDER, OPENING), strict=True)
    ]
    if not any(any(panel) for panel in drawn):
        raise DataError("The result has no conv under any step's sample_stats.")
    title(axes[0, 0], "third-order kernel")
    title(axes[0, 1], "velocity")
    axes[0, 0].set_ylabel("conv(n) over its last mean [-]")
    for each in axes[0]:
        each.set_xlabel("draw n of a chain [-]")
    legend(axes, ax)
    return axes


def _conv(ax: Axes, tree: xr.DataTree, source: Source) -> bool:
    """Draw every chain of one sampler, thinned to what can be seen."""
    found = node(tree, f"{source.path}/sample_stats")
    if found is None or "conv" not in found.data_vars:
        return False
    conv = np.asarray(found["conv"].transpose("chain", "draw"), float)
    conv = conv / np.nanmean(conv[:, -1])
    shown = np.unique(np.linspace(0, conv.shape[1] - 1, 400).astype(int))
    look = {"color": source.colour, "ls": source.line, "lw": 0.9, "alpha": 0.8}
    ax.plot(shown + 1, conv[:, shown].T, **look)[0].set_label(source.label)
    return True


def trace_rank(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw the main posterior's traces and rank histograms, a row for each parameter.

    Panels: trace and ranks of every parameter in turn (2 axes a parameter).
    """
    found = parameters(branch(tree, "posterior"))[:MOST]
    axes = panels(ax, len(found), 2, height=0.5 + 0.85 * len(found), sharex="col")
    for (left, right), each in zip(axes, found, strict=True):
        _trace(left, each.draws)
        _ranks(right, each.draws)
        label = textwrap.fill(plain(axis_label(each.symbol, each.unit)), 15)
        left.set_ylabel(label, rotation=0, ha="right", va="center", labelpad=9, fontsize=8)
    title(axes[0, 0], "traces, one line a chain")
    title(axes[0, 1], "ranks, in twentieths of all draws")
    axes[-1, 0].set_xlabel("draw [-]")
    axes[-1, 1].set_xlabel("rank among all draws [-]")
    return axes


def _trace(ax: Axes, draws: Float[np.ndarray, "chain draw"]) -> None:
    """Draw the chains over their draws; an image, since lines this dense hide in a vector."""
    for chain, colour in zip(draws, LEVELS * len(draws), strict=False):
        ax.plot(chain, color=colour, lw=0.4, alpha=0.8, rasterized=True)
    ax.margins(x=0)
    ax.locator_params(axis="y", nbins=3)
    ax.ticklabel_format(axis="y", useOffset=False)


def _ranks(ax: Axes, draws: Float[np.ndarray, "chain draw"]) -> None:
    """Draw each chain's count in every twentieth of the pooled ranks, over the even count."""
    ranks = np.argsort(np.argsort(draws.reshape(-1), kind="stable"), kind="stable")
    even = draws.shape[1] / BINS
    for chain, colour in zip(ranks.reshape(draws.shape), LEVELS * len(draws), strict=False):
        counts, edges = np.histogram(chain, BINS, (0, draws.size))
        ax.stairs(counts / even, edges, color=colour, lw=1.0, baseline=None)
    ax.axhline(1.0, color=SOFT, lw=0.8, ls="--")
    ax.set(ylim=(0.0, max(2.0, ax.get_ylim()[1])), ylabel="share [-]")
    ax.margins(x=0)
