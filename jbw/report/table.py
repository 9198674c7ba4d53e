"""The description of a table, from which the page and the terminal show it."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from jbw.errors import printable
from jbw.report.text import NOTHING, Names, number, percent, symbol, typed

Row = Mapping[str, Any]
WHOLE = 12  # largest number of characters of a cell that a narrow terminal does not wrap
MARKS = {"good": "green", "doubt": "yellow", "bad": "bold red", "flag": "bold"}


class Cell(NamedTuple):
    """The content of one cell of a table."""

    text: str  # text on the page
    mark: str = ""  # kind of mark: good, doubt, bad or flag; empty for no mark
    typed: str = ""  # text in the terminal; if empty, `text` with keyboard characters


@dataclass(frozen=True)
class Column:
    """One column of a table: heading, content for a row, and meaning."""

    heading: str  # heading text, with the unit if the numbers have one
    show: Callable[[Any], str | Cell]  # function that returns the text or cell of a row
    meaning: str = ""  # meaning of the numbers, for the note below the table on the page
    # alignment: "right", "left" or "unit" (unit of a number); for long text "wrap" or "left wrap"
    align: str = "right"
    # Columns with high numbers are dropped first on a narrow screen; columns with 0 are never
    # dropped.
    spared: int = 0
    only: str = ""  # "page" or "terminal" for a column that only one of them shows

    def cell(self, row: Any) -> Cell:
        """Return the cell of a table's row in this column."""
        shown = self.show(row)
        return shown if isinstance(shown, Cell) else Cell(shown)


class Section(NamedTuple):
    """Rows that belong together: a name, a status `badge` and, on the page, a `remark`."""

    rows: Sequence[Any]
    name: str = ""
    heading: str = ""
    badge: Cell = Cell("")
    remark: str = ""


@dataclass(frozen=True)
class Table:
    """A table: columns, sections of rows and a note; `of` is the common name of the sections."""

    title: str
    columns: tuple[Column, ...]
    sections: tuple[Section, ...]
    note: str = ""
    of: str = ""

    @property
    def rows(self) -> list[Any]:
        """The rows of all sections."""
        return [row for section in self.sections for row in section.rows]

    def columns_shown(self, where: str) -> list[Column]:
        """Return the columns that are not empty, for the page or for the terminal."""
        here = [column for column in self.columns if column.only in ("", where)]
        rows = self.rows
        return [c for c in here if any(c.cell(row).text not in ("", NOTHING) for row in rows)]

    @property
    def meanings(self) -> str:
        """The meanings of the columns, followed by the table's note."""
        meant = [
            f"{' '.join(column.heading.split())}: {column.meaning}."
            for column in self.columns_shown("page")
            if column.meaning
        ]
        return " ".join(filter(None, (*meant, self.note)))


def table(title: str, rows: Iterable[Any], *columns: Column, note: str = "") -> Table:
    """Return a table with a single section."""
    return Table(title, columns, (Section(list(rows)),), note)


def named(heading: str, names: Names) -> Column:
    """Return a column of parameter names: symbols on the page, typed names in the terminal."""

    def name(row: Any) -> Cell:
        called = field(row, "name")
        return Cell(symbol(called, names) + (field(row, "suffix") or ""), typed=called)

    return Column(heading, name, align="left")


def words(heading: str, key: str, align: str = "left") -> Column:
    """Return a column of texts, which are shown unchanged."""
    return Column(heading, lambda row: str(field(row, key)), align=align)


def by_sd(heading: str, key: str, **more: Any) -> Column:
    """Return a column of numbers, each rounded according to the standard deviation in its row."""
    return Column(heading, lambda row: number(field(row, key), field(row, "sd")), **more)


def digits(heading: str, key: str, count: int = 3, place: float = 0, **more: Any) -> Column:
    """Return a column of numbers with `count` digits each, or all with one decimal place."""
    return Column(heading, lambda row: number(field(row, key), place, count), **more)


def shares(heading: str, key: str, missing: str = NOTHING, **more: Any) -> Column:
    """Return a column of ratios in percent."""

    def share(row: Any) -> str:
        return percent(field(row, key), digits=2).replace(NOTHING, missing)

    return Column(heading, share, **more)


def field(row: Any, key: str) -> Any:
    """Return an attribute or entry of a row by name; None if the row has none."""
    return row.get(key) if isinstance(row, Mapping) else getattr(row, key, None)


def print_table(screen: Any, shown: Table) -> None:
    """Print a table on a Rich console, with as many columns as fit its width."""

    def width() -> int:
        return screen.measure(rich_table, options=screen.options.update(max_width=10_000)).maximum

    rich_table = _rich(shown, 0)
    for most in sorted({column.spared for column in shown.columns} - {0}):
        if width() <= screen.width:
            break
        rich_table = _rich(shown, most)
    if screen.is_terminal and width() > screen.width:
        rich_table = _rich(shown, most_spared(shown), is_tight=True)
    # In a file or pipe, lines may be of any length; only a terminal wraps them.
    room = screen.width if screen.is_terminal else max(width(), screen.width)
    screen.print(rich_table, width=room, crop=False)


def most_spared(shown: Table) -> int:
    """Return the rank of the columns that are dropped first on a narrow screen."""
    return max(column.spared for column in shown.columns)


def typed_cell(cell: Cell) -> str:
    """Return a cell's text without control characters, because names come from files."""
    return printable(cell.typed or typed(cell.text))


def _rich(shown: Table, spared: int, *, is_tight: bool = False) -> Any:
    """Return a Rich table without the columns that a narrow terminal drops.

    A column is dropped if its own `spared` is at least 1 and at most `spared`.

    A tight table has single spaces between columns, and folds only columns with long cells.
    """
    from rich.box import SIMPLE_HEAD  # The page needs no terminal, so Rich is imported only here.
    from rich.table import Table as Rich
    from rich.text import Text

    columns = [
        column for column in shown.columns_shown("terminal") if not 0 < column.spared <= spared
    ]
    title = Text(printable(shown.title)) if shown.title else None
    rich_table = Rich(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1 - is_tight))
    if shown.of:
        rich_table.add_column(shown.of, overflow="fold")
    for column in columns:
        justify = "right" if column.align == "right" else "left"
        cells = (typed_cell(column.cell(row)) for part in shown.sections for row in part.rows)
        is_whole = is_tight and max(map(len, [*cells, *column.heading.split("\n")])) <= WHOLE
        heading = Text(column.heading)
        rich_table.add_column(heading, justify=justify, overflow="fold", no_wrap=is_whole)
    if shown.of:
        rich_table.add_column("verdict")
    for section in shown.sections:
        for place, row in enumerate(section.rows):
            cells = [column.cell(row) for column in columns]
            if shown.of:  # The name and badge of a section are shown in its first row.
                name, badge = (section.name, section.badge) if place == 0 else ("", Cell(""))
                cells = [Cell(name), *cells, badge]
            # Rich does not interpret Text objects as markup.
            rich_table.add_row(
                *(Text(typed_cell(cell), MARKS.get(cell.mark, "")) for cell in cells)
            )
        rich_table.add_section()
    return rich_table
