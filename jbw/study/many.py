"""`jbw.identify_many`: the identification of many campaigns, each in a separate folder.

Every campaign becomes an ordinary run, which can be resumed separately. A repeated call continues:
a finished run is not repeated while its campaign and data are unchanged, an interrupted run resumes
from its last checkpoint, and a campaign that fails stops no other.
"""

import logging
import os
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jbw.campaign.load import Campaign
from jbw.errors import ConfigError, DataError, JbwError, RunError
from jbw.report.formats import formats_of
from jbw.report.messages import stages
from jbw.report.messages import study as messages
from jbw.report.result import read_result
from jbw.results.run import RunSummary
from jbw.run.files import hash_of
from jbw.run.folder import HIDDEN, MANIFEST, begin, reopen, require_same
from jbw.run.manifest import KEPT, Keep, Manifest, command_line, read_manifest
from jbw.run.outcomes import OUTCOMES, Call, RunOutcome, note, progress
from jbw.run.session import prepare_process
from jbw.study.resumable import carried_out, digest_of
from jbw.study.workers import Executor, in_processes, submitted

logger = logging.getLogger("jbw")
SET_ASIDE = 2  # number of killed processes after which a campaign is no longer run with others
# A run of a campaign file with this name is named after the file's folder.
PLAIN = "campaign"


@dataclass(frozen=True)
class Task:
    """One campaign to identify, in a form that can be sent to a worker process."""

    campaign: str
    folder: str
    seed: int | None
    allow_outside: bool
    command: str
    figures: tuple[str, ...] = ()
    quick: bool = False
    keep: Keep = "report"


def identify_many(
    campaigns: Iterable[str | Path | Campaign],
    out: str | Path = "runs",
    *,
    executor: Executor | None = None,
    workers: int | None = None,
    seed: int | None = None,
    allow_outside: bool = False,
    figures: Sequence[str] = (),
    quick: bool = False,
    keep: Keep = "report",
    report: Callable[[str], None] = logger.info,
    command: str | None = None,
) -> list[RunOutcome]:
    """Identify many campaigns in parallel; a repeated call continues an interrupted one.

    Args:
        campaigns: Campaign files, or campaigns that were loaded from files.
        out: Folder of the runs. Each run is named after its campaign's file or, where that is
            `campaign.toml`, after the file's folder.
        executor: An object with a `submit` like that of Python's executors; processes of this
            machine when None. Files and folders must have the same paths on other machines.
        workers: Number of processes of this machine; half its processors when None. Not allowed
            together with `executor`.
        seed: Seed of every campaign; when None each campaign's own.
        allow_outside: Whether `files` of campaigns may point out of their folders.
        figures: File formats in which the figures of each run are saved: "png", "svg", "pdf".
        quick: Whether each run ends with its fit, like `jbw identify --quick`; a later call without
            it continues to the posterior.
        keep: "report", or "posterior" for runs without report and figures, which take less time
            and room; `jbw report` writes them later.
        report: A function that is called with one sentence whenever a campaign ends.
        command: The typed command, for the summaries; that of this process when None.

    Returns:
        One outcome per campaign, in the order of `campaigns`.

    Raises:
        ConfigError: No campaign is given, two would write to one folder, one has no file, or a
            format is unknown.

    Examples:
        Each campaign becomes a run of its own, and the same call goes on after an interruption:

        >>> import jbw; jbw.enable_x64()
        >>> from concurrent.futures import ThreadPoolExecutor
        >>> campaign = jbw.rig.measure(tests=["sweep_0p20V"], repeats=2, fs=256.0, noise_ratio=0.02)
        >>> path = jbw.rig.write(campaign, "beam_1")
        >>> with ThreadPoolExecutor(1) as executor:
        ...     outcomes = jbw.identify_many([path], "runs", executor=executor, quick=True)
        >>> print([(outcome.status, outcome.verdict) for outcome in outcomes])
        [('done', 'not assessed')]
    """
    if executor is not None and workers is not None:
        raise ConfigError(
            "Arguments `executor` and `workers` must not be given together.",
            why="An executor has a fixed number of workers.",
            remedy="State the number of workers where you create the executor.",
        )
    if keep not in KEPT:
        raise ConfigError(f"Argument `keep` must be one of {', '.join(KEPT)}, but is {keep!r}.")
    command, out = command or command_line(), Path(out)
    formats = formats_of(figures, "Argument `figures`")
    tasks = [
        Task(str(path), str(folder), seed, allow_outside, command, formats, quick, keep)
        for path, folder in _folders([_file_of(campaign) for campaign in campaigns], out).items()
    ]
    outcomes: dict[Task, RunOutcome] = {}
    unwritten: set[str] = set()

    def noted(what: Call | RunOutcome) -> None:
        try:
            note(out, what)
        except OSError as error:  # The runs themselves do not need this file.
            sentence = messages.outcomes_not_written(str(out / OUTCOMES), str(error.strerror))
            if sentence not in unwritten:
                report(sentence)
            unwritten.add(sentence)

    def ended(task: Task, outcome: RunOutcome) -> None:
        outcomes[task] = outcome
        for sentence in outcome.warnings:
            report(f"warning: {Path(task.folder).name}: {sentence}")
        report(_sentence(outcome, list(outcomes.values()), len(tasks)))

    before = progress(out)
    known = {one.campaign for one in before.outcomes if one.status == "done"} if before else set()
    open_tasks: list[Task] = []
    for task in tasks:
        outcome = _finished_before(task)
        if outcome is None:
            open_tasks.append(task)
            continue
        if outcome.status == "failed" or task.campaign not in known:
            noted(outcome)
        ended(task, outcome)
    noted(Call(command, len(open_tasks)))
    if executor is not None:
        jobs = submitted(executor, run_task, open_tasks)
    else:
        jobs = in_processes(run_task, open_tasks, workers or max(1, (os.cpu_count() or 1) // 2))
    for task, future in jobs:
        outcome = _outcome_of(task, future)
        noted(outcome)
        ended(task, outcome)
    return [outcomes[task] for task in tasks]


def run_task(task: Task) -> RunOutcome:
    """Begin or resume one run in a worker process; return its outcome even if it fails."""
    with warnings.catch_warnings(record=True) as warned:
        outcome = _run(task)
    messages_shown = tuple(dict.fromkeys(str(warning.message) for warning in warned))
    return replace(outcome, warnings=messages_shown)


def _run(task: Task) -> RunOutcome:
    started, began = time.perf_counter(), "new"
    try:
        prepare_process()
        folder = Path(task.folder)
        if (folder / HIDDEN / MANIFEST).exists():
            began, run = "resumed", reopen(folder, allow_outside=task.allow_outside)
        else:
            manifest = Manifest(
                task.command, task.campaign, seed=task.seed, allow_outside=task.allow_outside,
                quick=task.quick, figures=task.figures, keep=task.keep,
            )  # fmt: skip
            run = begin(folder, manifest)
        if run is None:  # Another process has finished this run in the meantime.
            return _finished_before(task) or _failed(task, RunError(f"{folder} has no result."))
        try:
            if began == "resumed":
                _require_asked(task, run.manifest.campaign, run.manifest.seed)
                require_same(run)
                if run.manifest.num_killed >= SET_ASIDE:
                    raise _set_aside(task)
                run.note(replace(run.manifest, quick=task.quick, keep=task.keep))
            with run.surviving(), run.interruption.heard(lambda: f"Saved in {folder}."):
                summary, _ = carried_out(run, logger.info)
        except JbwError:
            run.discard()
            raise
        finally:
            run.close()
    except Exception as error:  # The failure of one campaign must not stop the others.
        return _failed(task, error, time.perf_counter() - started)
    return _done(task, summary, began, time.perf_counter() - started)


def _done(task: Task, summary: RunSummary, began: Any, seconds: float = 0.0) -> RunOutcome:
    verdict = summary.verdict.status
    code = 0 if verdict in ("ok", "usable") or summary.quick is not None else 4
    return RunOutcome(
        task.campaign, task.folder, "done", verdict, "", code, began, round(seconds, 2)
    )


def _failed(task: Task, error: BaseException, seconds: float = 0.0) -> RunOutcome:
    code = error.exit_code if isinstance(error, JbwError) else 1
    reason = (
        " ".join(str(error).split())
        if isinstance(error, JbwError)
        else f"Internal error: {type(error).__name__}: {error}"
    )
    return RunOutcome(
        task.campaign, task.folder, "failed", "", reason, code, "new", round(seconds, 2)
    )


def _file_of(campaign: str | Path | Campaign) -> Path:
    if not isinstance(campaign, Campaign):
        return Path(campaign).absolute()
    if not campaign.path.is_file():
        raise ConfigError(
            f"Campaign `{campaign.name}` has no file.",
            why="A worker process reads the campaign from its file.",
            remedy="Write the records and the file of the campaign, or identify the campaign with "
            "jbw.identify.",
        )
    return campaign.path.absolute()


def _folders(files: Sequence[Path], out: Path) -> dict[Path, Path]:
    """Return the run folder of each campaign file; raise an error if two files share a folder."""
    if not files:
        raise ConfigError("No campaign is given.", remedy="Give one campaign file or more.")
    names = [file.parent.name if file.stem == PLAIN else file.stem for file in files]
    for name, count in Counter(names).items():
        if count > 1:
            first, other, *_ = [str(f) for f, n in zip(files, names, strict=True) if n == name]
            raise ConfigError(
                f"{first} and {other} would both write to {out / name}.",
                why="A run has the name of its campaign file, or of the folder that contains the "
                f"campaign file {PLAIN}.toml.",
                remedy="Rename one of the two campaign files, name each campaign only once, or "
                "identify the campaigns separately with different `out`.",
            )
    return {f: (out / name).absolute() for f, name in zip(files, names, strict=True)}


def _finished_before(task: Task) -> RunOutcome | None:
    """Return the outcome of a campaign whose run is finished; None if it is not finished.

    A finished run has no manifest, except after a first answer (`quick`).
    """
    folder = Path(task.folder)
    is_open = (folder / HIDDEN / MANIFEST).exists()
    if (is_open and not task.quick) or not (folder / "summary.json").is_file():
        return None
    try:
        summary, _ = read_result(folder, "posterior")
        _require_same_result(task, summary)
    except JbwError as error:
        return _failed(task, error)
    return _done(task, summary, "finished")


def _require_same_result(task: Task, summary: RunSummary) -> None:
    """Raise an error if a finished run has another campaign, data or seed than requested."""
    remedy = messages.identify_anew(str(task.folder))
    _require_asked(task, summary.campaign_file, None)
    if task.seed is not None and summary.seed != task.seed:
        raise RunError(
            f"The run in {task.folder} has the seed {summary.seed}, not {task.seed}.",
            remedy=remedy,
        )
    try:
        text = Path(task.campaign).read_text(encoding="utf-8")
        changed = [n for n, was in summary.inputs.items() if hash_of(Path(n)) != was]
    except OSError as error:
        raise DataError(
            f"{error.filename} cannot be read, so that the run in {task.folder} cannot be checked: "
            f"{error.strerror}.",
            remedy=f"Restore {error.filename}, or leave the campaign {task.campaign} out.",
        ) from error
    if summary.campaign_sha256 not in ("", digest_of(text)):
        changed.insert(0, task.campaign)
    if changed:
        raise DataError(f"{changed[0]} changed since {task.folder} was finished.", remedy=remedy)


def _require_asked(task: Task, campaign: str | None, seed: int | None) -> None:
    """Raise an error if an unfinished run has another campaign or seed than requested."""
    if campaign is not None and Path(campaign).resolve() != Path(task.campaign).resolve():
        raise RunError(
            f"The folder {task.folder} contains a run of {campaign}, not of {task.campaign}.",
            why="Results of two runs must not be mixed.",
            remedy="Choose another folder `out`.",
        )
    if task.seed is not None and seed is not None and seed != task.seed:
        raise RunError(
            f"The run in {task.folder} was begun with the seed {seed}, not {task.seed}.",
            remedy=f"Continue with the seed {seed}, or choose another folder `out`.",
        )


def _set_aside(task: Task) -> RunError:
    """Return the error of a campaign that has killed the processes which ran it."""
    return RunError(
        f"The campaign is set aside, because {SET_ASIDE} processes that ran it were killed.",
        why="Perhaps its memory was exhausted.",
        remedy=messages.identify_alone(task.campaign, task.folder, quick=task.quick),
    )


def _outcome_of(task: Task, future: Any) -> RunOutcome:
    """Return a campaign's outcome from its worker's result; a lost worker counts as a failure."""
    try:
        return future.result()
    except Exception as error:  # The executor lost a worker or a machine.
        with suppress(JbwError):
            if read_manifest(Path(task.folder) / HIDDEN / MANIFEST).num_killed >= SET_ASIDE:
                return _failed(task, _set_aside(task))
        why = f"{type(error).__name__} {error}".strip()
        return _failed(task, RunError(
            f"The worker of the run was lost: {why}.",
            remedy="Identify the campaign again: the run continues from its last checkpoint.",
        ))  # fmt: skip


def _sentence(outcome: RunOutcome, so_far: Sequence[RunOutcome], total: int) -> str:
    failed = sum(earlier.status == "failed" for earlier in so_far)
    name = Path(outcome.folder).name
    if outcome.status == "failed":
        result = f"failed: {outcome.error}"
    elif outcome.began == "finished":
        result = stages.finished_before(outcome.verdict)
    else:
        result = f"{outcome.began}, verdict {outcome.verdict}, {outcome.wall_time_s:.0f} s"
    failures = f", {failed} of them failed" if failed else ""
    return f"{len(so_far)} of {total}{failures}: {name} {result}"
