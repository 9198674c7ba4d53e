"""Comparisons of a run where the same motion passes faster or slower: nothing is in seconds.

The response is that of a linear oscillator in closed form, or by SciPy's filter; time is scaled by
powers of two, under which every sum and every transform is the same number.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal
from toy_campaign import GAIN, TRUTH

from jbw.campaign.load import load_campaign
from jbw.identification.assemble import assemble, measured_in
from jbw.identification.run_effects import tells_apart
from jbw.measurement.channels import lines_within, whole_down, whole_up
from jbw.measurement.records import Record, Test
from jbw.observables.decay import BEGINNING, Decays, num_begun
from jbw.observables.records import Records
from jbw.verification.in_time import Motion, _resolves, _settling, compare_frfs
from jbw.verification.predicted import NOT_KNOWN
from jbw.verification.reference_oscillators import references

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
    data = Records.of([replace(test, settle=_settling(test, draws(scale)))])
    y = record.channels["displacement"][data.skipped :]
    return Motion(test, data, np.stack([y, y]), np.ones(2), {}, NOT_KNOWN)


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
    seen_s = num_begun(known, data) * data.step_s
    # Whole steps of the envelope, which are a filter's length apart.
    assert seen_s * scale == pytest.approx(BEGINNING / rate, abs=data.step_s * scale)
    silent = {"omega_n": np.full(3, OMEGA * scale), "zeta": np.zeros(3)}
    assert num_begun(silent, data) == data.mean.shape[1] // 2


@pytest.mark.parametrize("scale", [*SCALES, 2.0**40])
def test_a_run_knows_its_offsets_in_any_unit_of_time(scale):
    """A frequency to 1e-6 and a damping ratio to 1e-4 of theirs, with a correlation of 0.5."""
    std = np.array([1e-6 * OMEGA * scale, 1e-4 * ZETA])
    correlation = np.array([[1.0, 0.5], [0.5, 1.0]])
    assert tells_apart(np.linalg.inv(correlation * np.outer(std, std)))
    assert not tells_apart(np.outer(1 / std, 1 / std))  # one direction alone
    assert not tells_apart(np.diag([1 / std[0] ** 2, 0.0]))  # a loop, which knows no damping


@pytest.mark.parametrize("number", [4.0, 4096.0])
def test_a_whole_number_stays_one_in_every_unit_of_time(number):
    """17 Hz are the 1632nd line of 96 s, of 96 s told in units of 50 s too."""
    for factor in (1.0, 3.0, 50.0, 1e-3, 1e5, 1 / 7):
        rounded = (number * 256.0 / factor) / (256.0 / factor)
        for off in (rounded, np.nextafter(rounded, 0), np.nextafter(rounded, np.inf)):
            assert whole_down(off) == whole_up(off) == number
    assert (whole_down(number + 0.5), whole_up(number + 0.5)) == (number, number + 1)
    freq = np.fft.rfftfreq(24576, 1 / (256.0 / 50.0))
    for band in ((17.0, 20.5), (16.5, 21.0)):
        kept = lines_within(freq, (band[0] / 50, band[1] / 50))
        assert np.count_nonzero(kept) == 96 * (band[1] - band[0]) + 1


def toy_in(campaign, scale):
    """The toy campaign in other units of time; its one gain is of volts, and of newtons too."""
    held = {"input", "restoring_force"}

    def image(record):
        powers = {"displacement": 0, "velocity": 1}
        channels = {
            role: x if role in held else x * scale ** powers[role]
            for role, x in record.channels.items()
        }
        return replace(record, fs=record.fs * scale, channels=channels)

    tests = (replace(one, records=tuple(map(image, one.records))) for one in campaign.tests)
    return replace(campaign, tests=tuple(tests), gain=campaign.gain * scale**2)


@pytest.mark.parametrize("scale", [1e-5, 0.02, 1000.0, 2.0**14])
def test_the_oscillators_that_a_joint_is_compared_with_are_the_same(scale, toy):
    """Fits that stop at 1e-6 of their cost take the same way in every unit of time."""
    campaign = load_campaign(toy / "campaign.toml")
    units = {"omega_n": 1, "zeta": 0, "alpha": 2, "delta": 0, "gamma": 0, "cubic": 2, "gain": 2}

    def found(campaign, scale):
        data = assemble(measured_in(campaign, lambda _: None))
        theta = {name: x * scale ** units[name] for name, x in {**TRUTH, "gain": GAIN}.items()}
        return references(data, theta, ("linear", "cubic"))

    image, expected = found(toy_in(campaign, scale), scale), found(campaign, 1.0)
    for kind, one in expected.items():
        for name, value in one.parameters.items():
            # Rounding, by what a fit amplifies it: the least of a square is flat.
            there = image[kind].parameters[name] / scale ** units[name]
            assert there == pytest.approx(value, rel=1e-8)
