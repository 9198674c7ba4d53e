"""How long a decay is simulated: bounded by the records, whatever noise leaves of their rates."""

import os
import subprocess
import sys

import numpy as np
import pytest

from jbw.errors import DataError
from jbw.measurement.records import Record, Test
from jbw.observables.decay import Decays

FS, HZ, ZETA = 512.0, 20.0, 0.005
RATE = 2 * np.pi * HZ * ZETA


def ring(size=1.0, seconds=8.0, rate=RATE):
    t = np.arange(int(seconds * FS)) / FS
    return size * np.exp(-rate * t) * np.sin(2 * np.pi * HZ * t)


def hidden():
    """A decay whose last values lie on a floor that rises: no rate is left at that edge."""
    t = np.arange(4096) / FS
    return ring(seconds=8.0) + 0.02 * (1 + 0.5 * t) * np.sin(2 * np.pi * HZ * t)


def decays(*velocities, scale=1.0):
    records = tuple(
        Record(FS * scale, {"velocity": v * scale}, {"velocity": "m/s"}) for v in velocities
    )
    band = (10.0 * scale, 40.0 * scale)
    return Decays.of(Test("decay", records, name="ring", band_hz=band))


@pytest.mark.parametrize("scale", [2.0**-8, 1.0, 2.0**12])
def test_a_weak_record_is_reached_at_the_rate_of_the_strong_one(scale):
    data = decays(ring(), ring(0.01), scale=scale)
    # ln(100) / rate until the weak one begins, and its 8 s; 1.3 times that, within the length of a
    # filter, a few periods, and the rate at the edges.
    needed = 1.3 * (np.log(100) / RATE + 8.0) / scale
    assert data.num_samples / data.fs == pytest.approx(needed, rel=0.1)


def test_a_rate_that_noise_hides_asks_for_no_endless_record():
    data = decays(hidden(), ring(0.004))
    assert data.num_samples / data.fs < 1.3 * (1 + 20) * 8.0 + 1


def test_what_grows_or_is_never_reached_is_refused():
    noise = 1e-9 * np.random.default_rng(0).standard_normal(4096)
    with pytest.raises(DataError, match="must decay, but its strongest record grows") as caught:
        decays(ring(rate=-0.1) + noise)
    assert "settle" in caught.value.remedy
    with pytest.raises(DataError, match="to reach the initial amplitude") as caught:
        decays(ring(rate=0.01, seconds=2.0), ring(1e-6, seconds=2.0))
    assert "a separate test" in caught.value.remedy


PEAK = """
import warnings
import jax
jax.config.update("jax_enable_x64", True)
warnings.simplefilter("error")
import numpy as np
from test_course_of_decays import decays, hidden, ring
from jbw.observables.decay import matched

theta = {"omega_n": 125.7, "zeta": 5e-3, "alpha": 500.0, "delta": 300.0, "gamma": 100.0}
found = matched({name: np.asarray(x) for name, x in theta.items()}, decays(hidden(), ring(0.004)))
assert np.all(np.isfinite(found.misfit))
print(next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1])
"""


@pytest.mark.release  # test_peak_memory.py
@pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")
def test_a_decay_whose_rate_noise_hides_takes_no_more_memory_than_others():
    here = os.path.dirname(__file__)
    known = {
        "PYTHONPATH": os.pathsep.join([here, os.environ.get("PYTHONPATH", "")]),
        "JAX_CAPTURED_CONSTANTS_WARN_BYTES": "1000000",  # data are arguments, no constants
    }
    ended = subprocess.run(
        [sys.executable, "-c", PEAK], env=os.environ | known, capture_output=True, text=True
    )
    assert ended.returncode == 0, ended.stderr
    assert int(ended.stdout.split()[-1]) < 2e6  # kB
