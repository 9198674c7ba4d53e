"""Records compared in a band: the same statistics by lines as by samples, other modes left out."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from jbw.errors import DataError
from jbw.identification.linear_step import linear_step
from jbw.measurement.records import Record, Test, periods
from jbw.observables.records import Records
from jbw.observables.samples import in_band, lines_of, noise_share, values_of

FS, SIZE = 256.0, 2048


def test_lines_hold_what_lies_in_the_band():
    lines = lines_of((10.0, 20.0), SIZE, FS)
    freq = np.fft.rfftfreq(SIZE, 1 / FS)
    np.testing.assert_array_equal(np.flatnonzero((freq >= 10.0) & (freq <= 20.0)), range(*lines))
    t = np.arange(SIZE) / FS
    tones = {hz: np.cos(2 * np.pi * hz * t + hz) for hz in (4.0, 12.0, 33.0)}
    kept = in_band(sum(tones.values()), lines)
    np.testing.assert_allclose(kept, tones[12.0], atol=1e-12)
    # Parseval: a cosine of one has the square sum N / 2, in its samples and in its line.
    values = values_of(jnp.asarray(sum(tones.values())), lines)
    assert float(jnp.sum(values**2)) == pytest.approx(SIZE / 2, rel=1e-12)


def test_white_noise_keeps_its_standard_deviation_by_lines():
    lines = lines_of((10.0, 60.0), SIZE, FS)
    noise = 0.3 * np.random.default_rng(1).standard_normal((200, SIZE))
    values = np.asarray(values_of(jnp.asarray(noise), lines))
    # 200 x 802 values: 0.2 %.
    assert values.std() == pytest.approx(0.3, rel=0.01)
    assert in_band(noise, lines).std() == pytest.approx(0.3 * noise_share(lines, SIZE), rel=0.01)


def test_an_offset_of_the_output_lies_in_no_band():
    """A constant is at 0 Hz alone, so that a band integrates it out whatever its prior is."""
    lines = lines_of((0.0, 60.0), SIZE, FS)
    assert lines[0] == 1
    x = np.random.default_rng(2).standard_normal(SIZE)
    moved = values_of(jnp.asarray(x + 30.0), lines)
    np.testing.assert_allclose(moved, values_of(jnp.asarray(x), lines), atol=1e-11)


def test_a_band_without_a_line_is_refused():
    with pytest.raises(DataError, match="`band` must contain a spectral line"):
        lines_of((10.01, 10.02), SIZE, FS)


def receptance(omega, hz, gain):
    omega_n = 2 * np.pi * hz
    return gain / (omega_n**2 - omega**2 + 2j * 0.01 * omega_n * omega)


def two_modes(repeats=4, size=SIZE, periods=1):
    """A periodic multisine through a mode at 14 Hz, with another at 40 Hz of equal size."""
    rng = np.random.default_rng(7)
    freq = np.fft.rfftfreq(size, 1 / FS)
    omega = 2 * np.pi * freq
    u = np.where((freq > 5) & (freq < 60), np.exp(2j * np.pi * rng.random(len(freq))), 0)
    h = receptance(omega, 14.0, 2.0) + receptance(omega, 40.0, 15.0)
    source, y = np.fft.irfft(u, size), np.fft.irfft(u * h, size)
    units = {"force": "N", "displacement": "m"}
    records = tuple(
        Record(
            FS,
            {
                "force": np.tile(source, periods),
                "displacement": np.tile(y, periods)
                + 1e-3 * y.std() * rng.standard_normal(size * periods),
            },
            units,
        )
        for _ in range(repeats)
    )
    return Test("multisine", records, "two modes", band_hz=(11.0, 18.0), periods=periods)


@pytest.mark.slow
def test_another_mode_outside_the_band_is_left_out():
    theta = {
        "omega_n": 2 * np.pi * 14.0, "zeta": 0.01, "gain": 2.0,
        "alpha": 1e-6, "delta": 1.0, "gamma": 1.0,
    }  # fmt: skip
    test = two_modes()
    in_all = Test("multisine", test.records, "all", periods=1)
    errors = []
    for one in (test, in_all):
        data = Records.of([one], periodic=True)
        left = data.misfit({n: jnp.asarray(v) for n, v in theta.items()})
        errors.append(float(jnp.linalg.norm(left) / jnp.linalg.norm(data.mean)))
    freq = np.fft.rfftfreq(SIZE, 1 / FS)
    omega, driven = 2 * np.pi * freq, (freq > 5) & (freq < 60)
    one, other = receptance(omega, 14.0, 2.0), receptance(omega, 40.0, 15.0)
    for error, keep in zip(errors, (driven & (freq >= 11) & (freq <= 18), driven), strict=True):
        alone = np.linalg.norm(other[keep]) / np.linalg.norm((one + other)[keep])
        # 8 steps a period of the mode at 40 Hz, and noise of 5e-4.
        assert error == pytest.approx(alone, rel=0.02)


@pytest.mark.filterwarnings("ignore:.*is smaller than the line spacing")
def test_step_2_reads_a_multisine_by_its_periods_without_leakage():
    test = two_modes(repeats=2, size=1024, periods=8)
    lone = Test(
        "multisine", test.records, "periods", band_hz=(12.0, 16.0), periods=8, settle=1024 / FS
    )
    step = linear_step(lone)
    # Lines of 0.25 Hz over a half-power width of 0.28 Hz: any window would smear this.
    assert step.pooled.mean[0] == pytest.approx(2 * np.pi * 14.0, rel=1e-3)
    assert step.pooled.mean[1] == pytest.approx(0.01, rel=0.05)
    assert step.frf.window == "boxcar"
    assert step.frf.freq[0] >= 12.0


def test_a_settle_that_leaves_no_period_is_refused():
    test = two_modes(repeats=1, size=256, periods=4)
    whole = replace(test, settle=3 * 256 / FS)
    assert len(periods(whole).records) == 1
    with pytest.raises(DataError, match="`settle` must leave a whole period"):
        periods(replace(test, settle=3.1 * 256 / FS))
