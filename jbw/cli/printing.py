"""How results look on stdout: consoles, plain columns, durations."""

import click
from rich.console import Console

PIPE_WIDTH = 160  # columns, when stdout is no terminal and has no width of its own
MINUTE, HOUR = 60, 3600
NOTHING = "-"


def console() -> Console:
    """A console on stdout, wide where it is no terminal; NO_COLOR is heeded by Rich."""
    found = Console(highlight=False)
    return found if found.is_terminal else Console(highlight=False, width=PIPE_WIDTH)


def print_columns(rows: list[tuple[str, ...]]) -> None:
    """Rows as plain columns, the first one the headings.

    Args:
        rows: Cells, as many in each row.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for line in rows:
        padded = [cell.ljust(width) for cell, width in zip(line, widths, strict=True)]
        click.echo("  ".join(padded).rstrip())


def duration(seconds: float) -> str:
    """Seconds as a person says them, in seconds, minutes or hours."""
    if seconds < 2 * MINUTE:
        return f"{seconds:.3g} s"
    return f"{seconds / MINUTE:.3g} min" if seconds < 2 * HOUR else f"{seconds / HOUR:.3g} h"


def number(value: float | None, digits: int = 5) -> str:
    """So many significant digits; nothing where there is no number."""
    return "" if value is None else f"{value:.{digits}g}"
