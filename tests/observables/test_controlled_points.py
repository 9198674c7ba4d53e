"""Points of controlled tests as an observable: against the rig, and the noise that they carry."""

from dataclasses import replace
from functools import cache

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jbw import rig
from jbw.measurement.records import Record, Test
from jbw.observables.controlled import ControlledPoints, Frequencies, beside_known
from jbw.observables.dataset import sizes_of
from jbw.observables.drives import told_by
from jbw.rig.prescribed_motion import held_points, locked_points

JOINT, MASS = rig.TRUTH, 1.93
THETA = {
    **{name: jnp.asarray(getattr(JOINT, name)) for name in
       ("omega_n", "zeta", "alpha", "delta", "gamma")},
    "gain": jnp.asarray(1 / MASS),
}  # fmt: skip
# Of a response with a constant, here zero: one program predicts what has one and what has none.
WITH_CONSTANT = THETA | {"residual_upper": jnp.asarray(0.0)}
Y = np.geomspace(2e-4, 6e-3, 12)
UNITS = {"frequency": "Hz", "force": "N", "displacement": "m", "phase": "rad"}


def test_of(kind, *repeats, **stated):
    records = [
        Record(np.nan, channels, {role: UNITS[role] for role in channels}, f"{kind}_{i}")
        for i, channels in enumerate(repeats)
    ]
    return Test(kind, tuple(records), kind, **stated)


test_of.__test__ = False


@cache
def locked(degrees=-90.0):
    phase = np.full(len(Y), np.radians(degrees))
    frequency, force = locked_points(JOINT, rig.Locked(tuple(Y)), phase)
    return {"frequency": frequency, "force": MASS * force, "displacement": Y, "phase": phase}


@cache
def held(hz=18.5):
    force = MASS * held_points(JOINT, rig.s_curve(hz, tuple(Y)))
    return {"frequency": np.full(len(Y), hz), "force": np.abs(force), "displacement": Y,
            "phase": -np.angle(force)}  # fmt: skip


@eqx.filter_jit
def predicted(theta, data):
    return data.predict(theta)


@eqx.filter_jit
def misfits(theta, data):
    return data.misfit(theta)


@pytest.mark.parametrize("degrees", [-90.0, -60.0])
def test_frequency_and_force_at_a_phase_are_those_of_the_rig(degrees):
    """Which integrates the joint along the motion by Runge and Kutta: good to 1e-6 of the force."""
    (data,) = ControlledPoints.reduce([test_of("backbone", locked(degrees))])
    assert data.groups.labels == ("backbone frequency", "backbone force")
    assert data.groups.units == ("Hz", "N")
    found, true = np.asarray(predicted(WITH_CONSTANT, data)), locked(degrees)
    np.testing.assert_allclose(found[0], true["frequency"], rtol=1e-7)
    np.testing.assert_allclose(found[1], true["force"], rtol=5e-6)


def test_phase_and_force_at_an_amplitude_are_those_of_the_rig():
    (data,) = ControlledPoints.reduce([test_of("curve", held())])
    assert data.groups.units == ("rad", "N")
    found, true = np.asarray(predicted(THETA, data)), held()
    np.testing.assert_allclose(found[0], true["phase"], atol=5e-6)
    np.testing.assert_allclose(found[1], true["force"], rtol=5e-6)


def test_a_channel_that_is_turned_has_the_same_force():
    """A gain below zero: a phase half a turn away, no other amplitude or frequency."""
    opposite = {"gain": -THETA["gain"]}
    (backbone,), (curve,) = (
        ControlledPoints.reduce([test_of(kind, made)])
        for kind, made in (("backbone", locked()), ("curve", held()))
    )
    turned = predicted(WITH_CONSTANT | opposite, backbone)
    np.testing.assert_allclose(turned, predicted(WITH_CONSTANT, backbone))
    turned, plain = predicted(THETA | opposite, curve), predicted(THETA, curve)
    np.testing.assert_allclose(turned[1], plain[1])
    np.testing.assert_allclose(np.cos(turned[0] - plain[0]), -1.0)


def test_forms_stand_apart_and_shorter_tests_are_filled_up():
    short = {name: values[:7] for name, values in locked(-60.0).items()}
    alone = {name: locked()[name] for name in ("frequency", "displacement")}
    tests = [
        test_of("backbone", locked()),
        replace(test_of("backbone", short), name="short"),
        replace(test_of("backbone", alone), name="alone"),
        test_of("curve", held()),
    ]
    both, frequencies, curve = ControlledPoints.reduce(tests)
    assert isinstance(frequencies, Frequencies)
    assert frequencies.informs == {"omega_n"}
    assert (both.is_locked, curve.is_locked) == (True, False)
    assert both.groups.labels == (
        "backbone frequency",
        "backbone force",
        "short frequency",
        "short force",
    )
    left = np.asarray(misfits(THETA, both))
    assert np.all(left[2:, 7:] == 0)
    assert np.abs(left[2, :7]).max() < 1e-5
    (axis, unit), places = both.shown().axis, both.shown().places[3]
    assert (axis, unit, len(places)) == ("displacement", "m", 7)


def test_first_values_by_a_known_mass_and_without():
    """Damping of the least motion, but for what the joint adds there; or the gain beside it."""
    (data,) = ControlledPoints.reduce([test_of("backbone", locked())])
    known = told_by([data], {"gain": 1 / MASS})
    assert known["omega_n"] == pytest.approx(JOINT.omega_n, rel=1e-3)
    assert known["zeta"] == pytest.approx(JOINT.zeta, rel=0.02)
    unknown = told_by([data])
    ratio = unknown["zeta"] / unknown["gain"]
    assert ratio == pytest.approx(JOINT.zeta * MASS, rel=0.15)


def noisy(rng, true, amplitude, force, frequency):
    """A repeat with errors of the amplitude, the force and the frequency, relative."""
    e = rng.standard_normal((3, len(Y)))
    return {
        **true,
        "displacement": Y * (1 + amplitude * e[0]),
        "force": true["force"] * (1 + force * e[1]),
        "frequency": true["frequency"] * (1 + frequency * e[2]),
    }


def test_the_noise_of_the_amplitude_is_carried_to_frequency_and_force():
    """What is left at the truth is white: no group goes with another, each of the noise it says.

    Errors of the amplitude make those of the frequency and of the force here. 30 tests of 12 points
    and 2 repeats: a correlation of 360 pairs has the standard error 0.053, a mean square 0.075.
    """
    rng, true = np.random.default_rng(5), locked()
    sizes = (5e-3, 2e-3, 2e-6)
    tests = [
        replace(
            test_of("backbone", *(noisy(rng, true, *sizes) for _ in range(2))),
            name=f"test {i}", amplitude_std=sizes[0],
        )
        for i in range(30)
    ]  # fmt: skip
    (data,) = ControlledPoints.reduce(tests)
    raw = np.asarray(misfits(THETA, data)) * np.asarray(data.scale)
    correlated = np.corrcoef(raw[::2].ravel(), raw[1::2].ravel())[0, 1]
    assert abs(correlated) > 0.5
    left = dict(zip(data.groups.labels, raw / np.asarray(data.scale), strict=True))
    for _ in range(2):
        data = data.with_fitted_noise(THETA, left)
        left = dict(zip(data.groups.labels, np.asarray(misfits(THETA, data)), strict=True))
    rows = np.array(list(left.values())) * np.sqrt(2) / np.asarray(data.groups.noise_std)[:, None]
    frequency, force = rows[::2], rows[1::2]
    assert abs(np.corrcoef(frequency.ravel(), force.ravel())[0, 1]) < 4 * 0.053
    for row in (frequency, force):
        by_amplitude = np.mean(row**2, axis=0)
        assert np.mean(row**2) == pytest.approx(1.0, abs=4 * 0.075)
        # Along the amplitude as well: a third of the points each.
        assert by_amplitude[:4].mean() == pytest.approx(by_amplitude[8:].mean(), abs=8 * 0.075)
    # Of a force alone: sqrt(0.2 % ^2 + (0.5 % of its slope)^2), the slope about one.
    spread = data.spread(1) * float(data.groups.noise_std[1]) / np.asarray(data.mean[1])
    assert 0.004 < np.median(spread) < 0.007


def test_the_noise_beside_a_known_one():
    """By its definition: of 20,000 normal numbers."""
    rng = np.random.default_rng(2)
    known, course = rng.uniform(0.1, 2.0, 20000), rng.uniform(0.5, 2.0, 20000)
    rows = rng.standard_normal(20000) * np.sqrt((0.7 * course) ** 2 + known**2)
    found = beside_known(rows**2, course, known**2)
    assert np.sqrt(found) == pytest.approx(0.7, rel=0.03)
    alone = beside_known(rows**2, course, 0 * known)
    assert alone == pytest.approx(np.mean((rows / course) ** 2))


def test_repeats_of_other_amplitudes_scatter_by_their_noise_alone():
    """Levels that a controller misses by 3 % move frequency and force along the model."""
    rng = np.random.default_rng(8)
    true = locked()
    slope = np.gradient(np.log(true["force"]), np.log(Y))
    shift = np.gradient(np.log(true["frequency"]), np.log(Y))
    repeats = []
    for _ in range(3):
        other = 0.03 * rng.standard_normal(len(Y))
        e = rng.standard_normal((2, len(Y)))
        repeats.append(
            {
                **true,
                "displacement": Y * np.exp(other),
                "force": true["force"] * np.exp(slope * other + 1e-3 * e[0]),
                "frequency": true["frequency"] * np.exp(shift * other + 1e-6 * e[1]),
            }
        )
    (data,) = ControlledPoints.reduce([test_of("backbone", *repeats)])
    residual = np.asarray(data.mean) - np.asarray(predicted(WITH_CONSTANT, data))
    left = dict(zip(data.groups.labels, residual / np.asarray(data.scale), strict=True))
    ready = data.with_fitted_noise(THETA, left)
    before, after = (np.asarray(one.groups.within) for one in (data, ready))
    assert np.all(after < 0.05 * before)
    scatter = np.sqrt(after[1] / (2 * len(Y))) / float(ready.groups.reference[1])
    assert scatter == pytest.approx(1e-3, rel=0.5)  # of 24 numbers, and slopes by differences


def test_a_law_that_misses_counts_alike_for_frequency_and_force():
    """A frequency wrong by the half width of the resonance is as wrong as a force by itself."""
    (data,) = ControlledPoints.reduce([test_of("backbone", locked())])
    zero = {label: np.zeros(len(Y)) for label in data.groups.labels}
    ready = data.with_fitted_noise(THETA, zero)
    zeta = locked()["force"] / MASS / (2 * (2 * np.pi * locked()["frequency"]) ** 2 * Y)
    half_width = np.mean(zeta * locked()["frequency"])
    assert sizes_of(ready)["backbone frequency"] == pytest.approx(
        half_width * np.sqrt(12), rel=1e-6
    )
    np.testing.assert_allclose(ready.relative_to(1), locked()["force"])


def test_residual_terms_are_of_the_response_that_was_measured():
    """A constant U adds U g F to the displacement: the controller held the sum."""
    upper, true = 2e-5, locked()
    force = true["force"] / MASS
    own = Y * np.exp(1j * true["phase"])
    measured = own + upper * force
    channels = {**true, "displacement": np.abs(measured), "phase": np.angle(measured)}
    (data,) = ControlledPoints.reduce([test_of("backbone", channels)])
    found = np.asarray(predicted({**THETA, "residual_upper": jnp.asarray(upper)}, data))
    np.testing.assert_allclose(found[0], true["frequency"], rtol=1e-7)
    np.testing.assert_allclose(found[1], true["force"], rtol=5e-6)
    without = np.asarray(predicted(WITH_CONSTANT, data))
    assert np.abs(without[0] / true["frequency"] - 1).max() > 1e-6
