"""One description of a table: columns that say nothing go, numbers are typed in the terminal."""

import re
from io import StringIO

import pytest
from rich.console import Console

from jbw.report.table import Cell, Column, print_table, table, words
from jbw.report.text import typed

ROWS = [{"name": "beam", "x": "−3.2×10⁻⁶"}, {"name": "[red]arm[/red]\x1b", "x": "–"}]
COLUMNS = (
    Column("name", lambda row: row["name"], align="left"),
    Column("x [m]\nof it", lambda row: Cell(row["x"], "flag"), "how far it moved", spared=1),
    Column("nothing", lambda _: "–", "never told"),
    Column("page", lambda _: "here", only="page"),
)


@pytest.mark.parametrize(
    ("printed", "expected"),
    [
        ("3.2×10⁻⁶ %", "3.2e-06 %"),
        ("−1.50 to 2×10¹²", "-1.50 to 2e+12"),
        ("–", "-"),
        ("sweep – up", "sweep – up"),
    ],
)
def test_numbers_are_shown_as_one_types_them(printed, expected):
    assert typed(printed) == expected


def test_columns_that_say_nothing_go_with_their_meaning():
    shown = table("Beams", ROWS, *COLUMNS, note="All are toys.")
    assert [column.heading for column in shown.columns_shown("page")] == [
        "name",
        "x [m]\nof it",
        "page",
    ]
    assert [column.heading for column in shown.columns_shown("terminal")] == [
        "name",
        "x [m]\nof it",
    ]
    assert shown.meanings == "x [m] of it: how far it moved. All are toys."


@pytest.mark.parametrize(("width", "has_x"), [(60, True), (22, False)])
def test_a_narrow_screen_spares_columns_and_names_steer_nothing(capsys, width, has_x):
    print_table(Console(width=width, highlight=False), table("Beams", ROWS, *COLUMNS))
    printed = capsys.readouterr().out
    assert ("-3.2e-06" in printed) == has_x
    assert "[red]arm[/red]" in printed
    assert "\x1b" not in printed


def test_a_narrow_terminal_folds_long_cells_alone():
    rows = [{"test": "noise_of_the_first_day_5mV", "role": "velocity", "repeats": 3}]
    shown = table(
        "Campaign", rows, words("test", "test"), words("role", "role"),
        words("repeats", "repeats", "right"),
    )  # fmt: skip
    printed = StringIO()
    print_table(Console(file=printed, width=30, force_terminal=True, no_color=True), shown)
    lines = re.sub(r"\x1b\[[0-9;]*m", "", printed.getvalue()).splitlines()
    assert max(map(len, lines)) <= 30
    assert any("repeats" in line for line in lines)
    (first,) = [line for line in lines if "velocity" in line]
    assert first.split()[-1] == "3"
    assert "noise_of_the_first_day_5mV".startswith(first.split()[0])
