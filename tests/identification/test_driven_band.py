"""Step 2 of a test without a band: the lines that its source drives, and no noise beside them."""

import numpy as np
import pytest

from jbw.identification.linear_step import linear_step
from jbw.measurement.records import Record, Test
from jbw.measurement.resonances import driven_band

FS, NUM, PERIODS = 256.0, 2560, 4
OMEGA_N, ZETA, GAIN = 2 * np.pi * 18.8, 0.004, 0.5
HZ = np.arange(10.0, 30.05, 0.1)  # a line of every tenth of a hertz, whole in ten seconds


def multisine(noise):
    """Periods of a force of lines of 10 to 30 Hz, the steady velocity, and noise in either [-]."""
    rng = np.random.default_rng(1)
    t = np.arange(PERIODS * NUM) / FS
    turns = np.exp(2j * np.pi * np.outer(t, HZ))
    force = np.exp(1j * rng.uniform(0, 2 * np.pi, len(HZ)))
    omega = 2 * np.pi * HZ
    velocity = force * 1j * omega * GAIN / (OMEGA_N**2 - omega**2 + 2j * ZETA * OMEGA_N * omega)
    channels = {}
    for role, lines in (("force", force), ("velocity", velocity)):
        x = (turns @ lines).real
        channels[role] = x + noise * x.std() * rng.standard_normal(len(x))
    record = Record(FS, channels, {"force": "N", "velocity": "m/s"})
    return Test("multisine", (record,), "lines", periods=PERIODS)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.filterwarnings("ignore:.*smaller than the line spacing")
def test_a_multisine_without_a_band_is_read_where_it_is_driven(noise):
    test = multisine(noise)
    assert driven_band(test.records[0]) == pytest.approx((10.0, 30.0))
    fit = linear_step(test).pooled
    # Forty thousand values: noise of 1e-3 leaves 1e-5 of the damping's half width.
    assert fit.omega_n == pytest.approx(OMEGA_N, rel=1e-6)
    assert fit.zeta == pytest.approx(ZETA, rel=1e-3)
    assert fit.gain == pytest.approx(GAIN, rel=1e-3)


def test_of_noise_up_to_half_of_the_sampling_rate_every_line_is_driven():
    u = np.random.default_rng(0).standard_normal(NUM)
    record = Record(FS, {"force": u, "velocity": u}, {"force": "N", "velocity": "m/s"})
    low, high = driven_band(record)
    assert low <= 2 * FS / NUM
    assert high >= FS / 2 - 2 * FS / NUM
