"""The command `jbw plan`."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.table import Table
from rich.text import Text

from jbw.cli.printing import console, duration

if TYPE_CHECKING:
    from jbw.planning.plan import Combination, Expected, Plan, Row


@click.command()
@click.argument(
    "source", metavar="[PLAN.toml | DIR]", required=False, type=click.Path(path_type=Path)
)
@click.option(
    "--limits",
    type=click.Path(path_type=Path),
    help="Beside DIR: a plan file without the joint, for limits, noise, wishes and candidates.",
)
@click.option("--json", "json_", is_flag=True, help="Print JSON instead of a table.")
@click.option("--example", is_flag=True, help="Print a commented plan file; nothing else.")
def plan(source: Path | None, limits: Path | None, json_: bool, example: bool) -> None:
    """Say which tests make the joint known to a wished CV, before anything is mounted.

    PLAN.toml tells what is guessed of the joint, what is wanted and what could be measured; DIR is
    a finished run, for which the next tests are planned. Without either an example is printed.
    """
    if example or source is None:
        from jbw.planning.keys import EXAMPLE

        click.echo(EXAMPLE, nl=False)
        return
    if limits is not None and not source.is_dir():
        raise click.UsageError("--limits is for a run's folder; PLAN.toml holds its own.")
    from jbw.cli.progress import progress
    from jbw.cli.running import prepare_jax

    prepare_jax()
    from jbw.planning.making import plan_tests
    from jbw.report.result import read_result

    with progress() as say:
        if source.is_dir():
            _, tree = read_result(source)
            made = plan_tests(limits, tree, report=say)
        else:
            made = plan_tests(source, report=say)
    if json_:
        click.echo(json.dumps(_plain(asdict(made)), indent=1, ensure_ascii=False))
    else:
        _print(made)


def _plain(value: Any) -> Any:
    """The same with None for what JSON has no number for."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _print(made: "Plan") -> None:
    screen = console()
    screen.print(_table(made))
    known = ", ".join(f"{name} {_spread(one)}" for name, one in made.before.items())
    before = f"Before any of these tests: CV {known}."
    for line in (*_remarks(made), *_recommended(made.combination, made), before, *made.notes):
        screen.print(Text(line))


def _table(made: "Plan") -> Table:
    wish = made.wish
    title = f"Tests for a CV of {wish.cv:.2g} of {', '.join(wish.wanted)}"
    table = Table(
        title=f"{title}, at nine in ten of {made.num_joints} joints", title_justify="left"
    )
    table.add_column("")
    table.add_column("test", overflow="fold")
    for heading in (
        f"input [{wish.input_unit}]",
        "peak [m]",
        "repeats",
        "time",
        *(f"CV {name}" for name in wish.wanted),
        "gain [nats]",
    ):
        table.add_column(Text(heading), justify="right")
    table.add_column("status")
    for i, row in enumerate(made.rows):
        table.add_row(str(i + 1), *map(Text, _cells(row, made)))
    return table


def _cells(row: "Row", made: "Plan") -> list[str]:
    return [
        row.test,
        f"{row.level:.4g}",
        f"{row.y_peak_largest:.3g}",
        f"> {made.wish.max_repeats}" if row.repeats is None else str(row.repeats),
        "" if row.seconds is None else duration(row.seconds),
        *(f"{row.cv[name].worst_decile:.2g}" for name in made.wish.wanted),
        f"{row.information_gain:.3g}",
        row.status,
    ]


def _remarks(made: "Plan") -> list[str]:
    """What stands against single tests, by their numbers."""
    return [f"  {i + 1}: {'; '.join(row.notes)}." for i, row in enumerate(made.rows) if row.notes]


def _recommended(found: "Combination", made: "Plan") -> list[str]:
    """The combination in words: what to measure, what it tells, what it does not."""
    unit = made.wish.input_unit
    if found.met and not found.tests:
        best = max(made.rows, key=lambda one: one.information_gain / one.seconds_each)
        return [
            "No test is needed: what is known before meets the wish.",
            f"Most would be told a second by {best.test}, {best.level:g} {unit}.",
        ]
    tests = [f"  {one.repeats} x {one.test}, {one.level:g} {unit}" for one in found.tests]
    told = ", ".join(f"{name} {_spread(found.cv[name])}" for name in made.wish.wanted)
    after = f"CV {told} after {duration(found.seconds)} of measuring"
    if found.met:
        lines = ["Recommended, the greatest expected gain a second until the wish is met:", *tests]
        lines.append(f"  {after}.")
    elif not found.tests:
        lines = ["No test lies within the limits; raise max_displacement or max_input."]
    else:
        lines = [f"No combination meets the wish within {made.wish.max_repeats} repeats:", *tests]
        lines.append(f"  {after} only.")
    return [*lines, *(f"  Together, {note}." for note in found.notes)]


def _spread(value: "Expected") -> str:
    if value.worst_decile == value.median:
        return f"{value.median:.2g}"
    return f"{value.worst_decile:.2g} (median {value.median:.2g})"
