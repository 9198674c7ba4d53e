"""How results look on stdout: tables, verdicts and JSON."""

import json
import math
from collections.abc import Mapping
from typing import Any

import click
from rich.console import Console
from rich.text import Text

from jbw.errors import printable
from jbw.report.table import MARKS, Table, print_table
from jbw.report.text import NOTHING as NOTHING

PIPE_WIDTH = 160  # columns, when stdout is no terminal and has no width of its own
MINUTE, HOUR = 60, 3600
STATUS = {"ok": MARKS["good"], "failed": MARKS["bad"]}


def console() -> Console:
    """A console on stdout, wide where it is no terminal; NO_COLOR is heeded by Rich."""
    found = Console(highlight=False)
    return found if found.is_terminal else Console(highlight=False, width=PIPE_WIDTH)


def show(*shown: Table | str) -> None:
    """Print tables and sentences on stdout; tables without rows are left out."""
    screen = console()
    for each in shown:
        if isinstance(each, str):
            # Text, not markup, and no control characters: names come from files.
            screen.print(Text(printable(each)), soft_wrap=not screen.is_terminal)
        elif each.rows:
            print_table(screen, each)


def show_json(record: Any) -> None:
    """Print a record as JSON, with null for what JSON has no number for."""
    click.echo(json.dumps(_plain(record), indent=1, ensure_ascii=False))


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def show_verdict(verdict: Mapping[str, Any], *, passed: bool = False) -> None:
    """Print a verdict as a record holds it, and each finding against it; those passed, too."""
    screen = console()
    status = verdict["status"]
    screen.print(Text.assemble("Verdict: ", (status, STATUS.get(status, MARKS["doubt"]))))
    for finding in verdict["findings"]:
        sentence = f"  {finding['reason']} {finding['action']}".rstrip()
        if finding["status"] != "ok":
            show(f"{sentence} (jbw explain {finding['code']})")
        elif passed:
            show(sentence)


def duration(seconds: float) -> str:
    """Seconds as a person says them, in seconds, minutes or hours."""
    if seconds < 2 * MINUTE:
        return f"{seconds:.3g} s"
    return f"{seconds / MINUTE:.3g} min" if seconds < 2 * HOUR else f"{seconds / HOUR:.3g} h"
