"""Figures of hysteresis loops with areas, and of frequency and damping against amplitude."""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.signal import find_peaks

from jbw.report import style
from jbw.report.measured_points import draw_free_band, draw_points, measured_points
from jbw.report.messages import figures as labels
from jbw.report.records import short
from jbw.report.result import (
    BACKBONE,
    arrays,
    branch,
    fitted_text,
    laws_of,
    level_text,
    quantiles,
    tests,
    unit_of,
)
from jbw.report.style import INK, MODEL, SOFT, Panels, band_label, draw_model, finish, panels, shade
from jbw.report.text import axis_label, length_unit, number, plain, unit_text
from jbw.results.attributes import StoredBackbone, StoredVariable

MILLI, KILO, PERCENT = 1e3, 1e3, 100.0
BAND_SDS = 5.15
"""Width of a normal variable's 99 % interval in standard deviations."""
# If slip changes the hysteretic force by less than this fraction, only the change is drawn.
LITTLE = 0.2
Curve = Float[np.ndarray, " point"]
Ring = Float[np.ndarray, " point+1"]


class Areas(NamedTuple):
    """Enclosed areas of a loop [J/kg]: lower end, median and upper end of their bands."""

    measured: Float[np.ndarray, "3"]
    model: Float[np.ndarray, "3"]


def enclosed_areas(test: xr.Dataset, ending: str = "") -> Areas | None:
    """Return a test's loop areas (suffix `_viscous`: including viscous force); None if missing."""
    names = (f"measured_area{ending}", f"model_area{ending}")
    if any(name not in test for name in names):
        return None
    return Areas(*(np.broadcast_to(np.ravel(test[name].values), 3) for name in names))


def validation_loops(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Does the model reproduce the hysteresis loops?

    Above, restoring force against displacement. Below, the same force minus the secant line of the
    measured loop, which shows how far the loop opens. The enclosed area is the energy lost in the
    joint per cycle and per unit mass.

    Panels: one column per test (2 axes per test, row by row). The secant encloses no area.
    """
    needed = ("measured_y", "measured_force", "model_y", "model_force")
    loop_tests = tests(tree, "validation/loops", *needed)
    axes, stack = style.stacks(ax, len(loop_tests), 2, height=4.6, height_ratios=[1, 1.3])
    for (upper, lower), (name, test) in zip(stack, loop_tests, strict=True):
        draw_loop(upper, test, 0.0)
        draw_loop(lower, test, secant(*arrays(test, "measured_y", "measured_force")))
        moved = f"{level_text(test)}, {number(test.attrs.get('tone_hz'))} Hz"
        style.title(upper, f"{short(plain(name))},\n{moved}", size=8)
        style.title(lower, _areas_text(enclosed_areas(test)), size=8)
    unit = plain(unit_text(unit_of(loop_tests[0][1]["measured_force"])))
    labels = (f"restoring force [{unit}]", f"less its secant [{unit}]")
    return finish(axes, ax, "displacement [mm]", labels)


def secant(y: Curve, force: Curve) -> float:
    """Return the secant stiffness of a loop, between its turning points [1/s^2]."""
    top, bottom = int(np.nanargmax(y)), int(np.nanargmin(y))
    return float((force[top] - force[bottom]) / (y[top] - y[bottom]))


def _areas_text(areas: Areas | None) -> str:
    if areas is None:
        return ""
    measured = areas.measured[1]
    text = f"area {number(MILLI * measured, digits=4)} mJ/kg,\n"
    if not measured:
        return text + f"model {number(MILLI * areas.model[1])} mJ/kg"
    low, _, high = PERCENT * (areas.model / measured - 1.0)
    low, high = (("" if x < 0 else "+") + number(x, 0.5 * (high - low)) for x in (low, high))
    return text + f"model {low} to {high} %"


def draw_loop(ax: Axes, test: xr.Dataset, slope: float) -> None:
    """Draw one test's loops and bands, minus a straight line of the given slope."""
    y, force = arrays(test, "measured_y", "measured_force")
    model_y = quantiles(test, "model_y")[1]
    if "measured_force_band" in test:
        label = labels.LOOP_BAND
        _ring(ax, y, quantiles(test, "measured_force_band") - slope * y, style.REPEATS, label)
    band = quantiles(test, "model_force") - slope * model_y
    _ring(ax, model_y, band, MODEL, style.band_label(test.attrs))
    if "measured_force_viscous" in test:
        (viscous,) = arrays(test, "measured_force_viscous")
        label = "measured, viscous force included"
        ax.plot(*closed(MILLI * y, viscous - slope * y), color=SOFT, lw=0.9, ls=":", label=label)
    ax.plot(*closed(MILLI * model_y, band[1]), color=MODEL, lw=0.9, label="median of the model")
    ax.plot(*closed(MILLI * y, force - slope * y), color=INK, lw=1.1, ls="--", label="measured")


def closed(y: Curve, force: Curve) -> tuple[Ring, Ring]:
    """Return a closed cycle of a loop: its first point is repeated at its end."""
    return np.append(y, y[0]), np.append(force, force[0])


def _ring(
    ax: Axes, y: Curve, band: Float[np.ndarray, "quantile point"], colour: str, label: str
) -> None:
    """Fill the band of a force around a loop: first its falling half, then its rising half."""
    for part, name in zip(strokes(y), (label, "_rising"), strict=True):
        shade(ax, y[part] * MILLI, band[0][part], band[2][part], colour, name, alpha=0.4)


def strokes(y: Curve) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the sample indices of the falling and of the rising half of a closed cycle."""
    turned = np.roll(np.arange(y.size), -int(np.argmax(y)))
    bottom = int(np.argmin(y[turned]))
    return turned[: bottom + 1], np.append(turned[bottom:], turned[0])


def verification_loops(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Does the model follow the force along a prescribed displacement?

    Measured loops, the model's 99 % parameter band, and the best linear spring. The energy lost is
    the work of the force over the whole record. For torsion, the figure shows torque against
    rotation.

    Panels: one per test, lowest level first.
    """
    loop_tests = tests(tree, "verification/loop", "displacement", "measured_force", "model_force")
    axes, stack = style.stacks(ax, len(loop_tests), 1, height=2.5)
    for (only,), (name, test) in zip(stack, loop_tests, strict=True):
        draw_forced_loop(only, test)
        lost = ""
        if "measured_work" in test and "model_work" in test:
            measured, (low, _, high) = arrays(test, "measured_work", "model_work")
            lost = f"lost {number(measured)} J,\n"
            lost += f"model {number(low)} to {number(high)} J"
        style.title(only, f"{short(plain(name))}, {fitted_text(test)}\n{lost}", size=8)
    turns = unit_of(loop_tests[0][1]["displacement"]) == "rad"
    labels = ("rotation [mrad]", "torque [kN m]") if turns else (
        "displacement [mm]", "restoring force [kN]"
    )  # fmt: skip
    return finish(axes, ax, labels[0], labels[1:])


def draw_forced_loop(ax: Axes, test: xr.Dataset) -> None:
    """Draw a prescribed loop: measured force, and the model's band between turning points."""
    y, force = arrays(test, "displacement", "measured_force")
    y, (low, median, high) = MILLI * y, quantiles(test, "model_force") / KILO
    for i, part in enumerate(monotone(y)):
        label = style.band_label(test.attrs) if i == 0 else "_further"
        shade(ax, y[part], low[part], high[part], MODEL, label, alpha=0.4)
    ax.plot(y, force / KILO, color=INK, lw=0.8, label="measured")
    ax.plot(y, median, color=MODEL, lw=0.9, ls="--", label="median of the model")
    if "linear_force" in test:
        ax.plot(y, test["linear_force"] / KILO, color=SOFT, lw=0.8, ls=":", label="linear spring")


def monotone(y: Curve) -> list[NDArray[np.intp]]:
    """Return slices between the main turning points of a displacement.

    Turning points that differ by less than 5 % of the whole range are ignored.
    """
    turns = [find_peaks(sign * y, prominence=0.05 * np.ptp(y))[0] for sign in (1.0, -1.0)]
    ends = [0, *np.sort(np.concatenate(turns)), y.size - 1]
    return [np.arange(a, b + 1) for a, b in pairwise(ends)]


def backbone(tree: xr.DataTree, ax: Any = None) -> Panels:
    """How do frequency and damping change as the joint slips?

    Natural frequency and equivalent damping of the identified joint against amplitude. Open symbols
    are frequency and damping of each test, from the fit of a linear oscillator without a model of
    the joint, with the standard deviation of its repeats. Dotted lines are the ends of the 99 %
    band without an assumed law, from the values of the fitted tests; the band is wide where there
    are no values. Beyond the fitted amplitudes (grey) no test checks the law.

    Panels: frequency, damping (2 axes); grey beyond the fitted amplitudes.
    """
    curve = branch(tree, BACKBONE, "frequency", "damping")
    axes = panels(ax, 1, 2, height=3.0)
    y_fitted = StoredBackbone.of(curve).y_fitted
    factor, unit = length_unit(y_fitted)
    amplitude, end = factor * arrays(curve, "amplitude")[0], factor * y_fitted
    points = measured_points(tree, curve)
    for panel, name, scale in ((axes[0, 0], "frequency", 1.0), (axes[0, 1], "damping", PERCENT)):
        band = scale * quantiles(curve, name)
        draw_model(panel, amplitude, band, holds=band_label(curve.attrs))
        draw_points(panel, points, name, factor, scale)
        draw_free_band(panel, tree, name, factor, scale)
        label = "beyond what was fitted"
        panel.axvspan(end, amplitude[-1], color=SOFT, alpha=0.15, lw=0, label=label)
        panel.set_xlim(0.0, amplitude[-1])
        panel.ticklabel_format(axis="y", useOffset=False)
    axes[0, 0].set_ylabel(axis_label("natural frequency", "Hz"))
    axes[0, 1].set_ylabel(axis_label("equivalent damping ratio", "%"))
    return finish(axes, ax, axis_label("amplitude of displacement", unit))


def draw_loops(tree: xr.DataTree, only: Axes) -> None:
    """Draw the hysteretic force of the identified joint over cycles of three amplitudes."""
    # If slip changes the force by less than a fifth, only the change is drawn.
    curve = branch(tree, BACKBONE, "loop_y", "loop_z", "loop_slip", "stuck")
    y = np.asarray(curve["loop_y"].transpose("loop", "phase"), float)
    z, slip = (
        np.asarray(curve[name].transpose("quantile", "loop", "phase"), float)[1]
        for name in ("loop_z", "loop_slip")
    )
    symbol = "α" if laws_of(tree)[:1] == ("bouc_wen",) else "K"
    small = bool(np.nanmax(np.abs(slip)) < LITTLE * np.nanmax(np.abs(z)))
    largest = float(y.max())
    factor, unit = length_unit(largest)
    # This line is Z = K y, the force without slip; the line ends slightly above the loops.
    if not small:
        stiffness, top = float(curve["stuck"].isel(quantile=1)), 1.15 * float(np.nanmax(z))
        end = min(largest, top / abs(stiffness)) if stiffness else largest
        stuck = np.array([-end, end])
        look = {"color": SOFT, "lw": 1.0, "ls": "--", "label": labels.full_stick(symbol)}
        only.plot(factor * stuck, stiffness * stuck, **look)
    for x, force, colour in zip(y, slip if small else z, style.LEVELS, strict=False):
        label = f"slipping, {number(factor * x.max())} {unit}"
        only.plot(*closed(factor * x, force), color=colour, lw=1.2, label=label)
    only.set_xlabel(axis_label("displacement y", unit))
    what = labels.taken_by_slip(symbol) if small else "hysteretic force Z"
    only.set_ylabel(axis_label(what, "N/kg"))


def amplitude_curves(tree: xr.DataTree, ax: Any = None) -> Panels:
    """How do frequency and damping depend on the amplitude?

    Points are measured from the records without a model of the joint, with their 99 % intervals.
    The bands belong to the model, and follow from the equivalent stiffness and the energy lost in
    its steady loop. If neighbouring points leave the band in the same direction, the law does not
    describe the joint.

    Panels: frequency, damping.
    """
    needed = ("measured_frequency", "measured_damping", "model_frequency", "model_damping")
    curves = branch(tree, "verification/amplitude", "measured_amplitude", *needed)
    amplitude = curves["amplitude"]
    axes = panels(ax, 1, 2, height=2.9)
    for panel, name, factor in ((axes[0, 0], "frequency", 1.0), (axes[0, 1], "damping", PERCENT)):
        draw_model(panel, amplitude, factor * quantiles(curves, f"model_{name}"), "_median")
        for i in range(curves.sizes["record"]):
            is_fitted = "fitted" not in curves or bool(curves["fitted"][i])
            x, values = curves["measured_amplitude"][i], factor * curves[f"measured_{name}"][i]
            label = "fitted records" if is_fitted else "held-out records"
            look = {"color": INK if is_fitted else style.SKY, "ms": 4, "lw": 0.7, "label": label}
            errors = curves.get(f"measured_{name}_sd")  # Runs of earlier versions lack the errors.
            reach = None if errors is None else 0.5 * BAND_SDS * factor * errors[i]
            panel.errorbar(x, values, reach, fmt=".", **look)
    axes[0, 0].set_ylabel(axis_label("frequency", "Hz"))
    axes[0, 1].set_ylabel(axis_label("damping ratio", "%"))
    response = plain(StoredVariable.of(amplitude).long_name or "response")
    return finish(axes, ax, axis_label(f"amplitude of {response}", unit_of(amplitude)))
