"""Figure, page and tables of a fleet: its units, their population, and a new unit."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from jbw.inference.posterior.quantiles import HALF_99
from jbw.report.messages import population as messages
from jbw.report.sheet import Sheet
from jbw.report.style import BLUE, INK, VERMILION, Panels, finish, panels, shade
from jbw.report.table import Cell, Column, Table, table, words
from jbw.report.text import NOTHING, axis_label, number
from jbw.report.words import badge
from jbw.results.population import StoredCoordinate, StoredInterval, StoredPopulation

MOST = 6  # largest number of quantities in one table of units
# A unit does not belong to the population if its probability is below this, divided by the number
# of units.
ODD = 0.01


def population_figure(
    record: Mapping[str, Any],
    mean: np.ndarray,
    sd: np.ndarray,
    at: np.ndarray,
    new: np.ndarray,
    ax: Any = None,
) -> Panels:
    """Draw each quantity of every unit against torque, or side by side if there is no trend.

    Args:
        record: Record of `population_of`.
        mean: Mean logarithms, with axes (unit, coordinate).
        sd: Standard deviations of the logarithms, with the same axes.
        at: Torques at which the population is drawn [N m], or the two ends of the order.
        new: 99 % bands of a new unit at `at`, in logarithms, with axes (quantile, place,
            coordinate).
        ax: Axes of the figure; a new figure when None.
    """
    found = StoredPopulation.read(record)
    rows, trend = found.parameters, found.has_trend
    axes = panels(ax, len(rows), 1, height=1.7 * len(rows))
    place = np.array(found.torque, float) if trend else np.arange(1.0, len(mean) + 1)
    odd = np.array([p < ODD / len(mean) for p in found.belongs.values()])
    for i, (panel, row) in enumerate(zip(axes[:, 0], rows.values(), strict=True)):
        low, middle, high = np.exp(new[:, :, i])
        shade(panel, at, low, high, BLUE, messages.BAND, alpha=0.15)
        panel.plot(at, middle, color=BLUE, lw=1.0)
        value = np.exp(mean[:, i])
        error = [value - np.exp(mean[:, i] - HALF_99 * sd[:, i]),
                 np.exp(mean[:, i] + HALF_99 * sd[:, i]) - value]  # fmt: skip
        panel.errorbar(place, value, error, fmt="o", color=INK, ms=4, lw=1.0, label="unit, 99 %")
        panel.plot(place[odd], value[odd], "s", color=VERMILION, ms=8, mfc="none")
        panel.set_ylabel(axis_label(row.symbol, row.unit))
        if not trend:
            panel.set_xticks(place, found.units if i == len(rows) - 1 else [""] * len(place))
    axes[-1, 0].set_xlabel("tightening torque [N m]" if trend else "unit")
    return finish(axes, ax)


def population_sheet(
    name: str, record: StoredPopulation, mean: np.ndarray, sd: np.ndarray, pooled: Table
) -> Sheet:
    """Return the page of a fleet: figure, statements, table of the population, tables of units.

    Args:
        name: Name of the fleet.
        record: Result of `population_of`.
        mean: Mean logarithms, with axes (unit, coordinate).
        sd: Standard deviations of the logarithms, with the same axes.
        pooled: Table of the population.
    """
    return Sheet(
        title=f"Population of {name}",
        subtitle=messages.heading(len(record.units)),
        caption=messages.caption(trend=record.has_trend),
        sentences=record.statements,
        tables=[("The population", pooled), *units_tables(record, mean, sd)],
        status=badge(record.status),
        status_words=f"Population of {len(record.units)} units",
    )


def population_table(record: StoredPopulation) -> Table:
    """Return the table of a population, one line per quantity, with a new unit's value."""
    torque, reference = record.new_unit["torque"], record.reference_torque
    at = torque if torque is not None else reference
    where = "" if at is None else f" at {at:.3g} N m"
    middle = "" if at is None or reference is None else f" at {reference:.3g} N m"
    new = {name: StoredInterval.read(record.new_unit[name]) for name in record.parameters}
    rows = record.parameters.values()
    columns = [
        words("", "name"),
        words("unit", "unit"),
        Column(f"mean{middle}", lambda row: _interval(row.mean)),
        Column("scatter between units [%]", lambda row: _interval(row.scatter, 100.0)),
    ]
    if any(row.run_scatter is not None for row in rows):
        columns.append(Column("between runs [%]", _of_runs))
    for column in record.columns[1:]:
        columns.append(Column(f"power of {column}", partial(_slope, f"slope_{column}")))
    columns.append(Column(f"new unit{where}", lambda row: _interval(new[row.name])))
    return table(messages.table_title(len(record.units)), rows, *columns)


def units_tables(
    record: StoredPopulation, mean: np.ndarray, sd: np.ndarray
) -> list[tuple[str, Table]]:
    """Return tables of the units with their headings; each has few enough columns to fit a page."""
    names = list(record.parameters)
    parts = [names[i : i + MOST] for i in range(0, len(names), MOST)]
    headings = ["The units", *["The units, further coordinates"] * (len(parts) - 1)]
    tables = [units_table(record, mean, sd, part) for part in parts]
    return list(zip(headings, tables, strict=True))


def units_table(
    record: StoredPopulation, mean: np.ndarray, sd: np.ndarray, names: Sequence[str]
) -> Table:
    """Return a table of units: torque, the named quantities, and agreement with other units."""
    places = {name: i for i, name in enumerate(record.parameters)}

    def estimate(i: int, k: int) -> Cell:
        low, middle, high = np.exp(mean[k, i] + HALF_99 * sd[k, i] * np.array([-1.0, 0.0, 1.0]))
        return _interval(StoredInterval(q005=low, median=middle, q995=high))

    def belongs(k: int) -> str:
        return number(record.belongs[record.units[k]])

    def stands(k: int) -> str:
        return "its draws" if record.units[k] in record.weighed else "normal summary"

    columns = [Column("unit", lambda k: record.units[k], align="left wrap")]
    if any(torque is not None for torque in record.torque):
        columns.append(Column("torque [N m]", lambda k: number(record.torque[k])))
    for name in names:
        unit = record.parameters[name].unit
        heading = name if unit == "1" else f"{name} [{unit}]"
        columns.append(Column(heading, partial(estimate, places[name])))
    columns += [Column("P(as far off)", belongs), Column("enters by", stands, align="left")]
    return table(messages.EVERY_UNIT, range(len(record.units)), *columns)


def _of_runs(row: StoredCoordinate) -> str:
    return NOTHING if row.run_scatter is None else f"{100.0 * row.run_scatter:.2g}"


def _slope(key: str, row: StoredCoordinate) -> Cell:
    return _interval(getattr(row, key, None))


def _interval(known: StoredInterval | None, factor: float = 1.0) -> Cell:
    """Return a median and, below it, its interval, so that many columns fit on a page."""
    if known is None:
        return Cell(NOTHING)
    low, middle, high = (factor * x for x in (known.q005, known.median, known.q995))
    width = max(abs(high - low), 1e-300)
    shown = int(np.clip(np.ceil(np.log10(max(abs(low), abs(high)) / width)) + 2, 2, 12))
    value, ends = f"{middle:.{shown}g}", f"[{low:.{shown}g}, {high:.{shown}g}]"
    return Cell(f"{value}\n{ends}", typed=f"{value} {ends}")
