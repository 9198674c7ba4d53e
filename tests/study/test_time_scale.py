"""Comparisons of a run where the same motion passes faster or slower: nothing is in seconds.

The response is that of a linear oscillator in closed form, or by SciPy's filter; time is scaled by
powers of two, under which every sum and every transform is the same number.
"""

import numpy as np
import pytest
from scipy import signal

from jbw.measurement.records import Record, Test
from jbw.observables.decay import Decays
from jbw.verification.decays import SEEN, num_seen
from jbw.verification.in_time import Motion, _resolves, _settling, compare_frfs
from jbw.verification.predicted import NOT_KNOWN

OMEGA, ZETA, FS = 2 * np.pi * 20.0, 0.02, 256.0
SCALES = (2.0**-6, 1.0, 2.0**6, 2.0**14)  # 0.3 Hz to 330 kHz
BAND = (15.0, 25.0)


def noise_record(scale, seconds):
    """Random input in V and the displacement of the oscillator, whose time runs `scale` faster."""
    size = int(seconds * FS)
    u = np.random.default_rng(1).standard_normal(size)
    poles = np.array([-ZETA + 1j * np.sqrt(1 - ZETA**2), -ZETA - 1j * np.sqrt(1 - ZETA**2)]) * OMEGA
    z, p, k = signal.bilinear_zpk([], poles, 1.0, FS)
    y = signal.sosfilt(signal.zpk2sos(z, p, k), u) / scale**2
    channels = {"input": u, "displacement": y}
    return Record(FS * scale, channels, {"input": "V", "displacement": "m"})


def draws(scale):
    return {"omega_n": np.full(3, OMEGA * scale), "zeta": np.full(3, ZETA)}


def motion(scale, seconds):
    record = noise_record(scale, seconds)
    test = Test("noise", (record,), name="noise")
    settled = round(_settling(test, draws(scale)) * record.fs)
    y = record.channels["displacement"]
    return Motion(test, y[None], np.stack([y, y]), np.ones(2), {}, NOT_KNOWN, settled=settled)


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("seconds", [2.0, 5.0, 8.0, 32.0])
def test_a_frequency_response_is_compared_at_any_time_scale(scale, seconds):
    compared = compare_frfs(motion(scale, seconds), (BAND[0] * scale, BAND[1] * scale))
    same = compare_frfs(motion(1.0, seconds), BAND)
    np.testing.assert_allclose(compared["freq"], same["freq"] * scale, rtol=1e-12)
    for name in ("measured_magnitude", "model_magnitude"):
        # Rounding of a Fourier transform.
        np.testing.assert_allclose(compared[name], same[name] / scale**2, rtol=1e-9)
    if seconds == 32.0:
        # At its peak the receptance is 1 / (2 zeta omega_n^2), which the window widens: within 1.5.
        peak = float(compared["measured_magnitude"].max()) * 2 * ZETA * (OMEGA * scale) ** 2
        assert 1 / 1.5 < peak < 1.5
    assert _resolves(motion(scale, seconds), (BAND[0] * scale, BAND[1] * scale)) == (seconds > 16)


@pytest.mark.parametrize("scale", SCALES)
def test_an_unknown_start_is_left_out_by_the_decay_of_the_mode(scale):
    test = Test("noise", (noise_record(scale, 32.0),))
    # exp(-7) is a thousandth; of a short record half is left.
    assert _settling(test, draws(scale)) * scale == pytest.approx(7 / (ZETA * OMEGA), rel=1e-12)
    short = Test("noise", (noise_record(scale, 2.0),))
    assert _settling(short, draws(scale)) * scale == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("scale", SCALES)
def test_the_start_of_a_held_out_decay_is_read_over_the_same_part_of_it(scale):
    fs, zeta = 512.0, ZETA / 10
    rate = zeta * OMEGA
    t = np.arange(int(8 * fs)) / fs
    v = np.exp(-rate * t) * np.sin(OMEGA * t) * scale
    record = Record(fs * scale, {"velocity": v}, {"velocity": "m/s"})
    band = (10.0 * scale, 40.0 * scale)
    data = Decays.of(Test("decay", (record,), name="ring", band_hz=band))
    known = {"omega_n": np.full(3, OMEGA * scale), "zeta": np.full(3, zeta)}
    seen_s = num_seen(known, data) * data.step_s
    # Whole steps of the envelope, which are a filter's length apart.
    assert seen_s * scale == pytest.approx(SEEN / rate, abs=data.step_s * scale)
    silent = {"omega_n": np.full(3, OMEGA * scale), "zeta": np.zeros(3)}
    assert num_seen(silent, data) == data.envelope.shape[1] // 2
