"""The modal mass of loops beside other tests: a free decay tells it, a shaker's feed does not."""

import jax
import numpy as np
import pytest
import xarray as xr
from tiers import represented_by

from jbw.campaign.settings import Identify
from jbw.errors import DataError
from jbw.identification.accuracy import explained
from jbw.identification.assemble import assemble, measured
from jbw.identification.coordinates import box_of
from jbw.identification.first_fit import first_fit
from jbw.identification.gain_units import with_gain_units
from jbw.inference.posterior.verdict import verdict
from jbw.inference.space.box import bounds_by_name
from jbw.measurement.records import Record, Test
from jbw.observables import dataset
from jbw.observables.drives import told_by
from jbw.oscillator.parameters import MOST_SOFTENING

FS, MASS, OMEGA_N, ZETA = 512.0, 1.7, 2 * np.pi * 20.0, 0.004


def loop(softening=1.0):
    """A spring's force under a displacement that grows; softer than the sticking joint."""
    t = np.arange(2048) / FS
    y = 2e-3 * t / t[-1] * np.sin(2 * np.pi * t)
    force = MASS * OMEGA_N**2 / softening * y
    channels = {"displacement": y, "restoring_force": force}
    return Test(
        "loop", (Record(FS, channels, {"displacement": "m", "restoring_force": "N"}),), "pull"
    )


def decay():
    t = np.arange(4096) / FS
    v = 0.1 * np.exp(-ZETA * OMEGA_N * t) * np.cos(OMEGA_N * np.sqrt(1 - ZETA**2) * t)
    records = (Record(FS, {"velocity": v}, {"velocity": "m/s"}),)
    return Test("decay", records, "ring", band_hz=(15.0, 25.0))


def sweep():
    """The linear oscillator under a swept voltage, which gives 30 N/kg per volt."""
    t = np.arange(4096) / FS
    u = np.sin(2 * np.pi * (10 * t + 1.25 * t**2))
    freq = np.fft.rfftfreq(len(t), 1 / FS) * 2 * np.pi
    h = 30.0 * 1j * freq / (OMEGA_N**2 - freq**2 + 2j * ZETA * OMEGA_N * freq)
    v = np.fft.irfft(h * np.fft.rfft(u), len(t))
    return Test(
        "sweep", (Record(FS, {"input": u, "velocity": v}, {"input": "V", "velocity": "m/s"}),)
    )


def gathered(*tests, gain=None):
    return assemble(measured(tests, Identify(), gain=gain))


@pytest.mark.parametrize("softening", [1.0, 4.0, 0.3])
def test_a_decay_tells_the_modal_mass_of_loops(softening):
    """Whatever the joint's slip or a stop makes of the loop's secant, it lies within the bounds."""
    data = gathered(loop(softening), decay())
    known = told_by(data.parts)
    assert "gain" not in data.held
    # A secant of few samples a cycle, and a straight line through the frequencies read.
    assert known["gain"] == pytest.approx(softening / MASS, rel=1e-3)
    low, high = bounds_by_name(box_of(Identify(), data, known))["gain"]
    assert low < 1 / MASS < high
    assert high / low == pytest.approx(MOST_SOFTENING**2)


def test_a_stated_prior_of_that_mass_is_taken():
    data, settings = gathered(loop(), decay()), Identify(prior={"gain": (0.5, 0.7)})
    assert bounds_by_name(box_of(settings, data, told_by(data.parts)))["gain"] == (0.5, 0.7)


@pytest.mark.parametrize("tests", [(loop(),), (decay(),)])
def test_neither_tells_it_alone(tests):
    assert float(gathered(*tests).held["gain"]) == 1.0
    assert float(gathered(*tests, gain=0.6).held["gain"]) == 0.6


def test_a_stated_mass_is_held():
    assert float(gathered(loop(), decay(), gain=1 / MASS).held["gain"]) == 1 / MASS


def test_a_voltage_has_no_gain_in_common_with_loops():
    for stated in (None, {"force": 1 / MASS}):  # a mass tells nothing of volts
        with pytest.raises(DataError, match="need the modal mass"):
            gathered(loop(), sweep(), gain=stated)
    assert told_by(gathered(sweep()).parts)["gain"] == pytest.approx(30.0, rel=0.05)
    beside = told_by(gathered(loop(), sweep(), decay()).parts)  # the remedy
    assert beside["gain"] == pytest.approx(1 / MASS, rel=1e-3)
    assert beside["gain_voltage"] == pytest.approx(30.0, rel=0.05)


@pytest.mark.parametrize(
    ("tests", "unit"),
    [((loop(), decay()), "1/kg"), ((sweep(),), "N/kg/V"), ((sweep(), loop(), decay()), "1/kg")],
)
def test_the_posterior_names_the_unit_of_the_gain(tests, unit):
    names = ["gain", "gain_voltage"][: len(tests) if len(tests) > 2 else 1]
    draws = xr.Dataset({name: (("chain", "draw"), np.ones((1, 1))) for name in names})
    tree = xr.DataTree.from_dict({"posterior": draws})
    named = with_gain_units(tree, tests)["posterior"]
    assert named["gain"].attrs["units"] == unit
    if len(tests) > 2:
        assert named["gain_voltage"].attrs["units"] == "N/kg/V"
    assert not tree["posterior"]["gain"].attrs


def tone(hz, level=2.0):
    """Steady motion of the linear oscillator by a force of that level [N]."""
    t, omega = np.arange(2048) / FS, 2 * np.pi * hz
    h = 1 / MASS / (OMEGA_N**2 - omega**2 + 2j * ZETA * OMEGA_N * omega)
    u, y = (np.real(x * level * np.exp(1j * omega * t)) for x in (1.0, h))
    record = Record(FS, {"force": u, "displacement": y}, {"force": "N", "displacement": "m"})
    return Test("tones", (record, record), f"tone_{hz:g}", level, (hz,))


@pytest.mark.parametrize(
    "tests", [(tone(6.5), loop()), (tone(6.5), decay()), (tone(6.5), tone(8.0, 3.0))]
)
def test_a_single_tone_tells_what_is_left_to_tell(tests):
    """Two numbers of three unknowns: the third is of a loop, a decay or another tone."""
    found = told_by(gathered(*tests).parts)
    assert found["omega_n"] == pytest.approx(OMEGA_N, rel=2e-3)
    assert found["gain"] == pytest.approx(1 / MASS, rel=1e-2)
    assert found["zeta"] == pytest.approx(ZETA, rel=0.05)


def test_one_frequency_alone_is_no_natural_frequency():
    data = gathered(tone(6.5))
    with pytest.raises(DataError, match="a test that determines the natural frequency"):
        box_of(Identify(), data, told_by(data.parts))
    data = gathered(tone(6.5), tone(8.0))  # the remedy
    assert "omega_n" in box_of(Identify(), data, told_by(data.parts)).names


def repeated(test, noise, seed=0):
    """Three records of it, each with noise of its own in the last channel, relative to its size."""
    rng, (record,) = np.random.default_rng(seed), test.records
    (role, x), *_ = reversed(record.channels.items())
    noisy = (x + noise * np.abs(x).max() * rng.standard_normal(len(x)) for _ in range(3))
    records = tuple(Record(FS, {**record.channels, role: y}, record.units) for y in noisy)
    return Test(test.kind, records, test.name, band_hz=test.band_hz)


@pytest.mark.slow
@pytest.mark.parametrize(("mass", "status"), represented_by((MASS / 3, "failed"), (MASS, "ok")))
def test_a_stated_mass_that_contradicts_the_data_is_a_failure_by_name(mass, status):
    """Every fit ends at a bound, or between decays and loops: the verdict says what is missed."""
    tests = repeated(loop(), 1e-3), repeated(decay(), 1e-4)
    data = assemble(measured(tests, Identify(), laws=(), gain=1 / mass))
    prior, best, data = first_fit(jax.random.key(0), data, Identify())
    ratio = np.divide(*explained(best, data))
    assert ratio > 1e4 if status == "failed" else ratio < 2
    draws = {n: (("chain", "draw"), np.full((4, 100), x)) for n, x in best.theta.items()}
    tree = xr.DataTree.from_dict({"posterior": xr.Dataset(draws), "sample_stats": xr.Dataset()})
    judged = verdict(tree, prior, chi_square=explained(best, data))
    assert {one.code: one.status for one in judged.findings}["chi_square"] == status
    error = dataset.error_by_label(dataset.residual_by_label(best.residual, data), data)
    assert (max(error.values()) > 0.1) == (status == "failed")
