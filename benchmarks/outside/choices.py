"""Which law does jbw choose if none is stated, and does it predict as well as the right law?

    python -m benchmarks.outside.choices [--campaigns 20] [--seed N] [--law LAW ...] [--out FILE]

Campaigns of strong laws are drawn, and identified by `--quick` without a law. The strongest fitted
test of each kind has one more record, of fresh noise, that no fit sees. The error of a choice is
the rms over these records of the error over the rms of each; where another law was chosen, it
stands beside that of the right law.
"""

import json
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from .by_law import judge_each
from .campaigns import CAMPAIGNS, Campaign
from .files import TIMES, write_campaign
from .plants import Rng
from .records import Choice, recorded

NAMES = ("decays", "sweeps", "mixed")
NUM_DRAWS = 50
DAMPING = (4e-3, 0.05)  # records with less damping are long and take minutes
NOISE = (1e-4, 0.02)  # with more noise, any law predicts as well as the right one
AS_GOOD = 1.1  # largest error of an acceptable choice, relative to the right law's error


def drawn(rng: Rng, law: str, name: str) -> tuple[Campaign, Campaign]:
    """Draw a sound campaign, and one additional record of each of its tests."""
    while True:
        try:
            made = CAMPAIGNS[name](rng, Choice(law=law, strong=True, zeta=DAMPING, noise=NOISE))
            seen = [replace(one, drawn=recorded(rng, one.drawn)) for one in made.members]
            # names in order of level, the strongest first
            names = list(dict.fromkeys(one.test for one in made.members))
            first = [next(one for one in made.members if one.test == name) for name in names]
            kept = [replace(one, drawn=recorded(rng, one.drawn)) for one in first]
        except FloatingPointError:
            continue
        return replace(made, members=tuple(seen)), replace(made, members=tuple(kept))


def judged(rng: Rng, law: str, name: str, folder: Path) -> dict[str, Any]:
    """Identify a campaign without stated law and, if another is chosen, with the right one."""
    made, kept = drawn(rng, law, name)
    layout = int(rng.integers(2**32))  # seed for the file format of both campaigns
    path = write_campaign(folder / "seen", made, np.random.default_rng(layout), TIMES)
    unseen = write_campaign(folder / "kept", kept, np.random.default_rng(layout), TIMES)
    row = {"law": law, "name": name, "zeta": made.specimen.zeta, "noise": made.specimen.noise}
    chosen = _identified(path, unseen)
    row |= {"chosen": chosen}
    if law not in chosen.get("laws", []):
        path.write_text(f"{path.read_text()}\n[joint]\nlaws = {_laws(law)}\n")
        row["right"] = _identified(path, unseen)
    return row


def _laws(law: str) -> str:
    return "[]" if law == "linear" else json.dumps([law])


def _identified(path: Path, unseen: Path) -> dict[str, Any]:
    """Return laws and prediction errors of a quick answer, by kind of test; or its error."""
    import jbw
    from jbw.errors import JbwError
    from jbw.report.opening import contradictions

    jbw.enable_x64()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            study = jbw.identify(jbw.load_campaign(path), quick=True, report=lambda _: None)
            fitted = {row["test"] for row in study.record["tests"] if row["fitted"]}
            laws = json.loads(str(study.tree.attrs["laws"]))
            errors: dict[str, float] = {}  # error of the strongest fitted test of each kind
            for test in jbw.load_campaign(unseen).tests:
                if test.name in fitted and test.kind not in errors:
                    errors[test.kind] = float(study.predict(test, NUM_DRAWS).attrs["nrmse"])
        except JbwError as error:
            return {"refused": f"{type(error).__name__}: {' '.join(str(error).split())}"}
    return {
        "laws": laws, "errors": errors, "contradicted": contradictions(study.result, study.tree)
    }  # fmt: skip


def error_of(found: dict[str, Any]) -> float:
    """Return the rms of the errors of all kinds; infinite for a refused campaign."""
    errors = list(found.get("errors", {}).values())
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else np.inf


def verdict(row: dict[str, Any]) -> str:
    """Return whether a choice is right, as good, worse, or was refused with either law."""
    if "right" not in row:
        return "right"
    ours, theirs = error_of(row["chosen"]), error_of(row["right"])
    if np.isinf(ours):
        return "refused" if np.isinf(theirs) else "refused alone"
    return "as good" if ours <= AS_GOOD * theirs else "worse"


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Return how often each verdict was given, by law, as a table in Markdown."""
    words = ("right", "as good", "worse", "refused alone", "refused")
    lines = [f"| law | campaigns | {' | '.join(words)} |", "|---" * (2 + len(words)) + "|"]
    for law in dict.fromkeys(row["law"] for row in rows):
        said = [verdict(row) for row in rows if row["law"] == law]
        counts = " | ".join(str(said.count(word)) for word in words)
        lines.append(f"| {law} | {len(said)} | {counts} |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw and identify campaigns, and print the table."""
    judge_each(
        "choices",
        lambda rng, law, i, folder: judged(rng, law, NAMES[i % len(NAMES)], folder),
        table,
        arguments,
    )


if __name__ == "__main__":
    main()
