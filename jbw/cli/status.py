"""The command on the progress of runs: `jbw status RUNS`."""

from collections import Counter
from dataclasses import asdict
from pathlib import Path

import click

from jbw.cli.options import json_option, run_argument
from jbw.cli.printing import answer, duration
from jbw.errors import RunError
from jbw.report.messages import status as messages
from jbw.report.table import table, words
from jbw.run.folder import HIDDEN, MANIFEST
from jbw.run.outcomes import FleetProgress, progress


@click.command()
@run_argument
@json_option
def status(folder: Path, json_: bool) -> None:
    """Show how far the runs in DIR are, which `jbw identify` was given several campaigns for.

    DIR is the folder of --out. Campaigns that failed are listed with their reasons. DIR may also be
    the folder of a single run.
    """
    found = progress(folder)
    if found is None:
        click.echo(_of_one_run(folder), err=json_)
        if json_:
            answer(json_, {"runs": [], "left": 0})
        return
    record = {
        "left": found.num_left,
        "left_s": found.left_s,
        "since_s": found.since_s,
        "begun": found.begun,
        "command": found.command,
        "runs": [asdict(outcome) for outcome in found.outcomes],
    }
    failed = [
        {"run": Path(outcome.folder).name, "error": outcome.error}
        for outcome in found.outcomes
        if outcome.status == "failed"
    ]
    title = messages.NOT_IDENTIFIED
    rows = table(title, failed, words("run", "run"), words("error", "error", "left wrap"))
    answer(json_, record, *sentences(found), rows)


def sentences(found: FleetProgress) -> list[str]:
    """Return sentences on the progress of runs: numbers, verdicts, time left, command to repeat."""
    statuses = Counter(outcome.status for outcome in found.outcomes)
    verdicts = Counter(outcome.verdict for outcome in found.outcomes if outcome.verdict)
    said = [messages.numbers(statuses["done"], statuses["failed"], found.num_left)]
    if verdicts:
        said.append(messages.verdicts(verdicts))
    if found.num_left:
        left = None if found.left_s is None else duration(found.left_s)
        said.append(messages.going_on(duration(found.since_s), left))
        said.append(messages.repeat(found.command))
    if found.begun:
        said.append(messages.begun(found.begun))
    return said


def _of_one_run(folder: Path) -> str:
    is_open = (folder / HIDDEN / MANIFEST).exists()
    if (folder / "summary.json").exists():
        return messages.has_result(str(folder), is_first=is_open)
    if is_open:
        return messages.interrupted(str(folder))
    what, remedy = messages.no_runs(str(folder))
    raise RunError(what, remedy=remedy)
