"""Two runs beside each other: a table of parameters, one along the amplitude, and a figure."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import xarray as xr

from jbw.report.messages import differences as messages
from jbw.report.table import Column, Table, named, table
from jbw.report.text import length_unit, number, unit_text

Row = Mapping[str, Any]
RUNS = ("A", "B")
LEAST = 1e-3  # that a probability is said to, or 1 less that
QUANTITIES = {"frequency": "frequency [Hz]", "damping": "damping ratio [%]"}


def parameters_table(record: Row) -> Table:
    """A row a quantity that both runs know."""
    return table(
        messages.TABLE,
        record["parameters"],
        named("parameter", {}),
        Column("unit", lambda row: unit_text(row["unit"]) or "-", align="left", spared=1),
        *_columns(),
        note=_note(record),
    )


def backbone_table(record: Row) -> Table:
    """Frequency and damping at amplitudes that both runs fitted."""
    factor, unit = length_unit(max((row["amplitude"] for row in record["backbone"]), default=1.0))
    return table(
        messages.BACKBONE_TABLE,
        [_in_per_cent(row) if row["unit"] == "1" else row for row in record["backbone"]],
        Column("", lambda row: QUANTITIES[row["name"]], align="left"),
        Column(f"at [{unit}]", lambda row: number(factor * row["amplitude"])),
        *_columns(),
    )


def _columns() -> tuple[Column, ...]:
    """Both intervals, that of the difference, and the probability."""
    return (
        *(Column(run, partial(_interval, key=run.lower())) for run in RUNS),
        Column("A - B", partial(_interval, key="difference")),
        Column("P(A > B)", probability_text),
    )


def _interval(row: Row, key: str) -> str:
    low, middle, high = row[key]
    sd = 0.2 * (high - low)  # a 99 % interval is five of them wide
    return f"{number(middle, sd)} [{number(low, sd)}, {number(high, sd)}]"


def probability_text(row: Row) -> str:
    """P(A > B) to three digits; a dash where a run knows the quantity by its prior alone."""
    if row.get("of_prior"):
        return "prior"
    value = row["probability"]
    if value < LEAST:
        return f"< {LEAST:g}"
    if value > 1 - LEAST:
        return f"> {1 - LEAST:g}"
    return f"{value:.{2 if 0.05 < value < 0.95 else 3}f}"  # as many as the draws are worth


def _in_per_cent(row: Row) -> dict[str, Any]:
    scaled = {key: [100 * x for x in row[key]] for key in ("a", "b", "difference")}
    return {**row, **scaled}


def _note(record: Row) -> str:
    return "; ".join(f"{name}: {run['folder']}" for name, run in record["runs"].items())


def backbones_figure(bands: xr.Dataset, ax: Any = None) -> Any:
    """Draw frequency and damping of both runs against amplitude, with their 99 % bands."""
    # Matplotlib is wanted for this alone.
    from jbw.report import style
    from jbw.report.style import finish, panels, shade

    axes = panels(ax, 1, 2, height=3.2)
    factor, unit = length_unit(float(bands["amplitude"][-1]))
    for only, (name, label) in zip(axes[0], QUANTITIES.items(), strict=True):
        scale = 100.0 if name == "damping" else 1.0
        for run, colour in zip(RUNS, (style.BLUE, style.VERMILLION), strict=True):
            low, middle, high = scale * bands[name].sel(run=run).values
            x = factor * bands["amplitude"].values
            shade(only, x, low, high, colour, f"{run}, {style.BAND}")
            only.plot(x, middle, color=colour, lw=1.0)
        only.set_ylabel(label)
        only.ticklabel_format(axis="y", useOffset=False)
    return finish(axes, ax, f"amplitude of displacement [{unit}]")
