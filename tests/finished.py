"""Finished runs for tests, made once per state of the source and kept in the user's cache.

Processes of one session and tests of every tier share them. Tests of a report, of ArviZ or of the
content of a run thus need no separate run.
"""

import hashlib
import shutil
import sys
import time
from importlib.metadata import distributions
from pathlib import Path

import platformdirs
from filelock import FileLock

ROOT = Path(__file__).parents[1]
KEPT = platformdirs.user_cache_path("jbw") / "finished runs of the tests"


def state():
    """Return a hash of what a run depends on: jbw, the toy campaign, and installed packages."""
    installed = sorted(f"{each.name} {each.version}" for each in distributions())
    digest = hashlib.sha256("\n".join([sys.version, *installed]).encode())
    for path in sorted([*ROOT.glob("jbw/**/*.py"), *ROOT.glob("tests/study/toy_campaign.py")]):
        digest.update(path.relative_to(ROOT).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def finished(name, make):
    """Return the folder that `make` filled with a run, in whichever process came first."""
    folder = KEPT / state() / name
    whole = folder / "whole"
    folder.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(f"{folder}.lock"):
        if not whole.exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            make(folder)
            whole.touch()
    return folder


def forget(seconds):
    """Remove the runs of states that no session used within some seconds."""
    for folder in KEPT.glob("*"):
        if time.time() - folder.stat().st_mtime > seconds:
            shutil.rmtree(folder, ignore_errors=True)
