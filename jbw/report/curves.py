"""Curves of steady harmonics by level, forced loops and multisines against the model."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.colors import to_hex

from jbw.errors import DataError
from jbw.report.records import BANDS, short
from jbw.report.result import (
    beside,
    fitted_text,
    frequency,
    level_text,
    quantiles,
    tests,
    unit_of,
    unwrapped_band,
    verified,
)
from jbw.report.style import INK, LEVELS, Panels, legend, log_y, plain, shade, stacks, title
from jbw.report.text import axis_label

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
        column[0].set_ylabel(axis_label("amplitude", unit_of(values)))
        column[2].set_xlabel("frequency [Hz]")
    for row, label in ((1, "phase [°]"), (2, "off the median [%]")):
        for each in axes[row::3, 0]:
            each.set_ylabel(label)
    legend(axes, ax)
    return axes


def verification_groups(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw tests of further kinds over their own coordinate, against the model's bands.

    Panels: one a test.

    Raises:
        DataError: If there is none.
    """
    found = [(name, test) for _, name, test in verified(tree, "axis")]
    if not found:
        raise DataError("The result has no test of a further kind.")
    axes, stack = stacks(ax, len(found), 1, height=2.5)
    for (only,), (name, test) in zip(stack, found, strict=True):
        axis = str(test.attrs["axis"])
        for _, group in test.groupby("group"):
            one = group.sortby(axis)
            place = np.asarray(one[axis], float)
            for variable, colour, label in BANDS:
                if variable in one:
                    low, _, high = quantiles(one, variable)
                    shade(only, place, low, high, colour, label, alpha=0.5)
            if "measured" in one:
                look = {"color": INK, "ms": 3, "mfc": "none"}
                only.plot(place, one["measured"], "o", label="measured", **look)
        level = level_text(test) if "level" in test.attrs else ""
        words = (short(plain(name), 32), level, fitted_text(test))
        title(only, ", ".join(filter(None, words)), size=8)
        only.locator_params(axis="x", nbins=5)
        only.set_xlabel(axis_label(plain(axis), unit_of(test[axis])))
        kind = plain(str(test.attrs.get("kind", "response")).replace("_", " "))
        only.set_ylabel(axis_label(kind, unit_of(test["model_band"])))
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
    model = quantiles(test, f"model_magnitude{suffix}")
    turned = unwrapped_band(quantiles(test, f"model_phase{suffix}"))
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
