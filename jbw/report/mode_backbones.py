"""The backbones of the modes of a run with several joints: bands and change of mode shapes."""

from typing import Any

import numpy as np
import xarray as xr

from jbw.errors import DataError
from jbw.report.messages import figures as labels
from jbw.report.result import arrays, branch
from jbw.report.style import (
    BAND,
    INK,
    LEVELS,
    MODEL,
    Panels,
    finish,
    panels,
    shade,
    stacks,
    title,
)
from jbw.report.text import length_unit

BACKBONES = "backbones"
ONE_LINE = 3  # number of modes that are drawn side by side
HEIGHT, HEIGHT_OF_LINE = 6.0, 5.0  # [in]


def mode_backbones(tree: xr.DataTree, ax: Any = None) -> Panels:
    r"""How do frequency, damping and shape of every mode change with amplitude?

    Bands of the posterior, where the mode shape may change with amplitude. Dashed: the same with
    the mode shape of fully stuck joints, at the medians of the posterior. If the dashed line leaves
    the band, the change of shape matters. Below, first harmonics $|q_i/q_m|$ of the other modes
    relative to the mode itself; they do not grow if the mode keeps its shape. Abscissae are
    amplitudes at the first response point, up to the largest measured amplitude.

    Panels: one column per mode, with its frequency, its equivalent damping ratio and its shape.
    """
    group = branch(tree, BACKBONES, "frequency_hz", "damping", "shape", "displacement")
    chosen = [mode for mode in group["mode"].values if _is_seen(group.sel(mode=mode))]
    if not chosen:
        raise DataError(
            "The first response point hardly moves in the modes that the tests drive, so that no "
            "backbone can be drawn at this point."
        )
    axes, columns = mode_columns(ax, len(chosen))
    for mode, column in zip(chosen, columns, strict=True):
        _draw_bands(column, group.sel(mode=mode))
        title(column[0], labels.mode_at(int(mode), _stuck_hz(group.sel(mode=mode))))
    ylabels = ("frequency [Hz]", "damping ratio [%]", labels.OVER_MODE)
    return finish(axes, ax, "", ylabels)


def _is_seen(of_mode: xr.Dataset) -> bool:
    return bool(np.isfinite(of_mode["displacement"]).all())


def _stuck_hz(of_mode: xr.Dataset) -> float:
    """Return a mode's frequency at the smallest amplitude [Hz]."""
    return float(of_mode["frequency_hz"].values[0, 1])


def _draw_bands(column: Panels, of_mode: xr.Dataset) -> None:
    (x,) = arrays(of_mode, "displacement")
    factor, unit = length_unit(float(x[-1]))
    x = factor * x
    for panel, name, quantity, scale in (
        (column[0], "frequency_hz", "frequency", 1.0),
        (column[1], "damping", "damping", 100.0),
    ):
        low, middle, high = scale * of_mode[name].values.T
        shade(panel, x, low, high, MODEL, BAND)
        other, labelled = _beside(of_mode, quantity)
        panel.plot(x, middle, color=MODEL, lw=1.2, label=labelled[0])
        panel.plot(x, scale * of_mode[other].values, color=INK, lw=1.0, ls="--", label=labelled[1])
        panel.ticklabel_format(axis="y", useOffset=False)
    for coordinate in of_mode["coordinate"].values:
        if coordinate != int(of_mode["mode"]):
            place = int(coordinate) - 1
            column[2].plot(
                x, of_mode["shape"].sel(coordinate=coordinate), lw=1.2,
                color=LEVELS[place % len(LEVELS)], label=f"mode {coordinate}",
            )  # fmt: skip
    column[2].set_yscale("log", nonpositive="mask")
    column[2].set_xlabel(labels.first_point_amplitude(unit))


def _beside(of_mode: xr.Dataset, quantity: str) -> tuple[str, tuple[str, str]]:
    """Return the name of the second curve of a mode's backbone, and the labels of both curves."""
    other = f"{quantity}_in_full_stick"
    if other in of_mode:
        return other, (labels.MEDIAN_FREE, labels.MEDIANS_STUCK)
    return f"{quantity}_at_medians", (labels.STUCK_SHAPE, labels.FREE_SHAPE)


def mode_columns(ax: Any, num_modes: int) -> tuple[Panels, list[Panels]]:
    """Return the axes of a figure with three panels per mode, and the panels of each mode."""
    if ax is not None:
        axes = panels(ax, 3, num_modes, height=HEIGHT)
        return axes, list(axes.T)
    height = HEIGHT if num_modes <= ONE_LINE else HEIGHT_OF_LINE
    axes, columns = stacks(None, num_modes, 3, height=height, sharex="col")
    for *_, lowest in columns:
        # Shared axes would have tick labels only in the last row.
        lowest.tick_params(labelbottom=True)
    return axes, [np.ravel(column) for column in columns]
