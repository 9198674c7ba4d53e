"""Is each of these small changes of physics, statistics, verdicts and results noticed by a test?

    python benchmarks/mutations.py [WORD ...] [--calls 20] [--json FILE]

Every mutation of `mutations.toml` is made separately in a copy of the package, and the tests that
it names run against the copy. The exit code is 1 if a mutation survives, if its tests fail without
it, or if the code that it changes no longer exists. Words choose mutations that contain them, and
`--calls` the first ones.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
FAILED = "fail"
LIMIT_S = 900  # [s] per mutation: a test that does not end in this time has noticed nothing


class Mutation(NamedTuple):
    """One change of the code, and the tests that must notice it."""

    path: str  # path of the file, below jbw
    old: str  # changed text, which occurs once
    new: str
    tests: str  # files or ids of tests, below tests


def read_mutations() -> tuple[Mutation, ...]:
    """Return all mutations of the file next to this one."""
    text = Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
    return tuple(
        Mutation(change["path"], old, new, " ".join(change["tests"]))
        for change in tomllib.loads(text)["change"]
        for old, new in change["pairs"]
    )


def survives(mutation: Mutation) -> str:
    """Return why a mutation counts as not noticed; an empty text if a test failed."""
    if ended := sound(mutation.tests):
        return f"without it its tests {ended}"
    with tempfile.TemporaryDirectory() as name:
        copy = Path(name)
        for part in ("jbw", "tests"):
            shutil.copytree(
                ROOT / part, copy / part
            )  # including compiled files, which the change makes stale
        shutil.copy(ROOT / "pyproject.toml", copy)
        changed = copy / "jbw" / mutation.path
        text = changed.read_text(encoding="utf-8")
        if text.count(mutation.old) != 1:
            return f"the code occurs {text.count(mutation.old)} times"
        changed.write_text(text.replace(mutation.old, mutation.new), encoding="utf-8")
        ended = tested(copy, mutation.tests)
        return "" if ended == FAILED else f"its tests {ended or 'pass'}"


@cache
def sound(tests: str) -> str:
    """Return how the tests end on the unchanged package; an empty text if they pass."""
    return tested(ROOT, tests)


def tested(folder: Path, tests: str) -> str:
    """Return how the tests end on the package in a folder; an empty text if they pass."""
    known = os.environ | {"PYTHONPATH": str(folder)}
    command = [sys.executable, "-m", "pytest", "-n0", "-x", "-q", "-p", "no:cacheprovider"]
    chosen = [f"tests/{each}" for each in tests.split()]
    if all("::" in each for each in chosen):  # Named tests run whatever tier they belong to.
        command += ["-m", "slow or release or not slow"]
    command += chosen
    try:
        ended = subprocess.run(command, cwd=folder, env=known, timeout=LIMIT_S, capture_output=True)
    except subprocess.TimeoutExpired:
        return f"did not end in {LIMIT_S} s"
    return {0: "", 1: FAILED}.get(ended.returncode, f"ended with {ended.returncode}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Try every chosen mutation; return 1 if any is not noticed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("words", nargs="*", help="parts of what a mutation says")
    parser.add_argument("--calls", type=int, default=1000, help="mutations at most")
    parser.add_argument("--json", type=Path, help="file to write the results to")
    chosen = parser.parse_args(arguments)
    tried = {}
    for one in read_mutations():
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
