"""Pages of tables fit a window of 1280 pixels: no column is cut off."""

import numpy as np
import pytest
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextToPath
from test_browser import CHROMIUM, browse

from jbw.report.population import (
    population_figure,
    population_sheet,
    population_table,
    units_tables,
)
from jbw.report.sheet import render_sheet
from jbw.results.population import StoredPopulation

ROOM = 71 * 16 - 40  # the page's width less its margins, at 1280 pixels [px]
CELL = 2 * 0.45 * 0.82 * 16  # padding of a cell [px]
FONT = FontProperties(size=0.82 * 16 * 72 / 96)  # of a table [pt]
UNITS = [f"assembly {k} of the second series" for k in range(1, 7)]
PARAMETERS = {
    "omega_n": "rad/s", "zeta": "1", "alpha_delta": "1/(m s^2)", "alpha_gamma": "1/(m s^2)",
    "gain_force": "N/kg/N", "omega_2": "rad/s", "zeta_2": "1", "cubic": "1/(m^2 s^2)",
}  # fmt: skip


def ends(middle):
    return {"q005": 0.983412 * middle, "median": middle, "q995": 1.0172345 * middle}


@pytest.fixture
def fleet():
    """Six units of eight parameters, with a trend with torque."""
    rng = np.random.default_rng(1)
    mean = np.log(123.456) + 0.1 * rng.normal(size=(6, 8))
    rows = {
        name: {"symbol": name, "unit": unit, "mean": ends(123456.7), "scatter": ends(0.0234),
               "run_scatter": 0.01, "slope_torque": ends(-1.234), "own_over_scatter": 0.5}
        for name, unit in PARAMETERS.items()
    }  # fmt: skip
    record = {
        "units": UNITS, "torque": [4.0, 8.0, 12.0, 4.0, 8.0, 12.0], "columns": ["mean", "torque"],
        "parameters": rows, "belongs": dict.fromkeys(UNITS, 0.5),
        "weighed": dict.fromkeys(UNITS[:3], 0.9),
        "reference_torque": 8.0, "status": "ok", "statements": ["All belong together."],
        "new_unit": {"torque": 10.0, **{name: ends(987.6) for name in PARAMETERS}},
    }  # fmt: skip
    return StoredPopulation.read(record), mean, np.full((6, 8), 0.01)


def lines_of(text):
    return text.split("\n")


def width_of(text):
    return TextToPath().get_text_width_height_descent(text, FONT, ismath=False)[0] * 96 / 72


@pytest.mark.parametrize("which", [0, 1, 2])
def test_the_tables_of_a_fleet_are_no_wider_than_the_page(fleet, which):
    record, mean, sd = fleet
    tables = [
        population_table(record),
        *(unit_table for _, unit_table in units_tables(record, mean, sd)),
    ]
    assert len(tables) == 3
    shown = tables[which]
    widths = []
    for column in shown.columns_shown("page"):
        cells = [line for row in shown.rows for line in lines_of(column.cell(row).text)]
        wraps = column.align in ("wrap", "left wrap")
        # A heading and a text that wraps are at least as wide as their longest word.
        words = [word for line in column.heading.split("\n") for word in line.split()]
        words += [word for cell in cells for word in cell.split()] if wraps else cells
        least = {"wrap": 224.0, "left wrap": 144.0}.get(column.align, 48.0)
        widths.append(max([least, *map(width_of, words)]) + CELL)
    assert sum(widths) <= ROOM, dict(zip([c.heading for c in shown.columns], widths, strict=False))


def test_the_terminal_has_each_interval_on_one_line(fleet):
    record, mean, sd = fleet
    cells = [
        column.cell(row)
        for _, shown in units_tables(record, mean, sd)
        for column in shown.columns_shown("terminal")
        for row in shown.rows
    ]
    assert all("\n" not in (cell.typed or cell.text) for cell in cells)
    assert sum("[" in cell.typed for cell in cells) == 6 * 8


def page_of(fleet):
    record, mean, sd = fleet
    at = np.array([4.0, 12.0])
    new = np.log(123.0) + np.array([-0.3, 0.0, 0.3])[:, None, None] * np.ones((3, 2, 8))
    drawn = population_figure(record.plain(), mean, sd, at, new)
    sheet = population_sheet("series", record, mean, sd, population_table(record))
    return render_sheet(sheet, drawn)


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
def test_a_browser_cuts_no_column_off(fleet, tmp_path):
    path = tmp_path / "population.html"
    path.write_text(page_of(fleet), encoding="utf-8")
    around = tmp_path / "frame.html"
    around.write_text(f"""<!doctype html><iframe src="{path.name}" width=1280 height=900></iframe>
<script>addEventListener("load", () => {{
  const d = document.querySelector("iframe").contentDocument;
  const cut = [...d.querySelectorAll(".scroll")].filter(b => b.scrollWidth > b.clientWidth + 1);
  document.body.textContent = `CUT${{cut.length}} OF${{d.querySelectorAll("table").length}}END`;
}});</script>""")
    assert "CUT0 OF3END" in browse(around)
