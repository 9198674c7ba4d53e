"""The memory of a whole command, on decays that a fit can hardly bound, in its own process."""

import os
import subprocess
import sys

import numpy as np
import pytest

FS, SECONDS, QUIET = 512, 12, 2
PEAK_KB = 2e6

RUN = """
import sys
from jbw.cli import run
code = run(sys.argv[1:])
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1]
print("code", code, "peak", peak)
"""


def campaign(folder, zeta, settle):
    """Four accelerations of 20 Hz: noise for two seconds, the blow, and a decay of that ratio."""
    folder.mkdir()
    for i in range(4):
        rng, t = np.random.default_rng(i), np.arange(FS * SECONDS) / FS
        ring = (1 + 0.1 * i) * np.exp(-zeta * 2 * np.pi * 20 * t) * np.sin(2 * np.pi * 20 * t)
        quiet = 2e-3 * rng.standard_normal(QUIET * FS)
        x = np.concatenate([quiet, ring + 2e-3 * rng.standard_normal(t.size)])
        table = np.column_stack([np.arange(x.size) / FS, x])
        name = folder / f"decay_{i}.csv"
        np.savetxt(name, table, delimiter=",", header="time,acceleration", comments="")
    text = f"""[campaign]
name = "pretrigger"
[[test]]
kind = "decay"
files = "decay_*.csv"
channels = {{ time = "time", acceleration = "acceleration" }}
units = {{ time = "s", acceleration = "m/s^2" }}
band = [10.0, 40.0]
settle = {settle}
"""
    (folder / "campaign.toml").write_text(text)
    return folder / "campaign.toml"


@pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")
@pytest.mark.parametrize(
    ("zeta", "settle"),
    [
        # The noise before the blow is taken for its beginning.
        pytest.param(0.004, 0.0, marks=pytest.mark.release),
        pytest.param(1e-7, 0.0, marks=pytest.mark.release),
        (1e-7, 2.1),  # nothing but the ring, which never ends
        pytest.param(4e-4, 2.1, marks=pytest.mark.release),  # which ends after minutes
    ],
)
def test_a_pathological_decay_takes_no_more_memory_than_others(tmp_path, zeta, settle):
    file = campaign(tmp_path / "campaign", zeta, settle)
    command = [sys.executable, "-c", RUN, "identify", str(file), "--out", str(tmp_path / "run")]
    environment = {"JAX_CAPTURED_CONSTANTS_WARN_BYTES": "1000000"}
    ended = subprocess.run(
        command, env=os.environ | environment, capture_output=True, text=True, timeout=1800
    )
    assert ended.returncode == 0, ended.stderr  # of this script: the command's is printed
    words = ended.stdout.split()
    assert words[-4] == "code"
    assert int(words[-1]) < PEAK_KB, ended.stdout[-400:]
    assert "Traceback" not in ended.stderr
