"""Measured and predicted hysteresis loops."""

from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes
from numpy.typing import NDArray

from jbw.report.linear import BAND, level_text
from jbw.report.result import tests
from jbw.report.style import INK, MODEL, SOFT, Panels, legend, plain, stacks, title
from jbw.report.text import number

MM = 1e3


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
        _loop(upper, test, 0.0)
        _loop(lower, test, secant)
        tone = number(test.attrs.get("tone_hz"))
        title(upper, f"{level_text(test)}, {tone} Hz")
        title(lower, _areas(test.attrs), size=8)
        lower.set_xlabel("displacement [mm]")
    unit = plain(str(found[0][1]["measured_force"].attrs.get("units", "N/kg")))
    for upper, lower in zip(axes[::2, 0], axes[1::2, 0], strict=True):
        upper.set_ylabel(f"restoring force [{unit}]")
        lower.set_ylabel(f"less its secant [{unit}]")
    legend(axes, ax)
    return axes


def _secant(y: Float[np.ndarray, " phase"], force: Float[np.ndarray, " phase"]) -> float:
    """Return the stiffness between the turning points of a loop [1/s^2]."""
    top, bottom = int(np.nanargmax(y)), int(np.nanargmin(y))
    return float((force[top] - force[bottom]) / (y[top] - y[bottom]))


def _areas(facts: Any) -> str:
    """Return the enclosed areas in words."""
    low, high = facts.get("model_area_lower"), facts.get("model_area_upper")
    sd = None if low is None or high is None else (high - low) / 5.2
    measured = number(facts.get("measured_area"), sd)
    return f"area {measured} J/kg,\nmodel {number(low, sd)} to {number(high, sd)}"


def _loop(ax: Axes, test: xr.Dataset, secant: float) -> None:
    """Draw one test's loops, less a line of slope `secant`."""
    y = np.asarray(test["measured_y"], float)
    if "measured_force_viscous" in test:
        force = np.asarray(test["measured_force_viscous"], float) - secant * y
        look = {"color": SOFT, "lw": 0.9, "ls": ":", "label": "measured, viscous force included"}
        ax.plot(_closed(y) * MM, _closed(force), **look)
    model_y = np.asarray(test["model_y"].transpose("quantile", "phase"), float)[1]
    band = np.asarray(test["model_force"].transpose("quantile", "phase"), float)
    low, middle, high = band - secant * model_y
    for part in strokes(model_y):
        filled = ax.fill_between(
            model_y[part] * MM, low[part], high[part], color=MODEL, alpha=0.4, lw=0
        )
    filled.set_label(BAND + " of the model")
    ax.plot(
        _closed(model_y) * MM, _closed(middle), color=MODEL, lw=0.9, label="median of the model"
    )
    force = np.asarray(test["measured_force"], float) - secant * y
    ax.plot(_closed(y) * MM, _closed(force), color=INK, lw=1.1, ls="--", label="measured")


def _closed(values: Float[np.ndarray, " phase"]) -> Float[np.ndarray, " closed"]:
    """Return a cycle with its first point repeated at the end."""
    return np.append(values, values[0])


def strokes(y: Float[np.ndarray, " phase"]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the samples of the falling and of the rising half of a closed cycle."""
    turned = np.roll(np.arange(y.size), -int(np.argmax(y)))
    bottom = int(np.argmin(y[turned]))
    return turned[: bottom + 1], np.append(turned[bottom:], turned[0])
