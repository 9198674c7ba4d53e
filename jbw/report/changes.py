"""Tables and figures of a changed joint: two runs compared, and monitoring record by record."""

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
import xarray as xr
from scipy.stats import t as student

from jbw.report.messages import differences as messages
from jbw.report.messages import watch
from jbw.report.sheet import Sheet
from jbw.report.style import (
    BAND,
    BLUE,
    INK,
    SKY,
    VERMILION,
    Panels,
    finish,
    panels,
    shade,
    title,
)
from jbw.report.table import Column, Table, named, table, words
from jbw.report.text import NOTHING, length_unit, number, unit_text
from jbw.report.words import Badge
from jbw.results.differences import ComparedQuantity, RunDifference, RunsSideBySide
from jbw.results.watch import WatchLine, WatchSettings

RUNS = ("A", "B")
LEAST = 1e-3  # Probabilities below this, or above 1 minus this, are stated as bounds.
QUANTITIES = {"frequency": "frequency [Hz]", "damping": "damping ratio [%]"}
LEVEL = 0.99  # probability of the band for a new record of an unchanged joint


def parameters_table(record: RunDifference) -> Table:
    """Return a table that compares the parameters and products that two runs have in common."""
    return table(
        messages.TABLE,
        record.parameters,
        named("parameter", {}),
        Column("unit", lambda row: unit_text(row.unit) or "-", align="left", spared=1),
        *_columns(),
        note="; ".join(f"{name}: {run.folder}" for name, run in record.runs.items()),
    )


def backbone_table(record: RunDifference) -> Table:
    """Return a table that compares frequency and damping of two runs at common amplitudes."""
    factor, unit = length_unit(max((row.amplitude or 0.0 for row in record.backbone), default=1.0))
    return table(
        messages.BACKBONE_TABLE,
        [_in_per_cent(row) if row.unit == "1" else row for row in record.backbone],
        Column("", lambda row: QUANTITIES[row.name], align="left"),
        Column(f"at [{unit}]", lambda row: number(factor * row.amplitude)),
        *_columns(),
    )


def side_by_side_table(record: RunsSideBySide) -> Table:
    """Return a table of runs by torque: frequency and damping at two amplitudes common to all."""
    amplitudes = sorted({row.amplitude for row in record.readings})
    factor, unit = length_unit(amplitudes[-1])
    read = {(row.run, row.amplitude): row for row in record.readings}

    def column(what: str, heading: str, amplitude: float) -> Column:
        return Column(
            f"{heading}\nat {number(factor * amplitude)} {unit}",
            lambda run: _interval(getattr(read[run.name, amplitude], what)),
        )

    return table(
        messages.SIDE_BY_SIDE.format(len(record.runs)),
        record.runs,
        words("run", "name"),
        Column("torque [N m]", lambda run: number(run.torque)),
        *(column("frequency", "frequency [Hz]", y) for y in amplitudes),
        *(column("damping", "damping [%]", y) for y in amplitudes),
    )


def side_by_side_figure(record: RunsSideBySide, bands: xr.Dataset, ax: Any = None) -> Panels:
    """Draw frequency and damping of several runs against amplitude, with one colour per run."""
    axes = panels(ax, 1, 2, height=3.2)
    amplitude = bands["amplitude"].values
    factor, unit = length_unit(float(amplitude[-1]))
    # Colours go from dark to light in the order of torque, so that they also differ in grey.
    colours = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.85, len(record.runs)))
    x = factor * amplitude
    for only, (name, label) in zip(axes[0], QUANTITIES.items(), strict=True):
        scale = 100.0 if name == "damping" else 1.0
        for run, colour in zip(record.runs, colours, strict=True):
            low, middle, high = scale * bands[name].sel(run=run.name).values
            torque = "" if run.torque is None else f", {run.torque:g} N m"
            shade(only, x, low, high, colour, "")
            only.plot(x, middle, color=colour, lw=1.2, label=f"{run.name}{torque}")
        only.set_ylabel(label)
        only.ticklabel_format(axis="y", useOffset=False)
    return finish(axes, ax, f"amplitude of displacement [{unit}]")


def _columns() -> tuple[Column, ...]:
    """Return the columns of a comparison of two runs: intervals of A, B and A - B, P(A > B)."""
    return (
        Column("A", lambda row: _interval(row.a)),
        Column("B", lambda row: _interval(row.b)),
        Column("A - B", lambda row: _interval(row.difference)),
        Column("P(A > B)", probability_text),
    )


def _interval(ends: Sequence[float]) -> str:
    low, middle, high = ends
    sd = 0.2 * (high - low)  # A 99 % interval is about five standard deviations wide.
    return f"{number(middle, sd)} [{number(low, sd)}, {number(high, sd)}]"


def probability_text(row: ComparedQuantity) -> str:
    """Format the probability P(A > B) to three digits; "prior" if data do not determine it."""
    if row.of_prior:
        return "prior"
    value = row.probability
    if value < LEAST:
        return f"< {LEAST:g}"
    if value > 1 - LEAST:
        return f"> {1 - LEAST:g}"
    # The number of draws justifies this many digits.
    return f"{value:.{2 if 0.05 < value < 0.95 else 3}f}"


def _in_per_cent(row: ComparedQuantity) -> ComparedQuantity:
    return row.replaced(
        **{key: [100 * x for x in getattr(row, key)] for key in ("a", "b", "difference")}
    )


def backbones_figure(bands: xr.Dataset, ax: Any = None) -> Any:
    """Draw frequency and damping of two runs against amplitude, with their 99 % bands."""
    axes = panels(ax, 1, 2, height=3.2)
    factor, unit = length_unit(float(bands["amplitude"][-1]))
    for only, (name, label) in zip(axes[0], QUANTITIES.items(), strict=True):
        scale = 100.0 if name == "damping" else 1.0
        for run, colour in zip(RUNS, (BLUE, VERMILION), strict=True):
            low, middle, high = scale * bands[name].sel(run=run).values
            x = factor * bands["amplitude"].values
            shade(only, x, low, high, colour, f"{run}, {BAND}")
            only.plot(x, middle, color=colour, lw=1.0)
        only.set_ylabel(label)
        only.ticklabel_format(axis="y", useOffset=False)
    return finish(axes, ax, f"amplitude of displacement [{unit}]")


def watch_figure(settings: WatchSettings, readings: Sequence[WatchLine], ax: Any = None) -> Panels:
    """Draw frequency and damping of new records, the reference band, and all alarms."""
    axes = panels(ax, 2, 1, height=4.6)
    values = np.array([reading.values[:2] for reading in readings]).reshape(-1, 2)
    values[:, 1] = 100 * np.exp(values[:, 1])
    number = np.arange(1, len(values) + 1)
    num = min(settings.reference, len(values))
    alarms = np.array([bool(reading.alarm) for reading in readings], bool)
    at = f"{settings.amplitudes[0]:g} {settings.unit}"
    for column, (panel, name) in enumerate(
        zip(axes[:, 0], ("frequency [Hz]", "damping [%]"), strict=True)
    ):
        here = values[:, column]
        if num > 1:
            middle, sd = here[:num].mean(), here[:num].std(ddof=1)
            reach = student.ppf((1 + LEVEL) / 2, num - 1) * sd * np.sqrt(1 + 1 / num)
            ends = np.array([0.5, len(values) + 0.5])
            low, high = np.full(2, middle - reach), np.full(2, middle + reach)
            shade(panel, ends, low, high, BLUE, watch.BAND, alpha=0.15)
        panel.plot(number[:num], here[:num], "o", color=SKY, ms=4, label="reference")
        panel.plot(number[num:], here[num:], "o", color=INK, ms=4, label="watched")
        panel.plot(
            number[alarms], here[alarms], "s", color=VERMILION, ms=7, mfc="none", label="alarm"
        )
        panel.set_ylabel(name)
        panel.ticklabel_format(axis="y", useOffset=False)
        title(panel, f"{name.partition(' [')[0]} at {at}")
    return finish(axes, ax, below="record")


def watch_sheet(name: str, settings: WatchSettings, readings: Sequence[WatchLine]) -> Sheet:
    """Return the page of a monitored joint: figure, statement on every alarm, table of records."""
    alarms = [reading for reading in readings if reading.alarm]
    stated = [f"{row.record}: {row.statement}" for row in alarms if row.statement]
    last = [reading.statement for reading in readings if reading.statement][-1:]
    return Sheet(
        title=f"Watch of {name}",
        subtitle=watch.heading(len(readings), settings.reference),
        caption=watch.CAPTION,
        sentences=stated or last,
        tables=[("Every record", watch_table(settings, readings))],
        status=Badge("alarm", "bad") if alarms else Badge("no alarm", "good"),
        status_words=f"{len(alarms)} of {len(readings)} records",
    )


def watch_table(settings: WatchSettings, lines: Sequence[WatchLine]) -> Table:
    """Return a table with one line per record: frequency and damping at the first amplitude."""

    def number(heading: str, read: Any, form: str) -> Column:
        def shown(line: WatchLine) -> str:
            value = read(line)
            return NOTHING if value is None else format(value, form)

        return Column(heading, shown)

    at = f"{settings.amplitudes[0]:g} {settings.unit}"
    return table(
        watch.table_title(at, settings.false_alarms),
        lines,
        number("number", lambda line: line.number, "d"),
        words("record", "record"),
        Column("role", lambda line: line.role or line.entry, align="left"),
        number("frequency [Hz]", lambda line: line.values[0] if line.values else None, ".4f"),
        number("damping [%]", _damping, ".4g"),
        number("T^2", lambda line: line.squared, ".3g"),
        number("threshold", lambda line: line.threshold, ".3g"),
        number("unchanged", lambda line: line.unchanged, ".3g"),
        words("alarm", "alarm"),
    )  # fmt: skip


def _damping(line: WatchLine) -> float | None:
    """Return the damping ratio of a monitored record at the first amplitude, in per cent."""
    return 100 * float(np.exp(line.values[1])) if line.values else None
