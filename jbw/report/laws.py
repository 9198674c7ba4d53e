"""The figure of laws side by side: what each makes of amplitude, and of runs it has not seen."""

from typing import Any

import numpy as np
import xarray as xr

from jbw.report.messages import laws as messages
from jbw.report.style import LEVELS, Panels, finish, panels, plain, shade, title

LOOKS = [(colour, dashes) for dashes in ("-", "--", ":") for colour in LEVELS]
ROW = 0.22  # height of a run's line [in]


Looks = dict[str, tuple[str, str]]


def laws_figure(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw laws side by side.

    Frequency and damping against amplitude under every law, its loop at the largest, its residual
    along one record, and the error of each run, predicted from the others.
    """
    curves, scores = tree["curves"].to_dataset(), tree["scores"].to_dataset()
    runs = [str(run) for run in scores["run"].values] if scores.sizes["law"] else []
    shapes = [name for name in ("loops", "residuals") if name in tree.children]
    shapes = [name for name in shapes if tree[name].to_dataset().data_vars]
    rows = 2 + len(shapes) + bool(runs)
    height = 2.3 * (2 + len(shapes)) + (1.0 + ROW * len(runs) if runs else 0.0)
    axes = panels(ax, rows, 1, height=height)
    looks = dict(zip(curves["law"].values.tolist(), LOOKS, strict=False))
    _against_amplitude(axes[:2, 0], curves, looks)
    for number, name in enumerate(shapes, 2):
        SHAPES[name](axes[number, 0], tree[name].to_dataset(), looks)
    if runs:
        _left_out(axes[rows - 1, 0], scores, runs, looks)
    return finish(axes, ax)


def _against_amplitude(axes: Any, curves: xr.Dataset, looks: Looks) -> None:
    amplitude = 1e3 * curves["amplitude"].values
    # A comparison of an earlier version does not say.
    hopeless = curves.get("hopeless", xr.zeros_like(curves["law"], bool))
    for panel, name, unit, scale in (
        (axes[0], "frequency", "Hz", 1.0),
        (axes[1], "damping", "%", 100.0),
    ):
        for law, (colour, dashes) in looks.items():
            low, middle, high = scale * curves[name].sel(law=law).values
            shade(panel, amplitude, low, high, colour, "_", alpha=0.2)
            label = plain(law) + (", fit alone" if hopeless.sel(law=law) else "")
            panel.plot(amplitude, middle, color=colour, ls=dashes, lw=1.2, label=label)
        panel.axvline(1e3 * curves.attrs["y_fitted"], color="0.6", lw=0.8, ls=":")
        panel.set_ylabel(f"{name} [{unit}]")
        panel.set_xlabel(messages.LABELS["amplitude"])
        title(panel, f"{name}{messages.LABELS['backbone']}")


def _loops(here: Any, loops: xr.Dataset, looks: Looks) -> None:
    y = 1e3 * loops["displacement"].values
    for law, (colour, dashes) in looks.items():
        here.plot(y, loops["force"].sel(law=law).values, color=colour, ls=dashes, lw=1.0)
    here.set_xlabel("displacement [mm]")
    here.set_ylabel(messages.LABELS["force"])
    title(here, messages.LABELS["loop"])


def _residuals(here: Any, residuals: xr.Dataset, looks: Looks) -> None:
    along = (np.arange(residuals.sizes["part"]) + 0.5) / residuals.sizes["part"]
    for law, (colour, dashes) in looks.items():
        residual = 100 * residuals["left"].sel(law=law).values
        here.plot(along, residual, color=colour, ls=dashes, lw=1.0)
    here.set_yscale("log")
    here.set_xlabel(messages.LABELS["place"])
    here.set_ylabel("residual [% of rms]")
    title(here, f"{messages.LABELS['residual']}{plain(residuals.attrs['group'])}")


SHAPES = {"loops": _loops, "residuals": _residuals}


def _left_out(here: Any, scores: xr.Dataset, runs: list[str], looks: Looks) -> None:
    laws = scores["law"].values.tolist()
    for i, law in enumerate(laws):
        heights = np.arange(len(runs)) + 0.6 * (i / max(len(looks) - 1, 1) - 0.5)
        errors = 100 * scores["error"].sel(law=law).values
        filled = "none" if looks[law][1] != "-" else "full"
        here.plot(errors, heights, "o", ms=4, color=looks[law][0], fillstyle=filled)
    heading = messages.LABELS["error"]
    if "line" in scores and np.isfinite(scores["line"].values).any():
        here.plot(100 * scores["line"].values, np.arange(len(runs)), "|", ms=12, color="0.3")
        heading += messages.LABELS["bar"]
    here.set_yticks(range(len(runs)), [plain(run) for run in runs])
    here.set_ylim(len(runs) - 0.4, -0.6)
    here.set_xscale("log")
    here.set_xlabel(messages.LABELS["error_axis"])
    title(here, heading)
