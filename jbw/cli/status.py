"""The command on the progress of runs: `jbw status RUNS`."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import click

from jbw.cli.options import json_option, run_argument
from jbw.cli.printing import answer, duration
from jbw.errors import ConfigError
from jbw.report.messages import status as messages
from jbw.report.messages.commands import finished
from jbw.report.table import Table, digits, table, words
from jbw.run.folder import HIDDEN, MANIFEST
from jbw.run.outcomes import FleetProgress, RunOutcome, progress

MOST_ROWS = 40  # largest number of campaigns of which each has a line in the table


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
    answer(json_, record, *sentences(found), outcomes_table(found.outcomes))


def outcomes_table(outcomes: Sequence[RunOutcome]) -> Table:
    """Return the table of several campaigns, with one line each; of many, only the failed ones."""
    done = sum(outcome.status == "done" for outcome in outcomes)
    shown = [o for o in outcomes if len(outcomes) <= MOST_ROWS or o.status == "failed"]
    return table(
        f"{done} of {len(outcomes)} campaigns are identified",
        [{**asdict(outcome), "run": Path(outcome.folder).name} for outcome in shown],
        words("run", "run"),
        words("status", "status"),
        words("verdict", "verdict"),
        digits("s", "wall_time_s"),
        words("error", "error", "left wrap"),
    )


def sentences(found: FleetProgress) -> list[str]:
    """Return sentences on the progress of runs: numbers, verdicts, time left, command to repeat."""
    done = sum(outcome.status == "done" for outcome in found.outcomes)
    verdicts = Counter(outcome.verdict for outcome in found.outcomes if outcome.verdict)
    said = [messages.numbers(done, len(found.outcomes) - done, found.num_left)]
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
    has_result, page = (folder / "summary.json").exists(), folder / "report.html"
    if has_result and not is_open:
        return finished(str(folder), str(page) if page.exists() else "")
    if is_open:
        return (messages.of_the_fit if has_result else messages.interrupted)(str(folder))
    what, remedy = messages.no_runs(str(folder))
    raise ConfigError(what, remedy=remedy)
