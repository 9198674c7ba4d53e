"""Models that OpenSees runs in a process of its own: it keeps its model, and speaks at its end."""

import json
import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest

needs_opensees = pytest.mark.skipif(
    find_spec("openseespy") is None, reason="needs openseespy, which extra `test` has on Linux"
)
# What a script begins with: the commands' words as numbers, and what it is asked for.
BEGIN = """
import json, sys
import openseespy.opensees as ops

def word(text):
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text

asked = json.load(sys.stdin)
ops.wipe()
"""


def commands_of(text):
    """Lines of a file of commands that are no comments."""
    return [line for line in text.splitlines() if line and line[0] != "#"]


def ran(script, asked, timeout):
    """What a script prints last, as an array."""
    done = subprocess.run(
        [sys.executable, "-c", BEGIN + script], input=json.dumps(asked),
        capture_output=True, text=True, timeout=timeout, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return np.array(json.loads(done.stdout.splitlines()[-1]))
