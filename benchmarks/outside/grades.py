"""Is a law graded by what it predicts, whatever one record is like?

    python -m benchmarks.outside.grades [--campaigns 20] [--seed N] [--law LAW ...] [--out FILE]

Campaigns of a strong law are drawn, and identified with a stated law; the test of the middle level
is held out. In turn the stated law is the right one, another one, the right one where one fitted
record has ten times the noise, and the right one where the frequency of one fitted record is 0.01 %
higher. The table has the grades of each case, the share of the held-out values inside the 99 %
bands, and the bands' width: half width over 2.58 times the rms error, one of a calibrated Gaussian.
For sweeps the band is that of one repeat, and the error that of the mean of two: 1.41 is right.
"""

import json
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from .by_law import judge_each
from .campaigns import CAMPAIGNS, Campaign, Member
from .files import TIMES, write_campaign
from .plants import COMMON, Rng
from .records import KINDS, Choice, recorded

CASES = ("right", "wrong", "noisy", "shifted")
NAMES = ("decays", "sweeps")
DAMPING = (4e-3, 0.05)  # lighter ones take long records, and minutes
NOISE = (1e-4, 0.02)
LOUDER, SHIFT = 10.0, 1e-4  # times the noise, relative change of frequency
REACH = 2.576  # standard deviations from the centre of a 99 % band to its ends
# Two chains of few draws suffice for bands.
SETTINGS = {"num_chains": 2, "num_samples": 200}


def drawn(rng: Rng, law: str, name: str, case: str) -> Campaign:
    """Draw a campaign of two repeats at each of three levels; disturb a record as the case says."""
    while True:
        try:
            made = CAMPAIGNS[name](rng, Choice(law=law, strong=True, zeta=DAMPING, noise=NOISE))
            tests = dict.fromkeys(one.test for one in made.members)
            pairs = [
                one for test in tests for one in [m for m in made.members if m.test == test][:1] * 2
            ]
            return replace(made, members=tuple(_noisy(rng, pairs, made, case)))
        except FloatingPointError:
            continue


def _noisy(rng: Rng, perfect: Sequence[Member], made: Campaign, case: str) -> list[Member]:
    """Return the records with noise; the first record is disturbed as the case says."""
    first = perfect[0].drawn
    if case == "shifted":
        one = made.specimen
        # At the same sampling rate: files of one test state it together.
        moved = replace(one, hz=one.hz * (1 + SHIFT), per_period=one.per_period / (1 + SHIFT))
        first = KINDS[first.kind](rng, moved, perfect[0].level)
    if case == "noisy":
        first = replace(first, noise=LOUDER * first.noise)
    every = [first, *(one.drawn for one in perfect[1:])]
    return [
        replace(one, drawn=recorded(rng, each)) for one, each in zip(perfect, every, strict=True)
    ]


def judged(rng: Rng, law: str, number: int, folder: Path) -> dict[str, Any]:
    """Identify a campaign, and return grade, errors, coverage and width of its held-out test."""
    name = NAMES[number // len(CASES) % len(NAMES)]
    case = CASES[number % len(CASES)]
    stated = law if case != "wrong" else str(rng.choice([one for one in COMMON if one != law]))
    while True:  # until no record is too short to be used
        made = drawn(rng, law, name, case)
        path = write_campaign(folder, made, rng, TIMES)
        if _is_usable(path):
            break
    middle = list(dict.fromkeys(one.test for one in made.members))[1]
    settings = {**SETTINGS, "hold_out": [middle]}
    laws = [] if stated == "linear" else [stated]
    lines = [f"{key} = {json.dumps(value)}" for key, value in settings.items()]
    path.write_text(
        "\n".join([path.read_text(), "[identify]", *lines, f"\n[joint]\nlaws = {json.dumps(laws)}"])
        + "\n"
    )
    row = {"law": law, "name": name, "case": case, "stated": stated}
    row |= {"zeta": made.specimen.zeta, "noise": made.specimen.noise}
    return row | _identified(path, middle)


def _is_usable(path: Path) -> bool:
    """Return whether `jbw check` finds no error in a campaign."""
    from jbw.campaign.check import check_campaign

    return check_campaign(path).exit_code == 0


def _identified(path: Path, middle: str) -> dict[str, Any]:
    """Return the grade of the law and the errors of the held-out test, or why there are none."""
    import jbw
    from jbw.errors import JbwError

    jbw.enable_x64()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            study = jbw.identify(jbw.load_campaign(path), report=lambda _: None)
            attrs = study.predict(middle).attrs
        except JbwError as error:
            return {"refused": f"{type(error).__name__}: {' '.join(str(error).split())}"}
    graded = [each for each in study.verdict.findings if each.code == "law_grade"]
    found = {"grade": graded[0].status if graded else "", "verdict": study.verdict.status}
    found |= {"findings": {each.code: each.status for each in study.verdict.findings}}
    width = float(attrs.get("half_width", np.nan)) / (REACH * float(attrs["nrmse"]))
    return found | {
        "error": float(attrs["nrmse"]), "held": float(attrs.get("coverage", np.nan)),
        "width": width, "withheld": str(attrs.get("withheld", "")),
    }  # fmt: skip


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Return a table in Markdown: grades, coverage and band widths of each case."""
    words = {"ok": "predictive", "usable": "approximate", "failed": "not predictive"}
    words |= {"not assessed": "not assessed", "": "none"}
    heads = (*words.values(), "refused", "held [%]", "width, median", "width, largest")
    lines = [f"| case | campaigns | {' | '.join(heads)} |", "|---" * (2 + len(heads)) + "|"]
    for case in CASES:
        own = [row for row in rows if row["case"] == case]
        graded = [row for row in own if "refused" not in row]
        counts = [sum(row["grade"] == word for row in graded) for word in words]
        held = 100 * np.nanmean([row["held"] for row in graded] or [np.nan])
        widths = [row["width"] for row in graded] or [np.nan]
        cells = [*counts, len(own) - len(graded), f"{held:.1f}"]
        cells += [f"{np.nanmedian(widths):.2f}", f"{np.nanmax(widths):.2f}"]
        lines.append(f"| {case} | {len(own)} | {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw and identify campaigns, and print the table."""
    judge_each("grades", judged, table, arguments)


if __name__ == "__main__":
    main()
