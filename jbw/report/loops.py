"""Measured and predicted hysteresis loops, and the areas that they enclose."""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes
from numpy.typing import NDArray

from jbw.report.records import short
from jbw.report.result import fitted_text, level_text, quantiles, tests, unit_of
from jbw.report.style import (
    BAND,
    INK,
    MODEL,
    REPEATS,
    SOFT,
    Panels,
    legend,
    plain,
    shade,
    stacks,
    title,
)
from jbw.report.text import number, unit_text

MILLI, KILO = 1e3, 1e3
BAND_SDS = 5.15
"""Width of a normal variable's 99 % interval in standard deviations."""


class Areas(NamedTuple):
    """Areas that a loop encloses, each as lower, median and upper of its 99 % band [J/kg].

    Args:
        measured: Of the measured loop; the three agree where no band is known.
        model: Of the predicted loops.
    """

    measured: tuple[float, float, float]
    model: tuple[float, float, float]


def enclosed_areas(test: xr.Dataset, ending: str = "") -> Areas | None:
    """Return the areas of a test's loops, from its variables or its attributes.

    Args:
        test: One test of the validation.
        ending: "_viscous" for the loops with the viscous force.

    Returns:
        The areas [J/kg], or None where the run did not write them.
    """
    ends = [f"model_area_{end}{ending}" for end in ("lower", "median", "upper")]
    measured, model = f"measured_area{ending}", f"model_area{ending}"
    if measured in test and model in test:
        return Areas(_three(test[measured].values), _three(test[model].values))
    if {measured, *ends} <= set(test.attrs):
        return Areas(_three(test.attrs[measured]), _three([test.attrs[end] for end in ends]))
    return None


def _three(values: Any) -> tuple[float, float, float]:
    """Return lower, median and upper; one number stands for all of them."""
    lower, median, upper = np.broadcast_to(np.asarray(values, float).reshape(-1), 3).tolist()
    return lower, median, upper


def validation_loops(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw the restoring force against displacement, and without its secant line.

    Panels: for each test a column, the force above what is left of it when the measured secant
    is taken off both loops, which leaves their areas as they are (2 axes a test, row by row).
    """
    found = tests(
        tree, "validation/loops", "measured_y", "measured_force", "model_y", "model_force"
    )
    axes, stack = stacks(ax, len(found), 2, height=4.6, height_ratios=[1, 1.3])
    for (upper, lower), (_, test) in zip(stack, found, strict=True):
        y = np.asarray(test["measured_y"], float)
        secant = _secant(y, np.asarray(test["measured_force"], float))
        _loops(upper, test, 0.0)
        _loops(lower, test, secant)
        title(upper, f"{level_text(test)}, {number(test.attrs.get('tone_hz'))} Hz")
        title(lower, _areas_text(enclosed_areas(test)), size=8)
        lower.set_xlabel("displacement [mm]")
    unit = plain(unit_text(unit_of(found[0][1]["measured_force"])))
    for upper, lower in zip(axes[::2, 0], axes[1::2, 0], strict=True):
        upper.set_ylabel(f"restoring force [{unit}]")
        lower.set_ylabel(f"less its secant [{unit}]")
    legend(axes, ax)
    return axes


def _secant(y: Float[np.ndarray, " phase"], force: Float[np.ndarray, " phase"]) -> float:
    """Return the stiffness between the turning points of a loop [1/s^2]."""
    top, bottom = int(np.nanargmax(y)), int(np.nanargmin(y))
    return float((force[top] - force[bottom]) / (y[top] - y[bottom]))


def _areas_text(areas: Areas | None) -> str:
    """Return the enclosed areas in words."""
    if areas is None:
        return ""
    measured = areas.measured[1]
    text = f"area {number(MILLI * measured, digits=4)} mJ/kg,\n"
    if not measured:
        return text + f"model {number(MILLI * areas.model[1])} mJ/kg"
    low, _, high = (100.0 * (each / measured - 1.0) for each in areas.model)
    half = 0.5 * (high - low)
    return text + f"model {_signed(low, half)} to {_signed(high, half)} %"


def _signed(value: float, sd: float) -> str:
    """Return a number to the digits of `sd`, with its sign."""
    text = number(value, sd)
    return text if value < 0 else f"+{text}"


def _loops(ax: Axes, test: xr.Dataset, secant: float) -> None:
    """Draw one test's loops and bands, less a line of slope `secant`."""
    y = np.asarray(test["measured_y"], float)
    model_y = quantiles(test, "model_y")[1]
    if "measured_force_band" in test:
        label = "99 % band of the measured loop, from ζ and gain"
        _ring(ax, y, quantiles(test, "measured_force_band") - secant * y, REPEATS, label)
    band = quantiles(test, "model_force") - secant * model_y
    _ring(ax, model_y, band, MODEL, f"{BAND} of the model")
    if "measured_force_viscous" in test:
        force = np.asarray(test["measured_force_viscous"], float) - secant * y
        _cycle(ax, y, force, color=SOFT, lw=0.9, ls=":", label="measured, viscous force included")
    _cycle(ax, model_y, band[1], color=MODEL, lw=0.9, label="median of the model")
    force = np.asarray(test["measured_force"], float) - secant * y
    _cycle(ax, y, force, color=INK, lw=1.1, ls="--", label="measured")


def _cycle(
    ax: Axes, y: Float[np.ndarray, " phase"], force: Float[np.ndarray, " phase"], **look: Any
) -> None:
    """Draw a closed loop."""
    ax.plot(np.append(y, y[0]) * MILLI, np.append(force, force[0]), **look)


def _ring(
    ax: Axes,
    y: Float[np.ndarray, " phase"],
    band: Float[np.ndarray, "quantile phase"],
    colour: str,
    label: str,
) -> None:
    """Fill a band of force around a loop, its falling and its rising half in turn."""
    for part, name in zip(strokes(y), (label, "_rising"), strict=True):
        shade(ax, y[part] * MILLI, band[0][part], band[2][part], colour, name, alpha=0.4)


def strokes(y: Float[np.ndarray, " phase"]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the samples of the falling and of the rising half of a closed cycle."""
    turned = np.roll(np.arange(y.size), -int(np.argmax(y)))
    bottom = int(np.argmin(y[turned]))
    return turned[: bottom + 1], np.append(turned[bottom:], turned[0])


def verification_loops(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw the force along a prescribed displacement, measured and of the model.

    Panels: one a test, lowest level first.
    """
    found = tests(tree, "verification/loop", "displacement", "measured_force", "model_force")
    axes, stack = stacks(ax, len(found), 1, height=2.5)
    for (only,), (name, test) in zip(stack, found, strict=True):
        _forced_loop(only, test)
        title(only, f"{short(plain(name))}, {fitted_text(test)}\n{_work(test)}", size=8)
        only.set_xlabel("displacement [mm]")
    for each in axes[:, 0]:
        each.set_ylabel("restoring force [kN]")
    legend(axes, ax)
    return axes


def _forced_loop(ax: Axes, test: xr.Dataset) -> None:
    """Draw one record of a loop, its band stretch by stretch between the turning points."""
    y = MILLI * np.asarray(test["displacement"], float)
    low, median, high = quantiles(test, "model_force") / KILO
    for i, part in enumerate(monotone(y)):
        label = f"{BAND} of the model" if i == 0 else "_further"
        shade(ax, y[part], low[part], high[part], MODEL, label, alpha=0.4)
    ax.plot(
        y, np.asarray(test["measured_force"], float) / KILO, color=INK, lw=0.8, label="measured"
    )
    ax.plot(y, median, color=MODEL, lw=0.9, ls="--", label="median of the model")
    if "linear_force" in test:
        linear = np.asarray(test["linear_force"], float) / KILO
        ax.plot(y, linear, color=SOFT, lw=0.8, ls=":", label="linear spring")


def monotone(y: Float[np.ndarray, " point"], least: float = 0.05) -> list[NDArray[np.intp]]:
    """Return the stretches between turning points farther apart than `least` of the whole range."""
    reach = least * np.ptp(y)
    ends, extreme, rising = [0], 0, None
    for i, value in enumerate(y):
        if rising is None:
            if abs(value - y[0]) > reach:
                rising, extreme = bool(value > y[0]), i
        elif (value - y[extreme] > 0) == rising:
            extreme = i
        elif abs(value - y[extreme]) > reach:
            ends.append(extreme)
            rising, extreme = not rising, i
    ends.append(len(y) - 1)
    return [np.arange(a, b + 1) for a, b in pairwise(ends) if b > a]


def _work(test: xr.Dataset) -> str:
    """Return the energy lost, measured and of the model, in words."""
    if "measured_work" not in test or "model_work" not in test:
        return ""
    low, _, high = np.asarray(test["model_work"], float)
    return f"lost {number(test['measured_work'])} J,\nmodel {number(low)} to {number(high)} J"
