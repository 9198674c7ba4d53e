"""What would explain a misfit: linear sweeps by scipy, each with one thing wrong with them.

The structure is linear and known, so that all that is left but noise is what was done to the data.
"""

from types import SimpleNamespace

import jax
import numpy as np
import pytest
from pasted import lines_of, pasted
from scipy.interpolate import make_interp_spline
from scipy.signal import chirp, lsim

from jbw import Record, Test
from jbw.campaign.settings import Identify
from jbw.identification.assemble import measured
from jbw.identification.causes import cause_finding, causes, causes_sentence
from jbw.identification.prepare import fit_joint
from jbw.measurement.faults.plausibility import SwappedChannels
from jbw.measurement.faults.suspect import Misfit

FS, LENGTH, GAIN = 256.0, 1536, 15.0
OMEGA_N, ZETA = 2 * np.pi * 18.8, 0.01
LEVELS = {"low": 0.02, "high": 0.1}
NOISE = 2e-3  # of the rms of the strongest velocity
SETTINGS = Identify(fit_levels=tuple(LEVELS.values()), offsets="none")
T = np.arange(LENGTH) / FS
UNITS = {"input": "V", "velocity": "m/s"}


def answer(u, omega, zeta=ZETA, gain=GAIN):
    """Velocity of a mode, by scipy, the input's samples joined by straight lines."""
    system = ([gain, 0.0], [1.0, 2 * zeta * omega, omega**2])
    fine = 16
    t = np.arange(LENGTH * fine) / (FS * fine)
    smooth = sweep(t) * (np.max(np.abs(u)) / np.max(np.abs(sweep(T))))
    return lsim(system, smooth, t)[1][::fine]


def sweep(t):
    fade = np.clip(np.minimum(t, 5.0 - t) / 0.3, 0, 1)
    return np.sin(np.pi / 2 * fade) ** 2 * chirp(t, 12.0, 5.0, 26.0)


CLEAN = {
    name: (level * sweep(T), answer(level * sweep(T), OMEGA_N)) for name, level in LEVELS.items()
}
LARGEST = np.max(np.abs(CLEAN["high"][1]))


def taken_with(change, residuals="auto"):
    """Four repeats of both levels after `change(name, u, v)`."""
    made, rng = [], np.random.default_rng(11)
    for name, level in LEVELS.items():
        u, v = CLEAN[name]
        noise = NOISE * np.std(CLEAN["high"][1]) * rng.standard_normal((4, LENGTH))
        measured_ones = [dict(zip(UNITS, change(name, u, v + e), strict=True)) for e in noise]
        records = tuple(Record(FS, channels, UNITS) for channels in measured_ones)
        made.append(Test("sweep", records, name=name, level=level, residuals=residuals))
    return tuple(made)


def found(change):
    # Terms that a fit would take in by itself are no cause any more.
    seen = measured(taken_with(change, residuals="none"), SETTINGS, laws=())
    fitted = fit_joint(jax.random.key(1), seen, str)
    return causes(fitted.fit, fitted.data)


def late(name, u, v):
    spectrum = np.fft.rfft(v) * np.exp(-2j * np.pi * np.fft.rfftfreq(LENGTH, 1 / FS) * 1e-3)
    return u, np.fft.irfft(spectrum, LENGTH)


def by_another_clock(name, u, v):
    """Samples at n / (1 + 1e-3) of the drive's clock, by SciPy's quintic splines."""
    return u, make_interp_spline(T, v, 5)(np.minimum(T / (1 + 1e-3), T[-1]))


def turned(name, u, v):
    return u, -v if name == "high" else v


def thousandths(name, u, v):
    return u, v / 1000 if name == "low" else v


def amplified(name, u, v):
    return u, 1.2 * v if name == "low" else v


def shifted(name, u, v):
    return u, v + 0.01 * LARGEST


def cut(name, u, v):
    return u, np.clip(v, -0.7 * LARGEST, 0.7 * LARGEST)


def fed_through(name, u, v):
    return u, v + 2e-4 * np.gradient(u, 1 / FS)


def second_mode(name, u, v):
    return u, v + answer(u, 2 * np.pi * 23.0, gain=1.0)


def of_its_day(name, u, v):
    other = answer(CLEAN[name][0], OMEGA_N * 1.005)
    return u, v - CLEAN[name][1] + other if name == "high" else v


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (late, "lags behind the drive by"),
        (by_another_clock, "ppm fast compared with that of the drive"),
        (turned, "has the opposite sign to that of the other tests"),
        (thousandths, "unit: thousand"),
        (amplified, "times that of the other tests"),
        (shifted, "has an offset of"),
        (cut, "of the samples are clipped, in high"),
        (fed_through, "Modes outside the band respond"),
        (second_mode, "contains two modes, at 18.8 and 23"),
        (of_its_day, "Natural frequency and damping differ between the tests"),
    ],
)
def test_the_first_cause_is_what_was_done_to_the_data(change, words):
    first, *_ = every = found(change)
    assert words in first.text.what
    # What noise leaves is two thousandths; the modes' and delays' steps are linear, so not exact.
    assert first.explained > 0.85
    finding = cause_finding(every)
    assert finding is not None
    assert finding.status == "failed"
    assert finding.action == first.text.remedy
    assert first.text.what.rstrip(".") in causes_sentence(every)
    if change is not cut:  # what a range has cut off no key brings back
        assert lines_of(first.text.remedy)
        pasted(first.text.remedy)


def test_a_delay_is_told_by_its_size():
    text = found(late)[0].text
    # The step is linear in omega tau = 0.12, so right to a hundredth.
    lag = text.what.removeprefix("The response lags behind the drive by ").split()[0]
    assert float(lag) == pytest.approx(1e-3, rel=0.03)
    assert pasted(text.remedy).tests[0].delay == pytest.approx(1e-3, rel=0.03)


def test_a_clock_is_told_by_its_size():
    first, *_ = found(by_another_clock)
    # The step is linear in t times the part, 0.1 rad at most, and noise adds a hundredth.
    assert float(first.text.what.split("runs ")[1].split()[0]) == pytest.approx(1000, rel=0.05)
    assert pasted(first.text.remedy).tests[0].clock_ppm == pytest.approx(1000, rel=0.05)


def test_nothing_is_named_where_noise_alone_is_left():
    assert found(lambda name, u, v: (u, v)) == []
    assert cause_finding([]) is None


def test_swapped_channels_explain_the_squares_that_they_leave_less():
    """Of a source that the mode makes of the response but for a tenth, beside a half left now."""
    omega = np.linspace(80.0, 120.0, 4)
    theta = {"omega_n": 100.0, "zeta": 0.01}
    stiffness = 100.0**2 - omega**2 + 2j * 0.01 * 100.0 * omega
    modelled, beside = np.array([1.0, 1.0, 1.0, 1.0]) + 0j, np.array([1.0, -1.0, 1.0, -1.0]) + 0j
    spectrum = SimpleNamespace(
        omega=omega, factor=np.ones(4), measured=stiffness * modelled,
        source=np.sqrt(0.99) * modelled + 0.1 * beside, residual=0.5 * beside, values=modelled,
    )  # fmt: skip
    (cause,) = SwappedChannels().suspects(Misfit({"sweep": spectrum}, ["sweep"], theta))
    assert cause.explained == pytest.approx(1 - 0.1**2 / 0.5**2, rel=1e-12)
