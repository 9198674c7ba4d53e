"""The progress of many runs, in `outcomes.jsonl`: one line per call and one per ended campaign.

The file is only appended to. Of several lines on one campaign the last one counts, and a line that
a kill has torn is skipped.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, NamedTuple

from jbw.run.folder import HIDDEN, MANIFEST

OUTCOMES = "outcomes.jsonl"


@dataclass(frozen=True)
class RunOutcome:
    """The outcome of one of several campaigns: its run, status, verdict and error.

    Attributes:
        campaign: Path of the campaign file.
        folder: Folder of the run, for `jbw.load_study`.
        status: "done" or "failed"; a run whose verdict is not ok is also done.
        verdict: Verdict of the run; empty where it failed.
        error: The error and its remedy, in one or two sentences; empty where the run is done.
        exit_code: Exit code of `jbw identify` for this campaign; 0 where the verdict is ok or
            usable.
        began: "new", "resumed", or "finished" where the run had ended before this call.
        warnings: Warnings during the run, each sentence once.
        wall_time_s: Duration of this call's part of the run [s].
    """

    campaign: str
    folder: str
    status: Literal["done", "failed"]
    verdict: str = ""
    error: str = ""
    exit_code: int = 0
    began: Literal["new", "resumed", "finished"] = "new"
    wall_time_s: float = 0.0
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Call:
    """One call for many campaigns: its command and how many campaigns were still to be run."""

    command: str
    num_open: int


class FleetProgress(NamedTuple):
    """How far the runs in a folder are.

    Attributes:
        outcomes: Last outcome of each campaign, in the order in which the campaigns ended.
        num_left: Number of campaigns of the last call that have not ended.
        left_s: Estimated time until they have ended [s], at the rate of the last call; None before
            its first outcome.
        since_s: Time since the last line was written [s].
        begun: Names of runs that have begun and have no result.
        command: Command of the last call.
    """

    outcomes: tuple[RunOutcome, ...]
    num_left: int
    left_s: float | None
    since_s: float
    begun: tuple[str, ...]
    command: str


def note(out: Path, what: Call | RunOutcome) -> None:
    """Append a line to the outcomes in the folder `out`; raise an OSError if it is not writable."""
    out.mkdir(parents=True, exist_ok=True)
    line = {"time": datetime.now(UTC).isoformat(), **asdict(what)}
    with (out / OUTCOMES).open("a", encoding="utf-8") as file:
        # An earlier process may have been killed in the middle of a line.
        begin = "\n" if isinstance(what, Call) and file.tell() else ""
        file.write(f"{begin}{json.dumps(line, ensure_ascii=False)}\n")


def progress(out: Path) -> FleetProgress | None:
    """Return how far the runs in the folder `out` are; None if it records no outcomes."""
    lines = _lines(out)
    if not lines:
        return None
    called = max((i for i, (_, what) in enumerate(lines) if isinstance(what, Call)), default=0)
    begun_at, call = lines[called]
    ended = [what for _, what in lines[called:] if isinstance(what, RunOutcome)]
    command, num_open = (call.command, call.num_open) if isinstance(call, Call) else ("", 0)
    num_left = max(num_open - len(ended), 0)
    # Failed campaigns of earlier calls are among those that the last call runs.
    earlier = [what for _, what in lines[:called] if isinstance(what, RunOutcome)]
    kept = [what for what in earlier if what.status == "done" or not num_left]
    last: dict[str, RunOutcome] = {}
    for outcome in (*kept, *ended):
        last.pop(outcome.campaign, None)
        last[outcome.campaign] = outcome
    spent = (lines[-1][0] - begun_at).total_seconds()
    paths = sorted(path.parent.parent for path in out.glob(f"*/{HIDDEN}/{MANIFEST}"))
    return FleetProgress(
        outcomes=tuple(last.values()),
        num_left=num_left,
        left_s=num_left * spent / len(ended) if ended else None,
        since_s=(datetime.now(UTC) - lines[-1][0]).total_seconds(),
        begun=tuple(path.name for path in paths if not (path / "summary.json").exists()),
        command=command,
    )


def _lines(out: Path) -> list[tuple[datetime, Call | RunOutcome]]:
    """Return all readable lines with their times; an empty list if no file can be read."""
    try:
        text = (out / OUTCOMES).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return []
    found = []
    for line in text.splitlines():
        try:
            content = json.loads(line)
            time = datetime.fromisoformat(content.pop("time"))
            found.append((time, _line_of(content)))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            continue
    return found


def _line_of(content: Mapping[str, Any]) -> Call | RunOutcome:
    kind = Call if content.keys() == {field.name for field in fields(Call)} else RunOutcome
    return kind(**content)
