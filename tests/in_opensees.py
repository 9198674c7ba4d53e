"""Models that OpenSees runs in a separate process, as it keeps its model and prints at its end."""

import json
import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest

needs_opensees = pytest.mark.skipif(
    find_spec("openseespy") is None, reason="needs openseespy, which extra `test` has on Linux"
)
# Every script begins with the commands' words as numbers, and with its request.
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
    """Return the lines of a file of commands, without comments."""
    return [line for line in text.splitlines() if line and line[0] != "#"]


def ran(script, asked, timeout):
    """Return the last printed line of a script, as an array."""
    done = subprocess.run(
        [sys.executable, "-c", BEGIN + script], input=json.dumps(asked),
        capture_output=True, text=True, timeout=timeout, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return np.array(json.loads(done.stdout.splitlines()[-1]))
