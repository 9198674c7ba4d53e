"""Drive and response on one clock or not: linear oscillators by their spectra, mistimed."""

import numpy as np
import pytest
from tiers import represented_by

from jbw.campaign.check import findings
from jbw.campaign.tables import TestSpec
from jbw.measurement.records import Record

FS, HZ, ZETA = 512.0, 20.0, 0.005


def response(u, fs=FS, lag=None, zeta=ZETA, other=0.0):
    """Displacement under a force per kg, from rest; `lag` [s] late at a time."""
    size = 4 * len(u)
    omega = 2 * np.pi * np.fft.rfftfreq(size, 1 / fs)
    spectrum = sum(
        share * np.fft.rfft(u, size) / (w**2 - omega**2 + 2j * zeta * w * omega)
        for share, w in ((1.0, 2 * np.pi * HZ), (other, 2 * np.pi * 3.1 * HZ))
    )
    fine = 8  # by zero-padding: exact between samples
    x = np.fft.irfft(spectrum, fine * size) * fine
    t = np.arange(len(u)) / fs
    return np.interp(t - (0.0 if lag is None else lag(t)), np.arange(len(x)) / fs / fine, x)


def sweep(seconds=40.0, down=False):
    t = np.arange(int(seconds * FS)) / FS
    f0, f1 = (24.0, 16.0) if down else (16.0, 24.0)
    u = np.sin(2 * np.pi * (f0 + (f1 - f0) / 2 / seconds * t) * t)
    return u * np.minimum(1, np.minimum(t, seconds - t) / 0.3)


def noise(seconds=100.0, seed=0):
    return np.random.default_rng(seed).standard_normal(int(seconds * FS))


def found(u, x, kind, delay=0.0, seed=1, source="force"):
    x = x + 1e-3 * np.std(x) * np.random.default_rng(seed).standard_normal(len(x))
    units = {source: "N" if source == "force" else "V", "displacement": "m"}
    spec = TestSpec(
        kind=kind, files=("a.h5",), channels={source: "u", "displacement": "x"}, units=units,
        delay=delay, band=(15.0, 25.0),
    )  # fmt: skip
    return findings(Record(FS, {source: u, "displacement": x}, units, name="a.h5"), spec)


@pytest.mark.parametrize("down", represented_by(True, False))
@pytest.mark.parametrize("zeta", [0.001, 0.005, 0.02])
@pytest.mark.parametrize("sign", represented_by(-1.0, 1.0))
def test_a_sound_sweep_is_not_doubted(down, zeta, sign):
    u = sweep(down=down)
    for seed in range(3):
        assert not found(u, sign * response(u, zeta=zeta, other=0.3), "sweep", seed=seed)


@pytest.mark.parametrize("seed", range(5))
def test_sound_noise_is_not_doubted(seed):
    u = noise(seed=seed)
    assert not found(u, response(u), "noise", seed=seed)


@pytest.mark.parametrize(("kind", "drive"), [("sweep", sweep()), ("noise", noise())])
@pytest.mark.parametrize("ppm", [80.0, -150.0])
def test_a_clock_that_runs_apart_is_named_with_its_rate(kind, drive, ppm):
    x = response(drive, lag=lambda t: 1e-6 * ppm * t)
    (fault,) = found(drive, x, kind)
    # Sample n of a fast clock is of the instant n / (1 + ppm): it lags by as much, and more later.
    assert f"ppm {'fast' if ppm > 0 else 'slow'}" in fault.what
    read = float(fault.what.split("runs ")[1].split()[0])
    assert read == pytest.approx(abs(ppm), rel=0.06)  # two digits, and what noise leaves
    pasted = float(fault.remedy.split("clock_ppm = ")[1].split("`")[0])
    assert pasted == pytest.approx(ppm, rel=0.05)


@pytest.mark.parametrize(("kind", "drive"), [("sweep", sweep()), ("noise", noise())])
@pytest.mark.parametrize("lost", represented_by(4, 9))
def test_a_lost_block_is_named_with_its_time(kind, drive, lost):
    at = round(0.4 * len(drive) / 8) * 8
    x = response(np.append(drive, np.zeros(lost)))
    x = np.concatenate([x[:at], x[at + lost :]])
    fault = next(f for f in found(drive, x, kind) if "lost a block" in f.what)
    length = len(drive) / FS
    assert float(fault.what.split()[1]) == pytest.approx(at / FS, abs=length / 8)
    # Of a sweep the two ends that do not meet ripple the phase, by a tenth of a radian of one.
    jump = float(fault.what.split("jumps by ")[1].split()[0])
    assert jump == pytest.approx(lost / FS, rel=0.25 if kind == "sweep" else 0.05)


@pytest.mark.parametrize("part", [2, 3, 4, 5])
@pytest.mark.parametrize("share", [0.3, 0.5, 0.7])
def test_a_block_lost_within_a_part_of_noise_is_named_with_a_span_before_it(part, share):
    """The part in which it was lost has a lag between the two."""
    u, lost = noise(40.0), 5
    at = int((part + share) / 8 * len(u))
    x = response(np.append(u, np.zeros(lost)))
    x = np.concatenate([x[:at], x[at + lost :]])
    fault = next(f for f in found(u, x, "noise") if "lost a block" in f.what)
    assert float(fault.what.split()[1]) == pytest.approx(at / FS, abs=40.0 / 8)
    assert float(fault.remedy.split("span = [0.0, ")[1].split("]")[0]) <= at / FS
    jump = float(fault.what.split("jumps by ")[1].split()[0])
    assert jump == pytest.approx(lost / FS, rel=0.1)


@pytest.mark.parametrize("down", [False, True])
@pytest.mark.parametrize("lost", represented_by(4, 6, 9))
@pytest.mark.parametrize("later", represented_by(0.0, 0.5))
def test_a_block_lost_at_the_resonance_of_a_short_sweep_is_named(later, lost, down):
    u = sweep(15.0, down=down)
    at = round((7.5 + later) * FS)  # the resonance is passed at 7.5 s
    x = response(np.append(u, np.zeros(lost)))
    x = np.concatenate([x[:at], x[at + lost :]])
    (fault,) = found(u, x, "sweep")
    assert "lost a block of samples" in fault.what
    # The size changes little within a period: the place is known to one of them.
    assert float(fault.what.split()[1]) == pytest.approx(at / FS, abs=1 / HZ)
    # To two of three digits, and to whole periods, whose phase is the same.
    jump = float(fault.what.split("jumps by ")[1].split()[0])
    assert jump == pytest.approx(lost / FS, abs=0.05 / HZ)
    before = float(fault.remedy.split("span = [0.0, ")[1].split("]")[0])
    assert at / FS - 3 / HZ < before < at / FS
    kept = slice(0, round(before * FS))
    assert not any("lost a block" in fault.what for fault in found(u[kept], x[kept], "sweep"))


@pytest.mark.parametrize("lost", represented_by(6, 4, 9))
def test_a_lag_that_jumps_at_the_resonance_has_the_time_of_the_cut(lost):
    u = sweep()
    at = round(20.0 * FS)
    x = response(np.append(u, np.zeros(lost)))
    (fault,) = found(u, np.concatenate([x[:at], x[at + lost :]]), "sweep")
    assert "lost a block" in fault.what
    assert float(fault.what.split()[1]) == pytest.approx(at / FS, abs=2 / HZ)  # three digits


@pytest.mark.parametrize("clicks", represented_by(6, 1))
def test_knocking_at_the_resonance_is_no_lost_block(clicks):
    u = sweep()
    x = response(u)
    # Every period a click, that decays within a sample; one alone turns no phase.
    x[round(20.2 * FS) + np.round(np.arange(clicks) * FS / HZ).astype(int)] += 1.5 * x.max()
    assert not any("lost a block" in fault.what for fault in found(u, x, "sweep"))


def test_a_response_that_jumps_with_its_drive_lost_no_block():
    u = sweep()
    at, lost = round(20.2 * FS), 6
    x = response(np.append(u, np.zeros(lost)))
    cut_u, cut_x = (np.concatenate([y[:at], y[at + lost : len(u)]]) for y in (u, x))
    faults = found(cut_u, cut_x, "sweep")
    assert not any("the response lost a block" in fault.what for fault in faults)


@pytest.mark.parametrize(("kind", "drive"), [("sweep", sweep()), ("noise", noise())])
@pytest.mark.parametrize("tau", [4e-3, -3e-3])
def test_a_delay_is_named_and_its_key_cures(kind, drive, tau):
    u = drive
    x = response(np.append(np.zeros(100), u), lag=lambda t: tau)[100:]
    (fault,) = found(u, x, kind)
    assert ("lags behind" if tau > 0 else "leads") in fault.what
    read = float(fault.remedy.split("delay = ")[1].split("`")[0])
    assert read == pytest.approx(tau, rel=0.05)
    assert not found(u, x, kind, delay=read)


@pytest.mark.parametrize("turned", [1.0, -1.0])
@pytest.mark.parametrize("lag", [-0.0125, 0.0125])
def test_a_quarter_of_a_period_of_noise_is_no_half_turn(lag, turned):
    # The mode is at 20 Hz: the phase of the lag lies midway between both polarities.
    u = noise()
    faults = found(u, turned * response(u, lag=lambda t: lag), "noise")
    (said,) = [one for one in faults if "the drive by" in one.what]
    way = "lags behind" if lag > 0 else "leads"
    assert f"The response {way} the drive" in said.what
    read = float(said.remedy.split("delay = ")[1].split("`")[0])
    assert read == pytest.approx(lag, rel=0.02)


def test_half_a_sample_of_a_converter_that_holds_is_not_doubted():
    u = sweep()
    assert not found(u, response(u, lag=lambda t: 0.5 / FS), "sweep", source="input")
