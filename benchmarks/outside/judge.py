"""Does jbw find no fault in sound records, and name the fault in others? Each run has a new seed.

Records of every kind and whole campaigns are drawn from outside jbw, written as files, and given to
`check` and `look`, campaigns on request to `init` and `identify --quick` as well. Outcomes are
appended to a file, a line each, so that a run can be analysed, and any of them drawn again.

    python -m benchmarks.outside [--sound 20] [--mishandled 1] [--campaigns 2] [--seed S]
        [--kind decay ...] [--law bouc_wen ...] [--fault "held samples" ...] [--draft] [--quick]
        [--stretch] [--times exact ...] [--workers 2] [--keep FOLDER] [--out outcomes.jsonl]

`--sound` counts records of a kind, `--mishandled` records of a fault and kind, `--campaigns` sound
and as many mishandled campaigns of a name. `--only N` repeats one outcome of a seed by its number.
"""

import argparse
import json
import re
import secrets
import tempfile
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .bound import bound
from .campaigns import (
    CAMPAIGNS,
    OF_FILES,
    Campaign,
    Member,
    mishandled_campaign,
    sound_campaign,
    stretched,
)
from .doors import CUT, Finding, Row, Said, ask, draft, paste, quick
from .faults import FAULTS, mishandled
from .files import TIMES, truth_of_record, write_campaign
from .outcomes import NEUTRAL, tables
from .records import ANY, KINDS, Choice, sound, specimen

# smallest errors that jbw's documentation states, relative to zeta: of frequency, and of damping
FLOOR = {"decay": (0.003, 0.003), "sweep": (0.01, 0.003)}
AVERAGING = {"decay": 0.003, "sweep": 0.05}  # its constant c of first-order averaging
# largest harmless errors of frequency and damping, relative to zeta
RIGHT_HZ, RIGHT_ZETA = 0.3, 0.2
# largest harmless errors: relative for stiffness, in critical damping for losses
RIGHT_STIFFNESS, RIGHT_LOSS = 0.05, 0.005
SURE = 2.5758  # standard deviations to either side of a 99 % interval
EVERY = 7  # the bound takes most of the time, so one outcome in seven is compared with it


class Job(NamedTuple):
    """A record or campaign to draw, by its number under a seed."""

    number: int
    what: str  # "sound" or "mishandled"
    kind: str  # kind of the record, or name of the campaign
    fault: str
    law: str | None
    is_campaign: bool


@dataclass(frozen=True)
class Options:
    """The options with which all records and campaigns are judged."""

    seed: int
    draft: bool
    quick: bool
    keep: Path | None
    times: tuple[str, ...] = TIMES
    stretch: bool = False


def jobs(chosen: argparse.Namespace) -> list[Job]:
    """Return all records and campaigns to draw; sound ones take the chosen laws in turn."""
    laws: Sequence[str | None] = chosen.law or [None]
    kinds = chosen.kind or list(KINDS)
    found = []

    def add(what: str, kind: str, fault: str, law: str | None, *, is_campaign: bool) -> None:
        found.append(Job(len(found), what, kind, fault, law, is_campaign))

    for kind in kinds:
        if kind in KINDS:
            for i in range(chosen.sound):
                add("sound", kind, "", laws[i % len(laws)], is_campaign=False)
    for fault in FAULTS.values():
        if chosen.fault and fault.name not in chosen.fault:
            continue
        for kind in fault.kinds:
            for i in range(chosen.mishandled if kind in kinds else 0):
                add("mishandled", kind, fault.name, laws[i % len(laws)], is_campaign=False)
    for name in CAMPAIGNS:
        for what in ("sound", "mishandled"):
            for i in range(0 if chosen.kind and name not in chosen.kind else chosen.campaigns):
                add(what, name, "", laws[i % len(laws)], is_campaign=True)
    return found


def drawn(job: Job, seed: int) -> Campaign:
    """Draw a job's campaign; a record is a campaign of one test."""
    rng = np.random.default_rng([seed, job.number])
    if job.is_campaign:
        if job.what == "sound":
            return sound_campaign(rng, job.kind, replace(ANY, law=job.law))
        return mishandled_campaign(rng, job.kind)
    choice = Choice(law=job.law)
    if job.what == "sound":
        record = sound(rng, job.kind, choice)
    else:
        visible = replace(FAULTS[job.fault].choice, law=job.law)
        record = mishandled(rng, job.kind, job.fault, visible)
    one = specimen(np.random.default_rng(0), job.kind)  # needed only for the form of a campaign
    one = replace(one, law=record.law, plant=record.plant)
    return Campaign(job.kind, one, (Member("one", record, 1.0),), {}, job.fault, record.size)


def outcome(job: Job, options: Options) -> dict[str, Any]:
    """Draw, write, check and judge; an error of the benchmark itself is an outcome, too."""
    try:
        made = drawn(job, options.seed)
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary) / "campaign"
            if options.keep:
                folder = options.keep / f"{options.seed}-{job.number}"
            return _judged(job, options, made, folder)
    except Exception:
        return {**job._asdict(), "seed": options.seed, "benchmark": traceback.format_exc()}


def _judged(job: Job, options: Options, made: Campaign, folder: Path) -> dict[str, Any]:
    rng = np.random.default_rng([options.seed, job.number, 1])
    path = write_campaign(folder, made, rng, options.times)
    said = ask(path)
    first = made.members[0].drawn
    named = _pattern(made)
    accusing = [one for one in said.findings if not NEUTRAL.search(one.what)]
    row: dict[str, Any] = {
        **job._asdict(), "seed": options.seed, "fault": made.fault, "size": made.size,
        "law": made.law, "strong": first.strong, "zeta": first.zeta, "hz": first.hz,
        "fs": first.fs, "noise": first.noise, "bits": first.bits, "response": first.response,
        "samples": len(first.x), "records": len(made.members),
        "findings": [one._asdict() for one in said.findings], "statements": said.statements,
        "errors": said.errors, "seconds": said.seconds,
        "accused": bool(accusing or said.errors), "nonlinear": said.nonlinear,
        "read": bool(said.rows or said.loops),
    }  # fmt: skip
    # A remark on a short record names an early end, a remark on an unreadable record may name any
    # fault, and a remark on a cut before the blow names that.
    texts = [f"{one.what} {one.remedy}" for one in said.findings] + said.errors
    texts += [
        sentence
        for sentence in said.statements
        if sentence.startswith("Frequency and damping could not be determined") or CUT in sentence
    ]
    row["named"] = bool(made.fault) and any(named.search(text) for text in texts)
    row |= _errors(made, said)
    if job.number % EVERY == 0 and row.get("inside_hz"):
        row |= _widths(made, said)
    if made.fault:
        row |= _remedies(made, said, accusing, path)
    if options.stretch:
        factor = float(np.exp(rng.uniform(np.log(0.02), np.log(100))))
        again = folder.with_name(f"{folder.name}-stretched")
        rng = np.random.default_rng([options.seed, job.number, 1])  # the same file format as before
        other = ask(write_campaign(again, stretched(made, factor), rng, options.times))
        row["stretched"] = {"factor": factor, "same": _in_words(said) == _in_words(other),
                            "findings": [one._asdict() for one in other.findings]}  # fmt: skip
    if options.draft:
        text, asked, checked = draft(folder / "draft", sorted(folder.glob("*.csv")))
        refused = [one.what for one in checked.findings if one.severity == "error"]
        row["draft"] = {"text": text, "asked": asked, "errors": checked.errors, "refused": refused}
    if options.quick and job.is_campaign:
        row["quick"] = _quick(made, path)
    return row


def _in_words(said: Said) -> list[str]:
    """Return the texts of a report without numbers, sorted independently of them."""
    said_of = [*(one.what for one in said.findings), *said.statements, *said.errors]
    return sorted(
        re.sub(r"[-+]?\d[\d.]*(e[-+]?\d+)?( [munk]?(m|s|Hz)\b)?", "#", x) for x in said_of
    )


def _pattern(made: Campaign) -> re.Pattern[str]:
    """Return the pattern of sentences that name a fault; without a fault it never matches."""
    if made.fault in OF_FILES:
        return re.compile(OF_FILES[made.fault], re.I)
    return FAULTS[made.fault].named if made.fault else re.compile(r"(?!)")


def _errors(made: Campaign, said: Said) -> dict[str, Any]:
    """Return errors of frequency and damping, and whether intervals contain the truth."""
    by_test = {one.test: one.drawn for one in reversed(made.members)}
    if said.loops:
        return _of_loops(made, said)
    hz, zeta, inside_hz, inside_zeta = [], [], [], []
    for row in said.rows:
        drawn = by_test.get(row.test)
        if drawn is None or drawn.kind == "loop":
            continue
        true_hz, true_zeta = (float(x) for x in drawn.true_at(np.array(row.y)))
        hz.append((row.hz / true_hz - 1) / true_zeta)
        zeta.append(row.zeta / true_zeta - 1)
        if np.isfinite(row.hz_sd):
            inside_hz.append(abs(row.hz - true_hz) <= SURE * row.hz_sd)
            inside_zeta.append(abs(row.zeta - true_zeta) <= SURE * row.zeta_sd)
    found: dict[str, Any] = {"hz_error": hz, "zeta_error": zeta}
    if inside_hz:
        found |= {"inside_hz": inside_hz, "inside_zeta": inside_zeta}
    return found


def _widths(made: Campaign, said: Said) -> dict[str, list[float]]:
    """Return stated standard deviations at the largest amplitude over the least possible ones."""
    by_test = {one.test: one.drawn for one in reversed(made.members)}
    of_hz, of_zeta = [], []
    for test, drawn in by_test.items():
        rows = [row for row in said.rows if row.test == test and np.isfinite(row.hz_sd)]
        if rows and not drawn.fault:
            top = max(rows, key=lambda row: row.y)
            least_hz, least_zeta = bound(drawn)
            hz_floor, zeta_floor = _floor(drawn.kind, rows, top)
            of_hz.append(top.hz_sd / (least_hz + hz_floor))
            of_zeta.append(top.zeta_sd / (least_zeta + zeta_floor))
    return {"width_hz": of_hz, "width_zeta": of_zeta}


def _floor(kind: str, rows: Sequence[Row], top: Row) -> tuple[float, float]:
    """Return the lower bounds of errors that the documentation states, docs/theory/readings.md."""
    of_hz, of_zeta = (x * top.zeta for x in FLOOR.get(kind, FLOOR["sweep"]))
    share = AVERAGING.get(kind, 0.0) + top.zeta
    hz_change = float(np.ptp([row.hz for row in rows]))
    zeta_change = float(np.ptp([row.zeta for row in rows]))
    averaged_hz = share * hz_change + hz_change**2 / top.hz + top.hz * top.zeta * zeta_change
    averaged_zeta = share * zeta_change + top.zeta * hz_change / top.hz
    return float(np.hypot(of_hz * top.hz, averaged_hz)), float(np.hypot(of_zeta, averaged_zeta))


def _of_loops(made: Campaign, said: Said) -> dict[str, list[float]]:
    """Return errors of secant stiffness (relative) and equivalent damping of largest cycles."""
    truth = {one.test: truth_of_record(one)["loops"][-1] for one in made.members}
    stiffness, damping = [], []
    for loop in said.loops:
        y, secant, work = truth[loop["test"]]
        stiffness.append(loop["stiffness"] / secant - 1)
        cycles = [one for one in loop["cycles"] if one["work"] is not None]
        if cycles:
            largest = max(cycles, key=lambda one: one["amplitude"])
            found = largest["work"] / (2 * np.pi * secant * y**2)
            damping.append(found - work / (2 * np.pi * secant * y**2))
    return {"stiffness_error": stiffness, "loss_error": damping}


def _is_right(found: dict[str, Any]) -> bool:
    """Return whether the results are harmless: most rows are near the truth or include it.

    A row includes the truth if its stated 99 % interval does.
    """
    if "stiffness_error" in found:
        worst = [
            np.max(np.abs(found[key]), initial=0.0) for key in ("stiffness_error", "loss_error")
        ]
        return bool(worst[0] < RIGHT_STIFFNESS and worst[1] < RIGHT_LOSS)
    if not found.get("hz_error"):
        return False
    near_hz = np.median(np.abs(found["hz_error"])) < RIGHT_HZ
    near_zeta = np.median(np.abs(found["zeta_error"])) < RIGHT_ZETA
    hold_hz, hold_zeta = (
        np.mean(found.get(key, [0])) > 0.5 for key in ("inside_hz", "inside_zeta")
    )
    return bool((near_hz or hold_hz) and (near_zeta or hold_zeta))


def _remedies(
    made: Campaign, said: Said, accusing: Sequence[Finding], path: Path
) -> dict[str, Any]:
    """Paste each line of the printed remedies separately, and check again."""
    text, found = path.read_text(), []
    for one in accusing:
        changed = paste(text, one)
        if changed is None:
            continue
        path.write_text(changed)
        again = ask(path)
        path.write_text(text)
        still = [x.what for x in again.findings if not NEUTRAL.search(x.what)] + again.errors
        right = _is_right(_errors(made, again))
        word = "cures" if right and not still else "still accused" if still else "wrong"
        found.append({"line": one.lines, "result": word, "still": still})
    return {"remedies": found, "right": _is_right(_errors(made, said))}


def _quick(made: Campaign, path: Path) -> dict[str, Any]:
    """Identify a campaign by a quick fit: errors by group, parameters, and error of omega_n."""
    try:
        summary, numbers = quick(path)
    except Exception as error:
        return {"refused": f"{type(error).__name__}: {' '.join(str(error).split())}"}
    found = {key: summary[key] for key in ("verdict", "quick") if key in summary}
    true = {"omega_n": 2 * np.pi * made.specimen.hz, "zeta": made.specimen.zeta}
    off = {
        name: (numbers[name][0] - value) / numbers[name][1]
        for name, value in true.items()
        if name in numbers and numbers[name][1] > 0
    }
    return found | {"parameters": numbers, "off_by_sd": off}


def parser() -> argparse.ArgumentParser:
    """Return the command-line parser."""
    lines = (__doc__ or "").splitlines()
    made = argparse.ArgumentParser(prog="python -m benchmarks.outside", description=lines[0])
    made.add_argument("--sound", type=int, default=20, help="sound records of a kind")
    made.add_argument("--mishandled", type=int, default=1, help="records of a fault and kind")
    made.add_argument("--campaigns", type=int, default=1, help="campaigns of a name, sound and not")
    made.add_argument("--kind", nargs="+", choices=[*KINDS, *CAMPAIGNS], help="kinds and campaigns")
    made.add_argument("--law", nargs="+", help="laws in turn, in place of drawing them")
    made.add_argument("--fault", nargs="+", choices=list(FAULTS), help="faults alone")
    made.add_argument("--seed", type=int, help="to repeat a run; a fresh one when left out")
    made.add_argument(
        "--times", nargs="+", choices=TIMES, default=TIMES, help="how time is written"
    )
    made.add_argument("--only", type=int, nargs="+", metavar="N", help="numbers of outcomes")
    made.add_argument("--draft", action="store_true", help="draft a campaign by init, and check it")
    made.add_argument("--stretch", action="store_true", help="the same motion in another time")
    made.add_argument("--quick", action="store_true", help="identify --quick of campaigns")
    made.add_argument("--workers", type=int, default=1, help="processes")
    made.add_argument("--keep", type=Path, help="folder that keeps the files")
    made.add_argument("--out", type=Path, help="file of JSON lines that outcomes are appended to")
    return made


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw, check and judge records, and print the tables."""
    chosen = parser().parse_args(arguments)
    seed = secrets.randbits(48) if chosen.seed is None else chosen.seed
    print(f"Seed {seed}: add `--seed {seed}` to repeat.\n", flush=True)
    todo = [job for job in jobs(chosen) if not chosen.only or job.number in chosen.only]
    options = Options(
        seed, chosen.draft, chosen.quick, chosen.keep, tuple(chosen.times), chosen.stretch
    )
    rows = []
    for row in _outcomes(todo, options, chosen.workers):
        rows.append(row)
        if chosen.out:
            with chosen.out.open("a") as file:
                file.write(json.dumps(row, default=_plain) + "\n")
    print("\n".join(tables(rows)))


def _outcomes(todo: Sequence[Job], options: Options, workers: int) -> Iterator[dict[str, Any]]:
    if workers == 1:
        yield from (outcome(job, options) for job in todo)
        return
    with ProcessPoolExecutor(workers) as pool:
        yield from pool.map(outcome, todo, [options] * len(todo), chunksize=4)


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)


if __name__ == "__main__":
    main()
