"""Curves of steady harmonics by level, forced loops and multisines against the model."""

from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from jbw.report.linear import BAND, fitted_text, level_text
from jbw.report.phase import beside, unwrapped_band
from jbw.report.result import frequency, tests
from jbw.report.style import (
    INK,
    LEVELS,
    MODEL,
    SKY,
    SOFT,
    Panels,
    legend,
    log_y,
    panels,
    plain,
    shade,
    stacks,
    title,
)
from jbw.report.sweep import short
from jbw.report.text import axis_label, number, percent

MOST_MARKS = 60
"""Measured points drawn on a curve, so that the model behind them stays visible."""
MILLI = 1e3
PERIODS = 8
KILO = 1e3
Family = list[tuple[str, xr.Dataset]]


def verification_curves(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw harmonics over frequency, a colour a level, against the model's 99 % bands.

    Panels: a column for each measured quantity and harmonic; magnitude, phase, and the distance
    of both together from the model's median over the curve's peak (3 axes a column, row by row).
    """
    columns = _columns(tests(tree, "verification/curve", "measured_magnitude", "model_magnitude"))
    axes, stack = stacks(ax, len(columns), 3, height=5.4, height_ratios=[2, 1.3, 1])
    colours = _colours_by_level([test for _, family in columns for _, test in family])
    for column, (suffix, family) in zip(stack, columns, strict=True):
        for _, test in family:
            _curve(column, test, suffix, colours[level_text(test)])
        test = family[0][1]
        values = test[f"measured_magnitude{suffix}"]
        what = plain(values.attrs.get("long_name", "response"))
        kind = plain(test.attrs.get("kind", ""))
        title(column[0], f"{what} at {suffix.removeprefix('_')}ω, {kind}".removesuffix(", "))
        log_y(column[0])
        column[0].set_ylabel(axis_label("amplitude", str(values.attrs.get("units", ""))))
        column[2].set_xlabel("frequency [Hz]")
    for row, label in ((1, "phase [°]"), (2, "off the median [%]")):
        for each in axes[row::3, 0]:
            each.set_ylabel(label)
    legend(axes, ax)
    return axes


def _colours_by_level(found: list[xr.Dataset]) -> dict[str, str]:
    """Return one colour for each level, the same in every panel."""
    levels = {level_text(test): float(test.attrs.get("level", 0.0)) for test in found}
    ordered = sorted(levels, key=lambda text: levels[text])
    return dict(zip(ordered, level_colours(len(ordered)), strict=True))


def _columns(found: Family) -> list[tuple[str, Family]]:
    """Return tests of one quantity and kind together, each harmonic by itself."""
    groups: dict[tuple[str, str, str], Family] = {}
    for name, test in found:
        for suffix in ("", "_3"):
            if f"measured_magnitude{suffix}" in test:
                key = (suffix, str(test.attrs.get("quantity")), str(test.attrs.get("kind")))
                groups.setdefault(key, []).append((name, test))
    return [(key[0], family) for key, family in sorted(groups.items())]


def level_colours(count: int) -> list[str]:
    """Return colours told apart for few levels, and a ramp from dark to light for many."""
    if count <= len(LEVELS):
        return list(LEVELS[:count])
    return [to_hex(colormaps["viridis"](x)) for x in np.linspace(0.25, 0.85, count)]


def _curve(column: Panels, test: xr.Dataset, suffix: str, colour: str) -> None:
    """Draw one curve: marks, filled where fitted; the model's band and median."""
    freq = frequency(test)
    measured = np.asarray(test[f"measured_magnitude{suffix}"], float)
    phase = np.asarray(test[f"measured_phase{suffix}"], float)
    model = _bands(test, f"model_magnitude{suffix}", "freq")
    turned = unwrapped_band(_bands(test, f"model_phase{suffix}", "freq"))
    off = np.abs(measured * np.exp(1j * phase) - model[1] * np.exp(1j * np.radians(turned[1])))
    marks = slice(None, None, -(-freq.size // MOST_MARKS))
    known = "" if "fitted" not in test.attrs else f", {fitted_text(test)}"
    fitted = bool(test.attrs.get("fitted", 1))
    look = {"color": colour, "lw": 0, "ms": 3.6, "marker": "o" if fitted else "^"}
    look |= {"mfc": colour if fitted else "none", "mew": 0.8}
    for ax, points, band in (
        (column[0], measured, model),
        (column[1], beside(phase, turned[1]), turned),
    ):
        shade(ax, freq, band[0], band[2], colour, "_band", alpha=0.18)
        ax.plot(freq, band[1], color=colour, lw=1.0, ls="-" if fitted else "--")
        ax.plot(freq[marks], points[marks], **look)
    column[0].lines[-1].set_label(f"{level_text(test)}{known}")
    column[2].plot(freq, 100.0 * off / np.nanmax(measured), color=colour, lw=1.0)
    for ax in column:
        ax.margins(x=0.02)


def _bands(test: xr.Dataset, name: str, dim: str) -> Float[np.ndarray, "quantile point"]:
    return np.asarray(test[name].transpose("quantile", dim), float)


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
    low, median, high = _bands(test, "model_force", "point") / KILO
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


def verification_multisine(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw a steady multisine's response in time and its spectrum with what models leave.

    Panels: for each test some periods around the largest response, and the spectra (2 axes a test).
    """
    found = tests(tree, "verification/multisine", "measured", "model_band", "error_spectrum")
    axes = panels(ax, len(found), 2, height=0.6 + 2.7 * len(found), width_ratios=[1, 1.35])
    for (left, right), (name, test) in zip(axes, found, strict=True):
        measured = np.asarray(test["measured"], float)
        unit = str(test["measured"].attrs.get("units", ""))
        what = plain(test.attrs.get("response", "response"))
        _largest(left, test, measured)
        _spectra(right, test)
        left.set(xlabel="time [s]", ylabel=axis_label(what, unit))
        right.set(xlabel="frequency [Hz]", ylabel=axis_label("amplitude", unit))
        title(left, f"{short(plain(name))}, {fitted_text(test)}", size=8)
        errors = f"error {percent(test.attrs.get('nrmse'), 2)}"
        for other in ("linear", "cubic"):
            if f"nrmse_{other}" in test.attrs:
                errors += f", {other} {percent(test.attrs[f'nrmse_{other}'], 2)}"
        title(right, errors, size=8)
    legend(axes, ax)
    return axes


def _largest(ax: Axes, test: xr.Dataset, measured: Float[np.ndarray, " time"]) -> None:
    """Draw the response around its largest swing."""
    crossings = max(1, np.count_nonzero(np.diff(np.signbit(measured))))
    half = int(PERIODS * measured.size / crossings)
    peak = int(np.argmax(np.abs(measured)))
    shown = slice(max(0, peak - half), peak + half)
    time = np.asarray(test["time"], float)[shown]
    low, _, high = _bands(test, "model_band", "time")[:, shown]
    shade(ax, time, low, high, MODEL, BAND, alpha=0.5)
    ax.plot(time, measured[shown], color=INK, lw=0.8, label="measured")
    ax.margins(x=0)
    ax.locator_params(axis="x", nbins=4)


def _spectra(ax: Axes, test: xr.Dataset) -> None:
    """Draw the spectra as points, since between the lines of a period there is nothing."""
    freq = frequency(test)
    for name, colour, label in (
        ("measured", INK, "measured"),
        ("linear_error", SKY, "left by a linear oscillator"),
        ("error", MODEL, "left by the model"),
    ):
        if f"{name}_spectrum" in test:
            values = np.asarray(test[f"{name}_spectrum"], float)
            ax.plot(freq, values, ".", color=colour, ms=2.5, label=label, rasterized=True)
    ax.set_yscale("log")
    ax.margins(x=0)
