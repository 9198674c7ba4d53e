"""Printing of results on stdout: tables, verdicts and JSON."""

import json
import math
import shlex
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console
from rich.text import Text

from jbw.errors import printable
from jbw.report.table import MARKS, Table, print_table

if TYPE_CHECKING:
    from jbw.results.run import StoredVerdict  # loads pydantic

PIPE_WIDTH = 160  # number of columns if stdout is no terminal and has no width
NOT_TRUSTED = 4  # exit code of a run whose verdict is neither "ok" nor "usable"
MINUTE, HOUR = 60, 3600
STATUS = {"ok": MARKS["good"], "failed": MARKS["bad"]}


def console() -> Console:
    """Return a console for stdout, wide if it is no terminal; Rich respects NO_COLOR."""
    screen = Console(highlight=False)
    return screen if screen.is_terminal else Console(highlight=False, width=PIPE_WIDTH)


def show(*shown: Table | Text | str) -> None:
    """Print tables and sentences on stdout; tables without rows are omitted."""
    screen = console()
    for content in shown:
        if not isinstance(content, Table):
            # Names come from files; they are printed literally, without markup or control
            # characters.
            text = Text(printable(content)) if isinstance(content, str) else content
            screen.print(text, soft_wrap=not screen.is_terminal)
        elif content.rows:
            print_table(screen, content)


def answer(json_: bool, record: Any, *shown: Table | Text | str, saved: str = "") -> None:
    """Print a record as JSON if requested, otherwise as tables and sentences, and name its file."""
    if json_:
        show_json(record)
        return
    show(*shown)
    if saved:
        click.echo(saved)


def following(command: str, target: Any = None, also: str = "") -> None:
    """Print on stderr the command to type next, with an optional addition."""
    named = "" if target is None else f" {shlex.quote(str(target))}"
    click.echo(f"Next: jbw {command}{named}{also}", err=True)


def show_json(record: Any) -> None:
    """Print a record as JSON, with null for numbers that JSON cannot express."""
    click.echo(json.dumps(plain_values(record), indent=1, ensure_ascii=False))


def plain_values(value: Any) -> Any:
    """Return nested values in which None replaces every number that is not finite."""
    if isinstance(value, Mapping):
        return {key: plain_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_values(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def verdict_line(verdict: "StoredVerdict") -> Text:
    """Return one line with a verdict and the status of its three answers."""
    parts: list[Any] = ["Verdict: ", _status(verdict.status)]
    for i, (name, answered) in enumerate(verdict.answers.items()):
        parts += [", " if i else " (", f"{name} ", _status(answered.status, answered.word)]
    return Text.assemble(*parts, ")" if len(parts) > 2 else "")


def verdict_lines(verdict: "StoredVerdict", *, passed: bool = False) -> Iterator[Text | str]:
    """Yield a verdict's lines: status, answers, failed findings (with `passed`, all findings)."""
    yield Text.assemble("Verdict: ", _status(verdict.status))
    for name, answered in verdict.answers.items():
        status = _status(answered.status, answered.word)
        yield Text.assemble(f"  {name}: ", status, f". {answered.question}")
    for finding in verdict.findings:
        sentence = f"  {finding.reason} {finding.action}".rstrip()
        if finding.status != "ok":
            yield f"{sentence} (jbw explain {finding.code})"
        elif passed:
            yield sentence


def exit_code_of(status: str, *, strict: bool = False) -> int:
    """Return exit code 0 for status ok or usable, else 4; with `strict`, 0 only for ok."""
    return 0 if status == "ok" or (status == "usable" and not strict) else NOT_TRUSTED


def _status(status: str, word: str = "") -> tuple[str, str]:
    return word or status, STATUS.get(status, MARKS["doubt"])


def duration(seconds: float) -> str:
    """Format a duration in seconds, minutes or hours."""
    if seconds < 2 * MINUTE:
        return f"{seconds:.3g} s"
    return f"{seconds / MINUTE:.3g} min" if seconds < 2 * HOUR else f"{seconds / HOUR:.3g} h"
