"""The command that watches a joint: `jbw watch RUN --add RECORD`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np

from jbw.cli.options import json_option, run_argument
from jbw.cli.printing import answer
from jbw.cli.progress import computing
from jbw.report.table import Column, Table, table, words
from jbw.report.text import NOTHING

ALARM, REFUSED = 6, 3  # exit codes


def _amplitudes(_: Any, __: Any, value: str | None) -> tuple[float, ...] | None:
    if value is None:
        return None
    try:
        return tuple(float(part) for part in value.split(","))
    except ValueError:
        raise click.BadParameter(f"{value!r} is no list of numbers such as 0.2,0.1.") from None


@click.command()
@run_argument
@click.option(
    "--add",
    "files",
    multiple=True,
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="A record to add; may be given several times, in the order of measurement.",
)
@click.option(
    "--amplitude",
    "amplitudes",
    callback=_amplitudes,
    metavar="A1[,A2]",
    help="Peak amplitudes of the response to read at, SI; the lowest common one when left out.",
)
@click.option(
    "--false-alarms", type=float, help="Rate of false alarms a record; 0.001 when left out."
)
@click.option(
    "--reference",
    "num_reference",
    type=click.IntRange(1),
    help="So many records are without change; the campaign's own when left out.",
)
@click.option("--test", help="Name of the test of free decays, where the campaign has several.")
@click.option(
    "--campaign",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="The run's campaign file, where it has moved.",
)
@json_option
def watch(
    folder: Path, files: tuple[Path, ...], campaign: Path | None, json_: bool, **wished: Any
) -> int:  # fmt: skip
    """Watch the joint of the run in DIR: has it changed since?

    Reads frequency and damping of free decays at a fixed amplitude, whatever the hammer. The
    records of the run's campaign are the reference; each one of --add is tested against them with a
    stated rate of false alarms, alone and together with those before it. Appends a line a record to
    DIR/watch.jsonl and draws DIR/watch.png. Ends with 6 on an alarm, else with 3 where a record
    cannot be compared. Options other than --add are for the first call.
    """
    with computing() as say:
        from jbw.report.watch import watch_figure
        from jbw.study.store import write_figure, writing
        from jbw.watch.watch import FEW, Wishes
        from jbw.watch.watch import watch as add

        found = add(folder, files, Wishes(**wished), campaign=campaign, say=say)
        with writing(folder, "watch.png") as part:
            write_figure(part / "watch.png", watch_figure(found.settings, found.readings))
        several = len(found.settings["amplitudes"]) > 1
        if several and found.settings["reference"] < FEW:
            say(f"Below {FEW} references one amplitude finds more than several.")
    stated = [one for one in found.added if "statement" in one]
    # One statement: of the last alarm, or where there is none of the last record.
    last = ([one for one in stated if one["alarm"]] or stated)[-1:]
    shown = found.added or found.readings
    record = {"settings": found.settings, "added": found.added, "count": len(found.readings)}
    answer(
        json_, record, watch_table(found.settings, shown), *(one["statement"] for one in last),
        saved=f"Watch: {folder / 'watch.jsonl'}, {folder / 'watch.png'}",
    )  # fmt: skip
    if any(one.get("alarm") for one in found.added):
        return ALARM
    return REFUSED if any(one["kind"] == "refused" for one in found.added) else 0


def watch_table(settings: Mapping[str, Any], entries: Any) -> Table:
    """A line a record, with its readings at the first amplitude."""

    def number(heading: str, read: Any, form: str) -> Column:
        def shown(one: Mapping[str, Any]) -> str:
            value = read(one)
            return NOTHING if value is None else format(value, form)

        return Column(heading, shown)

    def value(at: int) -> Any:
        return lambda one: one["values"][at] if "values" in one else None

    rows = [{"role": one["kind"], "alarm": "", **one} for one in entries]
    at = f"{settings['amplitudes'][0]:g} {settings['unit']}"
    return table(
        f"Read at {at}; rate of false alarms {settings['false_alarms']:g} a record",
        rows,
        number("number", lambda one: one.get("number"), "d"),
        words("record", "record"),
        words("role", "role"),
        number("frequency [Hz]", value(0), ".4f"),
        number("damping [%]", lambda one: 100 * np.exp(one["values"][1]) if "values" in one
               else None, ".4g"),
        number("T^2", lambda one: one.get("squared"), ".3g"),
        number("threshold", lambda one: one.get("threshold"), ".3g"),
        number("unchanged", lambda one: one.get("unchanged"), ".3g"),
        words("alarm", "alarm"),
    )  # fmt: skip
