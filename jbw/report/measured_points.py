"""Readings next to the model's backbone: measured points, and the band of the free-form law."""

from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes

from jbw.report.messages.free_law import BAND
from jbw.report.result import FREE_LAW, HELD_OUT, arrays, node, quantiles
from jbw.report.style import INK, SKY
from jbw.report.text import plain
from jbw.results.attributes import PredictedTest

MARKERS = "osD^v<>"  # one marker per kind of test, repeated if there are more kinds
# If the amplitudes of a test's values differ by less than this fraction of the largest amplitude,
# the values count as repeats.
ALIKE = 0.1
# relative distance from the joint's frequency, beyond which a measured frequency belongs to another
# mode
OTHER_MODE = 0.15

Values = Float[np.ndarray, " reading"]


class MeasuredPoints(NamedTuple):
    """Frequency and damping of one test: means over its records, or values along a record."""

    kind: str
    is_fitted: bool
    y: Values  # amplitude of the displacement [m]
    values: dict[str, Values]  # frequency [Hz] and damping [-]
    # standard deviation between repeats, or of the measurement; NaN if neither is known
    std: dict[str, Values]


def measured_points(tree: xr.DataTree, curve: xr.Dataset) -> list[MeasuredPoints]:
    """Return measured frequency and damping within a backbone's range, in order of motion.

    Decays and sweeps are read along the amplitudes that they pass, from the smallest amplitude of
    the curve. Other tests are read as a whole, at the mean amplitude weighted by energy, sum A^3 /
    sum A^2. Left out are readings of other modes, readings beyond the curve's largest amplitude,
    and those of drives that have a separate omega_n.
    """
    parent = node(tree, "look")
    posterior = node(tree, "posterior")
    tests = [] if parent is None else [group.to_dataset() for group in parent.children.values()]
    drawn = () if posterior is None else posterior.data_vars
    of_main_drive = [test for test in tests if f"omega_n_{test.attrs.get('drive')}" not in drawn]
    return [points for test in of_main_drive if len((points := _points(test, curve)).y)]


def _points(test: xr.Dataset, curve: xr.Dataset) -> MeasuredPoints:
    y, frequency, damping = arrays(test, "y", "frequency_hz", "damping")
    values = {"frequency": frequency, "damping": damping}
    unknown = xr.DataArray(np.full(len(y), np.nan))
    std = {name: np.asarray(test.get(f"{name}_sd", unknown), float) for name in values}
    (amplitude,), (_, model, _) = arrays(curve, "amplitude"), quantiles(curve, "frequency")
    along = len(y) > 1 and np.ptp(y) > ALIKE * y.max()
    if not along:
        if len(y) > 1:
            std = {name: np.std(samples, ddof=1, keepdims=True) for name, samples in values.items()}
        y, values = y.mean(keepdims=True), {n: x.mean(keepdims=True) for n, x in values.items()}
    near_model = np.abs(values["frequency"] / np.interp(y, amplitude, model) - 1) < OTHER_MODE
    near_model &= (y >= amplitude[0] * along) & (y <= amplitude[-1])
    return MeasuredPoints(
        PredictedTest.of(test).kind,
        PredictedTest.of(test).is_fitted,
        y[near_model],
        *(
            {name: samples[near_model] for name, samples in quantities.items()}
            for quantities in (values, std)
        ),
    )


def draw_points(
    ax: Axes, points: list[MeasuredPoints], name: str, factor: float, scale: float
) -> None:
    """Draw measured values against amplitude, with a separate open symbol per kind of test."""
    kinds = list(dict.fromkeys(reading.kind for reading in points))
    for kind, is_fitted in dict.fromkeys((reading.kind, reading.is_fitted) for reading in points):
        of_kind = [
            reading for reading in points if (reading.kind, reading.is_fitted) == (kind, is_fitted)
        ]
        x = factor * np.concatenate([reading.y for reading in of_kind])
        values, std = (
            scale * np.concatenate([quantities[name] for quantities in column])
            for column in (
                [reading.values for reading in of_kind],
                [reading.std for reading in of_kind],
            )
        )
        colour, has_std = INK if is_fitted else SKY, np.isfinite(std)
        look = {"ls": "", "color": colour, "mfc": "none", "mew": 0.9, "clip_on": False}
        marker = MARKERS[kinds.index(kind) % len(MARKERS)]
        label = plain(kind) + ("" if is_fitted else f", {HELD_OUT}")
        ax.plot(x, values, marker, ms=5 if len(x) == len(of_kind) else 3.5, label=label, **look)
        if has_std.any():
            low, high = (values - std)[has_std], (values + std)[has_std]
            ax.vlines(x[has_std], low, high, color=colour, lw=0.8, label="_scatter")


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
