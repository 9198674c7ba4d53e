"""Does a test notice each of these small changes of physics, statistics, verdict and results?

    python benchmarks/mutations.py [WORD ...] [--calls 99] [--json FILE]

Every mutation is made alone in a copy of the package, and the tests beside it run against the copy.
Ends with 1 where one survives, or where the code that it changes is no longer there. Words choose
mutations by what they say, `--calls` the first so many of them.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
LIMIT_S = 900  # of a mutation: a test that does not end has noticed nothing


class Mutation(NamedTuple):
    """One change, and what must notice it."""

    path: str  # below jbw
    old: str  # occurs once
    new: str
    tests: str  # files or test ids, below tests


FEW = "watch/test_few_readings.py"
SLIP = "oscillator/test_gross_slip.py"
SCALE = "study/test_time_scale.py"
VERDICT = "inference/test_verdict.py"
PROFILES = "inference/test_profiles.py"
COURSE = "observables/test_course_of_decays.py"
SEAL = "run/test_integrity.py"
NESTED = "oscillator/test_nested_loops.py"
PATH = "oscillator/laws/stretch_path.py"
MUTATIONS = (
    Mutation("watch/torque.py", "(1 / num + 1 / reference.num)", "(1 / num)", FEW),
    Mutation("watch/torque.py", "left.min() * (1 + 1 / reference.num)", "left.min()", FEW),
    Mutation("watch/torque.py", "** (-(freedom + 1) / 2)", "** (-freedom / 2)", FEW),
    Mutation("watch/torque.py", "slopes, reference.num - 1", "slopes, reference.num", FEW),
    Mutation(
        "watch/change_point.py",
        "both = np.array([np.log(hazard), np.log1p(-hazard)])",
        "both = np.array([np.log(hazard), 0.0])",
        FEW,
    ),
    Mutation(
        "watch/change_point.py",
        "np.concatenate([change, np.log1p(-hazard) + joint], axis=-1)",
        "np.concatenate([change, joint], axis=-1)",
        FEW,
    ),
    Mutation(
        "watch/change_point.py",
        "kappa / (kappa + 1))[..., None, None] * square",
        "(kappa + 1) / kappa)[..., None, None] * square",
        FEW,
    ),
    Mutation("inference/posterior/verdict.py", "if lower != 0.0:", "if lower > 0.0:", VERDICT),
    Mutation(
        "inference/posterior/verdict.py",
        "float(np.min(array_stats.bfmi(",
        "float(np.mean(array_stats.bfmi(",
        VERDICT,
    ),
    Mutation(
        "inference/posterior/verdict.py",
        "draws[name] > upper - edge",
        "draws[name] > upper + edge",
        VERDICT,
    ),
    Mutation(
        "verification/bands.py",
        "/ (2 * np.linalg.norm(measured))",
        "/ np.linalg.norm(measured)",
        "study/test_band_widths.py",
    ),
    Mutation(
        "population/prediction.py",
        "gains[k][s] for k, s in zip(which, place, strict=True)",
        "gains[k][s] for k, s in zip(which, place[::-1], strict=True)",
        "population/test_new_units.py",
    ),
    Mutation("identification/accuracy.py", "MOST_BEYOND = 1.5", "MOST_BEYOND = 15.0", VERDICT),
    Mutation(
        "identification/accuracy.py",
        "np.sqrt(np.mean(np.square(values)))",
        "np.mean(np.square(values))",
        VERDICT,
    ),
    Mutation("identification/accuracy.py", "CLOSE = 0.05", "CLOSE = 0.5", VERDICT),
    Mutation("inference/fit/costly_fit.py", "and np.all(np.isfinite(part(s, 1)))", "", PROFILES),
    Mutation(
        "inference/fit/costly_fit.py",
        "end.num_refused = len(refused)",
        "end.num_refused = 0",
        PROFILES,
    ),
    Mutation(
        "inference/fit/profiles.py",
        "return float(s[j])\n    share",
        "return float(s[j - 1])\n    share",
        PROFILES,
    ),
    Mutation("inference/thresholds.py", "PROB = 0.99", "PROB = 0.95", PROFILES),
    Mutation("verification/in_time.py", "FORGOTTEN = 7.0", "FORGOTTEN = 3.0", SCALE),
    Mutation(
        "verification/in_time.py", "forgotten = FORGOTTEN / rate", "forgotten = FORGOTTEN", SCALE
    ),
    Mutation("verification/decays.py", "SEEN / (rate * data.step_s)", "SEEN / data.step_s", SCALE),
    Mutation(
        "verification/places.py",
        'name.replace("/", "\\N{DIVISION SLASH}")',
        "name",
        "study/test_any_name.py",
    ),
    Mutation("observables/decay_envelopes.py", "LEAST_RATE = 0.1", "LEAST_RATE = 1e-9", COURSE),
    Mutation("observables/decay_envelopes.py", "SPARE = 1.3", "SPARE = 0.9", COURSE),
    Mutation("run/integrity.py", "hashes.get(name) != digest", "not hashes.get(name)", SEAL),
    Mutation(PATH, "_POLE = 0.5", "_POLE = 2.0", SLIP),
    Mutation(PATH, "_DEEP = 40.0", "_DEEP = 4.0", SLIP),
    Mutation(PATH, "- 0.5 * m * x**2", "", SLIP),
    Mutation(PATH, "moment(more) - moment(less)", "moment(more) + moment(less)", SLIP),
    Mutation(PATH, "zero - jax.vmap", "zero + jax.vmap", SLIP),
    Mutation(
        "oscillator/deepening.py",
        "if not np.sum(deeper.guesses) < np.sum(response.guesses):",
        "if True:",
        NESTED,
    ),
    Mutation(
        "oscillator/checks.py",
        "if np.any(share > 1.0):",
        "if np.any(share > 2.0):",
        "oscillator/test_admission.py",
    ),
)


def survives(mutation: Mutation) -> str:
    """Why a mutation was not noticed; empty where it was."""
    with tempfile.TemporaryDirectory() as name:
        copy = Path(name)
        for part in ("jbw", "tests"):
            shutil.copytree(ROOT / part, copy / part, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(ROOT / "pyproject.toml", copy)
        changed = copy / "jbw" / mutation.path
        text = changed.read_text(encoding="utf-8")
        if text.count(mutation.old) != 1:
            return f"the code occurs {text.count(mutation.old)} times"
        changed.write_text(text.replace(mutation.old, mutation.new), encoding="utf-8")
        known = os.environ | {"PYTHONPATH": str(copy)}
        tests = [f"tests/{each}" for each in mutation.tests.split()]
        command = [sys.executable, "-m", "pytest", "-n0", "-x", "-q", "-p", "no:cacheprovider"]
        try:
            ended = subprocess.run(
                [*command, *tests], cwd=copy, env=known, timeout=LIMIT_S, capture_output=True
            )
        except subprocess.TimeoutExpired:
            return f"its tests did not end in {LIMIT_S} s"
        return "" if ended.returncode == 1 else f"its tests ended with {ended.returncode}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Try every mutation that is chosen; 1 where one survives."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("words", nargs="*", help="parts of what a mutation says")
    parser.add_argument("--calls", type=int, default=len(MUTATIONS), help="mutations at most")
    parser.add_argument("--json", type=Path, help="file to write the results to")
    chosen = parser.parse_args(arguments)
    tried = {}
    for one in MUTATIONS:
        if len(tried) < chosen.calls and (
            not chosen.words or any(word in " ".join(one) for word in chosen.words)
        ):
            tried[f"{one.path}: {one.old} -> {one.new}"] = reason = survives(one)
            print(list(tried)[-1], f"SURVIVES, {reason}" if reason else "noticed", flush=True)
    left = sum(map(bool, tried.values()))
    print(f"{len(tried) - left} of {len(tried)} mutations are noticed.")
    if chosen.json is not None:
        chosen.json.write_text(json.dumps(tried, indent=1), encoding="utf-8")
    return int(left > 0)


if __name__ == "__main__":
    sys.exit(main())
