"""The band of the free-form law, drawn next to the backbone of a law."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from jbw.report.messages.free_law import BAND
from jbw.report.result import FREE_LAW, node
from jbw.report.style import INK


def draw_free_band(ax: Axes, tree: xr.DataTree, name: str, factor: float, scale: float) -> None:
    """Draw both ends of a 99 % band of the free-form law, within the limits of the axes.

    Nothing is drawn if a result has no such band. The band widens without limit beyond the
    readings; the limits of the axes therefore stay as they were before.
    """
    group = node(tree, FREE_LAW)
    if group is None:
        return
    limits = ax.get_ylim()
    band = scale * np.asarray(group[name].transpose("quantile", "amplitude"), float)
    x = factor * np.asarray(group["amplitude"], float)
    for end, label in ((band[0], BAND), (band[-1], "_")):
        ax.plot(x, end, color=INK, lw=0.8, ls=(0, (1, 1.5)), label=label)
    ax.set_ylim(limits)
