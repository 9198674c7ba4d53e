"""What a record of a decay may be instead: made in closed form, and named with its cause."""

import itertools

import numpy as np
import pytest
from scipy.integrate import odeint
from tiers import represented_by

from jbw.campaign.check import findings
from jbw.campaign.tables import TestSpec
from jbw.measurement.faults import window
from jbw.measurement.faults.hypothesis import Facts
from jbw.measurement.faults.window import window_constant
from jbw.measurement.files.assemble import unwindowed
from jbw.measurement.readings.read import decay_fits
from jbw.measurement.records import Record

FS, HZ, RATE = 600.0, 30.0, 1.1
BAND = (20.0, 45.0)
NOISE = 1e-3


def free(seconds=10.0, rate=RATE, softening=0.01, phase=0.3):
    """A decay exp(-rate t) whose frequency falls with its size."""
    t = np.arange(round(seconds * FS)) / FS
    size = np.exp(-rate * t)
    return size * np.cos(2 * np.pi * HZ * (t - softening * (1 - size) / rate) + phase)


def noisy(x, seed=0, noise=NOISE):
    return x + noise * np.random.default_rng(seed).standard_normal(len(x))


def found(x, fs=FS, band=BAND, settle=0.0):
    """What a check says of a record of a decay."""
    spec = TestSpec(
        kind="decay", files=("decay_1.h5",), channels={"velocity": "v"}, units={"velocity": "m/s"},
        band=band, settle=settle,
    )  # fmt: skip
    name = "decay_1.h5"
    record = Record(fs, {"velocity": 1e-2 * x}, {"velocity": "m/s"}, name, {"path": name})
    return findings(record, spec)


def named(faults):
    return [fault.what for fault in faults]


SCALES = pytest.mark.parametrize("times", represented_by(1.0, 1e-3, 1e4))


def scaled(x, times, settle=0.0):
    """The same motion `times` as fast."""
    return found(x, FS * times, tuple(times * edge for edge in BAND), settle / times)


@pytest.mark.parametrize("times", [1e-3, 1.0, 1e4])
@pytest.mark.parametrize("seed", range(8))
def test_a_decay_is_not_doubted(times, seed):
    assert named(scaled(noisy(free(phase=seed), seed), times)) == []


def test_a_second_mode_outside_the_band_is_not_doubted():
    t = np.arange(6000) / FS
    other = 0.8 * np.exp(-0.4 * t) * np.cos(2 * np.pi * 97.0 * t)
    assert named(found(noisy(free() + other))) == []


@SCALES
def test_a_late_blow_is_refused_and_settle_cures(times):
    quiet = np.zeros(round(1.5 * FS))
    x = noisy(np.concatenate([quiet, free()]))
    (fault,) = scaled(x, times)
    assert fault.severity == "error"
    assert fault.what.startswith(f"The blow comes {1.5 / times:.3g} s after")
    settle = float(fault.remedy.split("settle = ")[1].split("`")[0])
    assert 1.5 / times < settle < 1.7 / times
    assert named(scaled(x, times, settle * times)) == []


@SCALES
@pytest.mark.parametrize("driven_hz", [HZ, 29.6, 30.3])
def test_a_drive_that_stops_late_is_refused_and_settle_cures(times, driven_hz):
    t = np.arange(-round(2 * FS), 0) / FS
    x = noisy(np.concatenate([np.cos(2 * np.pi * driven_hz * t + 0.3), free()]))
    (fault,) = scaled(x, times)
    assert fault.severity == "error"
    assert fault.what.startswith("The motion is steady for")
    settle = float(fault.remedy.split("settle = ")[1].split("`")[0])
    assert 2.0 / times < settle < 2.6 / times
    assert named(scaled(x, times, settle * times)) == []


@SCALES
@pytest.mark.parametrize("size", [0.15, 0.5, -0.6])
def test_a_second_blow_is_named_with_its_time(times, size):
    x, later = free(), round(1.3 * FS)
    x[later:] += size * x[: len(x) - later]
    (fault,) = scaled(noisy(x), times)
    assert "the motion jumps" in fault.what
    # To a value of the envelope, of which the band gives one in 40 ms.
    assert float(fault.what.split()[1]) == pytest.approx(1.3 / times, abs=0.06 / times)
    assert '`exclude = ["decay_1.h5"]`' in fault.remedy


def test_lost_samples_are_named():
    x = noisy(free())
    (fault,) = found(np.concatenate([x[:800], x[830:]]))
    assert "samples are missing" in fault.what


@SCALES
@pytest.mark.parametrize("later", [0.5, 1.4])
@pytest.mark.parametrize("lost", [3, 5])
def test_a_part_of_a_period_that_is_missing_is_named(times, later, lost):
    # A tenth to a quarter of a period, of 20 samples: an envelope hardly shows it.
    x, at = noisy(free()), round(later * FS)
    (fault,) = scaled(np.concatenate([x[:at], x[at + lost :]]), times)
    assert "samples are missing" in fault.what
    # Within half a filter of the envelope, 0.1 s, where it is this that shows it.
    assert float(fault.what.split()[1]) == pytest.approx(later / times, abs=0.12 / times)


@pytest.mark.parametrize("hz", [27.0, 29.4, 31.0])
def test_hum_is_named_where_the_mode_has_not_gone(hz):
    # Four time constants, of which the mode is still as large as the hum in the last.
    x = free(seconds=4 / RATE)
    (fault,) = found(noisy(x + 0.03 * np.sin(2 * np.pi * hz * np.arange(len(x)) / FS)))
    assert "does not decay" in fault.what
    assert float(fault.what.split()[4]) == pytest.approx(hz, rel=5e-3)


@SCALES
@pytest.mark.parametrize("hz", [22.0, 24.0, 30.5, 41.0, 43.0])
def test_hum_is_named_with_its_frequency_and_size(times, hz):
    t = np.arange(6000) / FS
    (fault,) = scaled(noisy(free() + 0.03 * np.sin(2 * np.pi * hz * t)), times)
    assert fault.what.startswith("A spectral line at")
    # Of a tenth of the largest response, a decade above it, it makes 10 %: no reading.
    assert fault.severity == "error"
    assert "does not decay" in fault.what
    assert float(fault.what.split()[4]) == pytest.approx(hz * times, rel=2e-3)
    share = float(fault.what.split("amplitude is ")[1].split()[0])
    # The envelope begins half a filter after the record: 2.44 / 25 Hz of a Kaiser window.
    assert share == pytest.approx(0.03 * np.exp(RATE * 2.44 / 25.0), rel=0.05)


@pytest.mark.parametrize("size", [0.04, 0.13])
@pytest.mark.parametrize("hz", [26.0, 32.0])
def test_a_line_that_long_outlasts_the_decay_is_not_read_as_the_mode(hz, size):
    """After twenty time constants the line has more energy than the mode, or nearly as much."""
    t = np.arange(round(20 / RATE * FS)) / FS
    (fault,) = found(noisy(free(t[-1] + 1 / FS) + size * np.sin(2 * np.pi * hz * t), noise=1e-4))
    assert float(fault.what.split()[4]) == pytest.approx(hz, rel=1e-3)


def stuck_below(stuck, extra, power, seconds):
    """A decay of a joint that sticks below an amplitude and slips above, by its slow flow."""
    fs, w0 = 2560.0, 2 * np.pi * 118.0
    t = np.arange(0, seconds, 1 / fs)

    def rates(state, _):
        slips = (max(np.exp(state[0]) - stuck, 0.0) / (1 - stuck)) ** power
        return [-w0 * (0.003 + extra * slips), w0 * (1 - 0.03 * slips)]

    log, phase = odeint(rates, [0.0, 0.0], t, rtol=1e-9, atol=1e-12).T
    return noisy(np.exp(log) * np.cos(phase), noise=2e-4), fs


STUCK = list(itertools.product((0.02, 0.05, 0.1), (0.01, 0.02), (0.5, 1.0), (1.8, 2.4)))


@pytest.mark.slow
@pytest.mark.parametrize("cases", represented_by(STUCK[1::5], STUCK), ids=len)
def test_a_joint_that_sticks_in_the_end_is_no_hum(cases):
    """Its late motion damps less than the fitted powers of amplitude: it falls, and hum does not.

    With lines of constant amplitude alone, 6 of these 24 sound records were accused.
    """
    accused = [
        case
        for case in cases
        if any(
            "does not decay" in name for name in named(found(*stuck_below(*case), (59.0, 180.0)))
        )
    ]
    assert len(accused) <= len(cases) / 24


def test_a_line_outside_the_band_is_not_doubted():
    t = np.arange(6000) / FS
    assert named(found(noisy(free() + 0.05 * np.sin(2 * np.pi * 100.0 * t)))) == []


@SCALES
@pytest.mark.parametrize("tau", [0.8, 2.0, 4.0])
def test_an_exponential_window_is_named_and_taken_out(times, tau):
    t = np.arange(6000) / FS
    x = noisy(free())
    (fault,) = scaled(x * np.exp(-t / tau), times)
    assert fault.what.startswith("The noise decays too")
    read = float(fault.remedy.split("window_s = ")[1].split("`")[0])
    error = float(fault.what.split("standard error ")[1].split(")")[0])
    assert error <= 0.05 * tau / times
    assert read == pytest.approx(tau / times, abs=5 * error)
    without = unwindowed(x * np.exp(-t / tau), tau * FS, 0)
    np.testing.assert_allclose(without, x, rtol=1e-12)
    assert named(found(without)) == []


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("tau", [0.3, 0.61])
@pytest.mark.parametrize("share", [0.13, 0.5])
def test_a_window_is_named_where_modes_fill_a_part_of_the_lines_of_noise(share, tau, seed):
    # Of 2.4 s there are 27 lines, and the two modes stand in half of those below 90 Hz.
    fs, band = 750.0, (22.2, 37.8)
    t = np.arange(1767) / fs
    x = np.exp(-1.8 * t) * np.cos(2 * np.pi * 30.0 * t + 0.3)
    x = noisy(x + share * np.exp(-3.0 * t) * np.cos(2 * np.pi * 61.6 * t), seed, noise=1e-5)
    (fault,) = found(x * np.exp(-t / tau), fs, band)
    read = float(fault.remedy.split("window_s = ")[1].split("`")[0])
    error = float(fault.what.split("standard error ")[1].split(")")[0])
    assert read == pytest.approx(tau, abs=5 * error)
    assert named(found(x, fs, band)) == []


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("tau", [0.1, 0.2])
def test_a_window_is_named_of_a_record_of_few_lines_of_noise(tau, seed):
    # Of 0.63 s at 9 samples a period 14 lines of noise are apart.
    fs, band = 1843.8, (147.2, 253.8)
    t = np.arange(1154) / fs
    x = noisy(np.exp(-6.8 * t) * np.cos(2 * np.pi * 200.5 * t + 0.3), seed)
    (fault,) = found(x * np.exp(-t / tau), fs, band)
    read = float(fault.remedy.split("window_s = ")[1].split("`")[0])
    error = float(fault.what.split("standard error ")[1].split(")")[0])
    assert read == pytest.approx(tau, abs=5 * error)
    assert named(found(x, fs, band)) == []


def test_skirts_of_a_strong_line_are_no_noise():
    assert window_constant(noisy(free(), noise=1e-9), FS, (7.5, 57.5), RATE, 0.0) is None


@pytest.mark.parametrize("unit", [1e-4, 1.0, 300.0])
def test_noise_is_compared_with_the_converter_step_in_the_unit_of_the_record(monkeypatch, unit):
    x, steps = unit / 128 * np.round(128 * noisy(free())), []
    monkeypatch.setattr(window, "window_constant", lambda *given: steps.append(given[-1]))
    record = Record(FS, {"velocity": x}, {"velocity": "m/s"})
    list(window.Window().seen(decay_fits(record, BAND, 0.0), Facts(record, 0.0, 0.0, BAND)))
    assert steps == pytest.approx([unit / 128], rel=1e-9)


@pytest.mark.parametrize("count", represented_by(3, 8))
def test_a_beat_of_two_modes_is_neither_blow_nor_drive(count):
    t = np.arange(6000) / FS
    for phase in np.linspace(0, 2 * np.pi, count, endpoint=False):
        other = 0.9 * np.exp(-RATE * t) * np.cos(2 * np.pi * 31.1 * t + phase)
        (what,) = named(found(noisy(free(softening=0.0) + other)))
        assert what.startswith("`band` contains two modes, at")
        hz = sorted(float(word) for word in what.split("at ")[1].split(" Hz")[0].split(" and "))
        # The stronger one is read first, within the half-power width of both, 0.35 Hz.
        assert hz == pytest.approx([30.0, 31.1], abs=0.35)


@pytest.mark.parametrize("settle", represented_by(0.1, 0.0, 0.2))
def test_the_slower_of_two_modes_in_a_band_is_no_hum(settle):
    """Of 20 and 54 Hz within one band, the second gone first; a record of 1.3 time constants."""
    t = np.arange(4 * 384) / 384.0
    for phase in np.linspace(0, 2 * np.pi, 12, endpoint=False):
        x = 0.2 * np.exp(-0.32 * t) * np.cos(2 * np.pi * 20.3 * t + 3.3)
        x += 0.26 * np.exp(-1.01 * t) * np.cos(2 * np.pi * 53.7 * t + phase)
        (what,) = named(found(noisy(x, noise=2e-4), 384.0, (12.0, 75.0), settle))
        hz = sorted(float(word) for word in what.split("at ")[1].split(" Hz")[0].split(" and "))
        assert hz == pytest.approx([20.3, 53.7], abs=0.2)


@pytest.mark.parametrize("size", [0.3, 1.0])
def test_what_no_fault_explains_is_said(size):
    """Four modes in one band, of which no hypothesis has more than two."""
    t = np.arange(923) / 400.0
    x = np.exp(-1.4 * t) * np.cos(2 * np.pi * 12.0 * t)
    for hz, phase in ((10.6, 1.0), (13.1, 2.0), (14.2, 3.0)):
        x += size * np.exp(-1.3 * t) * np.cos(2 * np.pi * hz * t + phase)
    (what,) = named(found(noisy(x, noise=5e-3), 400.0, (8.0, 18.0)))
    assert what.endswith("of the response is explained neither by one mode nor by a known fault.")
