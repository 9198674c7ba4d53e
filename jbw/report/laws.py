"""The figure of laws side by side: what each makes of amplitude, and of runs it has not seen."""

from typing import Any

import numpy as np
import xarray as xr

from jbw.report.style import LEVELS, Panels, finish, panels, plain, shade, title

LOOKS = [(colour, dashes) for dashes in ("-", "--", ":") for colour in LEVELS]
ROW = 0.22  # height of a run's line [in]


def laws_figure(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw frequency and damping against amplitude under every law, and errors of left-out runs."""
    curves, scores = tree["curves"].to_dataset(), tree["scores"].to_dataset()
    runs = [str(run) for run in scores["run"].values] if scores.sizes["law"] else []
    rows = 3 if runs else 2
    axes = panels(ax, rows, 1, height=2.3 * 2 + (1.0 + ROW * len(runs) if runs else 0.0))
    amplitude = 1e3 * curves["amplitude"].values
    looks = dict(zip(curves["law"].values.tolist(), LOOKS, strict=False))
    for each, name, unit, scale in (
        (axes[0, 0], "frequency", "Hz", 1.0),
        (axes[1, 0], "damping", "%", 100.0),
    ):
        for law, (colour, dashes) in looks.items():
            low, middle, high = scale * curves[name].sel(law=law).values
            shade(each, amplitude, low, high, colour, "_", alpha=0.2)
            each.plot(amplitude, middle, color=colour, ls=dashes, lw=1.2, label=plain(law))
        each.axvline(1e3 * curves.attrs["y_fitted"], color="0.6", lw=0.8, ls=":")
        each.set_ylabel(f"{name} [{unit}]")
        each.set_xlabel("amplitude of the displacement [mm]")
        title(each, f"{name} under each law, with its 99 % band; dotted: the largest fitted")
    if runs:
        here = axes[2, 0]
        for i, law in enumerate(scores["law"].values.tolist()):
            places = np.arange(len(runs)) + 0.6 * (i / max(len(looks) - 1, 1) - 0.5)
            errors = 100 * scores["error"].sel(law=law).values
            here.plot(
                errors,
                places,
                "o",
                ms=4,
                color=looks[law][0],
                fillstyle="none" if looks[law][1] != "-" else "full",
            )
        here.set_yticks(range(len(runs)), [plain(run) for run in runs])
        here.set_ylim(len(runs) - 0.4, -0.6)
        here.set_xscale("log")
        here.set_xlabel("error over the response [%]")
        title(here, "runs as a fit predicts them that has not seen them")
    return finish(axes, ax)
