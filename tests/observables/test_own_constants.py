"""A test's own residual terms: data with any of them say what data without them say."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from jbw import Record, Test
from jbw.errors import DataError
from jbw.observables.dataset import Dataset, log_likelihood, stacked
from jbw.observables.groups import fractions_counted, with_effective_values
from jbw.observables.records import Records
from jbw.observables.steady import Points

FS, LENGTH, REPEATS = 200.0, 512, 3
OMEGA = 2 * np.pi * np.fft.rfftfreq(LENGTH, 1 / FS)
THETA = {"omega_n": 118.0, "zeta": 0.01, "gain": 12.0}
JOINT = {"alpha": 300.0, "delta": 80.0, "gamma": 40.0}
UNITS = {"force": "N", "velocity": "m/s"}
U, L = 3e-5, -0.4


def record_test(kind, *, band=None, added=False):
    """Tones within 8 to 32 Hz, and a response that no model made, with U and L or without."""
    rng = np.random.default_rng(4)
    tones = (OMEGA > 2 * np.pi * 8) & (OMEGA < 2 * np.pi * 32)
    spectrum = 50.0 * tones * np.exp(2j * np.pi * rng.random(len(OMEGA)))
    more = np.zeros_like(spectrum)
    more[1:] = (U + L / OMEGA[1:] ** 2) * 1j * OMEGA[1:] * spectrum[1:]
    force, plus = np.fft.irfft(spectrum, LENGTH), added * np.fft.irfft(more, LENGTH)
    own = 0.01 * rng.standard_normal(LENGTH)
    repeats = own + plus + 1e-3 * rng.standard_normal((REPEATS, LENGTH))
    records = tuple(Record(FS, {"force": force, "velocity": one}, UNITS) for one in repeats)
    return Test(kind, records, name="own", level=1.0, band_hz=band, residuals="own")


def terms(test, theta, laws):
    # As many steps for both, whichever tone is the loudest in the response.
    data = Dataset.of(Records.reduce([test], laws=laws, substeps=2))
    values = {name: jnp.asarray(value) for name, value in theta.items()}
    return data, np.asarray(log_likelihood(values, data)), np.asarray(stacked(values, data))


@pytest.mark.parametrize(("band", "laws"), [(None, ()), ((9.0, 30.0), ("bouc_wen",))])
def test_whatever_constants_are_added_change_nothing(band, laws):
    theta = THETA | (JOINT if laws else {})
    data, plain, left = terms(record_test("sweep", band=band), theta, laws)
    _, more, left_more = terms(record_test("sweep", band=band, added=True), theta, laws)
    np.testing.assert_allclose(more, plain, rtol=0, atol=1e-10 * np.abs(plain).max())
    np.testing.assert_allclose(left_more, left, atol=1e-9 * np.abs(left).max())  # round-off
    # The constants are worth as much as the response: without the projector they are seen.
    silent = replace(record_test("sweep", band=band, added=True), residuals="none")
    assert abs(terms(silent, theta, laws)[1] - plain).max() > 1.0
    (part,) = data.parts
    size = LENGTH
    if band is not None:
        size = 2 * np.sum((OMEGA >= 2 * np.pi * band[0]) & (OMEGA <= 2 * np.pi * band[1]))
    assert part.groups.num_values == REPEATS * size - 2
    assert fractions_counted(part.groups) == {"own": 1.0}
    assert with_effective_values({"own": 0.5}, part.groups).num_values == (REPEATS * size - 2) / 2


def curve(freq, *, added, name="curve", **extra):
    omega = 2 * np.pi * freq
    y = 2.0 * 12.0 / (118.0**2 - omega**2 + 2j * 0.02 * 118.0 * omega) * np.exp(0.01 * freq)
    y = y + added * (U + L / omega**2)
    channels = {
        "frequency": freq, "force": np.full(len(freq), 2.0), "displacement": np.abs(y),
        "phase": np.angle(y),
    }  # fmt: skip
    units = {"frequency": "Hz", "force": "N", "displacement": "m", "phase": "rad"}
    record = Record(np.nan, channels | extra, units)
    return Test("frf", (record,), name=name, residuals="own")


def test_curves_have_constants_of_their_own_each():
    """Two of different lengths, one of them with a constant: neither tells of it."""
    found = []
    for added in (0.0, 1.0):
        tests = [curve(np.linspace(17, 20, 41), added=0.0)]
        tests += [curve(np.linspace(17, 21, 25), added=added, name="short")]
        data = Dataset.of(Points.reduce(tests, laws=()))
        values = {name: jnp.asarray(value) for name, value in THETA.items()}
        found.append(np.asarray(log_likelihood(values, data)))
        assert data.parts[0].groups.num_values.tolist() == [80.0, 48.0]
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-10 * np.abs(found[0]).max())


def test_a_held_response_has_none():
    freq = np.linspace(17, 20, 41)
    test = curve(freq, added=0.0)
    record = test.records[0]
    force = 1e-3 * record.channels["force"] / record.channels["displacement"]
    channels = {**record.channels, "force": force, "displacement": np.full(len(freq), 1e-3)}
    test = replace(test, records=(replace(record, channels=channels),))
    with pytest.raises(DataError, match=r"the response of curve .*was controlled"):
        Points.reduce([test], laws=())
