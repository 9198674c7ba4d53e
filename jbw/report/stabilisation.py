"""The stabilisation diagram of Step 2 with several modes."""

from typing import Any

import numpy as np
import xarray as xr

from jbw.report.result import branch, frequency, unit_of
from jbw.report.style import INK, MODEL, SOFT, Panels, finish, log_y, panels, title
from jbw.report.text import axis_label, number

TURN = 2 * np.pi


def diagram(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Which modes does the band hold?

    Poles of fractions of rising order, those that the order before has too filled; below it the
    measured frequency response with the fit of the modes. A mode is a column of filled points that
    goes up to the top; what noise makes moves from order to order.

    Panels: the diagram, and the magnitude (2 axes).
    """
    modes = branch(tree, "modes", "omega", "zeta", "h_magnitude", "fit_magnitude", "pole_order")
    axes = panels(ax, 2, 1, height=4.6, sharex=True, height_ratios=[1.2, 1])
    upper, lower = axes[:, 0]
    freq, order = np.asarray(modes["pole_omega"]) / TURN, np.asarray(modes["pole_order"])
    stable = np.asarray(modes["pole_is_stable"], bool)
    look = {"lw": 0, "marker": "o", "ms": 3.4, "mew": 0.7}
    upper.plot(freq[~stable], order[~stable], color=SOFT, mfc="none", label="pole", **look)
    upper.plot(freq[stable], order[stable], color=INK, label="pole that stays", **look)
    lower.plot(frequency(modes), modes["h_magnitude"], color=INK, lw=0.9, label="measured")
    fit = {"color": MODEL, "lw": 3.0, "alpha": 0.6, "zorder": 1.5, "label": "fit of the modes"}
    lower.plot(frequency(modes), modes["fit_magnitude"], **fit)
    for natural_frequency in np.asarray(modes["omega"]) / TURN:
        for panel in (upper, lower):
            panel.axvline(natural_frequency, color=MODEL, lw=0.8, ls=":")
    log_y(lower)
    modes_fitted = (
        f"{number(omega / TURN, digits=4)} Hz ({number(100 * zeta, digits=2)} %)"
        for omega, zeta in zip(modes["omega"].values, modes["zeta"].values, strict=True)
    )
    title(upper, f"modes fitted: {', '.join(modes_fitted)}")
    receptance = axis_label("receptance", unit_of(modes["h_magnitude"]))
    return finish(axes, ax, "frequency [Hz]", ("order [-]", receptance))
