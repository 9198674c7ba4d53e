"""The command that monitors a joint: `jbw watch RUN --add RECORD`."""

from functools import partial
from pathlib import Path
from typing import Any

import click

from jbw.cli.options import json_option, run_argument
from jbw.cli.printing import answer
from jbw.cli.progress import computing
from jbw.report.messages import watch as messages

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
    help="Peak amplitudes of the response at which frequency and damping are measured, in SI; by "
    "default the lowest amplitude that all records have.",
)
@click.option(
    "--false-alarms", type=float, help="Rate of false alarms per record; by default 0.001."
)
@click.option(
    "--reference",
    "num_reference",
    type=click.IntRange(1),
    help="Number of records, from the first, of the unchanged joint; by default the campaign's.",
)
@click.option("--test", help="Name of the test of free decays, if the campaign has several.")
@click.option(
    "--campaign",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="The campaign file of the run, if it was moved.",
)
@click.option(
    "--population",
    "fleet",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Fleet at several torques, from `jbw collect`; a change is then also stated as a change "
    "of torque.",
)
@json_option
def watch(
    folder: Path, files: tuple[Path, ...], campaign: Path | None, fleet: Path | None, json_: bool,
    **wished: Any,
) -> int:  # fmt: skip
    """Monitor the joint of the run in DIR: has it changed since the run?

    Frequency and damping of free decays are measured at a fixed amplitude, so that the force of the
    hammer has no effect. The records of the run's campaign are the reference. Each record of --add
    is tested against them with a stated rate of false alarms, by itself and together with the
    records before it. The command appends one line per record to DIR/watch.jsonl, and draws
    DIR/watch.png and the page DIR/watch.html. Exit code: 6 after an alarm, otherwise 3 if a record
    cannot be compared. Options other than --add are for the first call.
    """
    with computing() as say:
        from jbw.report.changes import watch_figure, watch_sheet, watch_table
        from jbw.report.sheet import render_sheet
        from jbw.study.store import write_figure, writing
        from jbw.watch.watch import FEW, Wishes
        from jbw.watch.watch import watch as add

        trend_at = None
        if fleet is not None:
            from jbw.population.fleet import read_fleet
            from jbw.watch.readings import trend_of

            trend_at = partial(trend_of, read_fleet(fleet), report=say)
        wishes = Wishes(**wished)
        settings, readings, new_lines = add(
            folder, files, wishes, campaign=campaign, trend_at=trend_at, say=say
        )
        figure = watch_figure(settings, readings)
        page = render_sheet(watch_sheet(folder.name, settings, readings), figure)
        with writing(folder, "watch.png", "watch.html") as part:
            write_figure(part / "watch.png", figure)
            (part / "watch.html").write_text(page, encoding="utf-8")
        if len(settings.amplitudes) > 1 and settings.reference < FEW:
            say(messages.several_amplitudes(FEW))
    stated = [line for line in new_lines if line.statement]
    # The last alarm is shown; without an alarm, the statement on the last record.
    last = ([line for line in stated if line.alarm] or stated)[-1:]
    shown = new_lines or readings
    added = [line.plain() for line in new_lines]
    record = {"settings": settings.plain(), "added": added, "count": len(readings)}
    answer(
        json_, record, watch_table(settings, shown), *(line.statement for line in last),
        saved=f"Watch: {folder / 'watch.jsonl'}, {folder / 'watch.html'}",
    )  # fmt: skip
    if any(line.alarm for line in new_lines):
        return ALARM
    return REFUSED if any(line.entry == "refused" for line in new_lines) else 0
