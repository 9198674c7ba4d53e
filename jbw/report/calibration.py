"""Ranks of true values among posterior draws: do they keep to the envelope of uniform ones?"""

from typing import Any

import numpy as np

from jbw.inference.calibration.record import LEVEL, Calibration, counts_below, ecdf_envelope
from jbw.report.style import BLUE, SKY, VERMILLION, Panels, legend, panels, shade, title
from jbw.report.text import number, symbol

ACROSS = 3
HEIGHT = 1.55  # of one line of panels [in]


def rank_ecdfs(found: Calibration, ax: Any = None) -> Panels:
    r"""Draw the ECDF of every quantity's ranks less that of uniform ranks, in its 99 % envelope.

    $$\hat F(i) - \frac{i}{L + 1}$$

    A slope is a bias; an S a posterior too narrow or too wide. The line is vermillion where it
    leaves the envelope.

    Args:
        found: The calibration.
        ax: One axes a quantity, or None.

    Returns:
        The axes.
    """
    count = len(found.names)
    across = count if ax is not None else min(ACROSS, count)
    lines = -(-count // across)
    axes = panels(ax, lines, across, height=0.6 + HEIGHT * lines, sharex=True, sharey=True)
    lower, upper = ecdf_envelope(len(found.ranks), found.num_ranks, LEVEL)
    even = np.arange(1, found.num_ranks + 1) / (found.num_ranks + 1)
    for each, name, ranks in zip(axes.flat, found.names, found.ranks.T, strict=False):
        ecdf = counts_below(ranks, found.num_ranks) / len(ranks)
        inside = bool(np.all((ecdf >= lower - 1e-12) & (ecdf <= upper + 1e-12)))
        shade(each, even, lower - even, upper - even, SKY, "99 % of uniform ranks, all at once")
        colour, style = (BLUE, "-") if inside else (VERMILLION, "--")
        label = "ranks, inside" if inside else "ranks, outside"
        each.step(even, ecdf - even, where="mid", color=colour, ls=style, lw=1.2, label=label)
        covered = f"holds {100 * found.coverage[name][0]:.1f} %"
        title(each, f"{named(name)}: p = {number(found.p_ecdf[name], digits=2)}, {covered}", 7.5)
    for spare in axes.flat[count:]:
        spare.set_visible(False)
    for each in axes[:, 0]:
        each.set_ylabel("ECDF difference [-]")
    for each in axes[-1]:
        each.set_xlabel("rank / L [-]")
    legend(axes, ax)
    return axes


def named(quantity: str) -> str:
    """A quantity as people read it."""
    if quantity.startswith("h3_"):
        return f"|H₃| at {quantity.removeprefix('h3_').replace('Hz', ' Hz')}"
    return symbol(quantity)
