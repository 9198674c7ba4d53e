"""Harmonics of steady motion: reduction and prediction against an independent integration."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jbw.errors import DataError
from jbw.measurement.records import Record, Test
from jbw.observables.harmonic_groups import (
    curve_group,
    stepped_groups,
    tone_groups,
)
from jbw.observables.steady import Points, equivalent_stiffness, motion_of
from jbw.oscillator.laws.hysteresis import steady_loop
from jbw.oscillator.laws.springs import Cubic
from jbw.oscillator.oscillator import BoucWen
from jbw.oscillator.steady.cycle import steady_state

GAIN = 12.0
JOINT = BoucWen(omega_n=118.0, zeta=0.01, alpha=500.0, delta=340.0, gamma=60.0)


def theta(**changes):
    names = ("omega_n", "zeta", "alpha", "delta", "gamma")
    values = {**{name: getattr(JOINT, name) for name in names}, "gain": GAIN, **changes}
    return {name: jnp.asarray(float(value)) for name, value in values.items()}


def tone(frequency, level, repeats=2, noise=0.0, seed=0):
    """Records of a steady tone made from jbw's full harmonic balance, source phase arbitrary."""
    rng, fs, t = np.random.default_rng(seed), 512.0, np.arange(4096) / 512.0
    omega, phase = 2 * np.pi * frequency, 0.7
    y = np.asarray(steady_state(JOINT, omega, GAIN * level, 8))
    n = 2 * np.arange(8) + 1
    v = np.real(np.sum(1j * n * omega * y * np.exp(1j * n * (omega * t[:, None] + phase)), axis=1))
    u = level * np.cos(omega * t + phase)
    records = tuple(
        Record(fs, {"input": u, "velocity": v + noise * rng.normal(size=len(t))},
               {"input": "V", "velocity": "m/s"})
        for _ in range(repeats)
    )  # fmt: skip
    return Test("tones", records, f"tone {frequency}", level, tones_hz=(frequency,))


@pytest.mark.slow
def test_tones_are_predicted_where_the_joint_is_true():
    tests = [tone(f, level) for level in (0.3, 0.9) for f in (5.0, 6.0, 18.0)]
    data = Points.of(tone_groups(tests))
    assert data.groups.labels == (
        "tones 0.3 order 1", "tones 0.3 order 3", "tones 0.9 order 1", "tones 0.9 order 3",
    )  # fmt: skip
    # Four odd orders balanced against eight: a part in 1e6 of the first, 3e-6 of the third order
    # (theory, section 9), and of the largest value of each group.
    left = np.abs(np.asarray(data.predict(theta()) - data.mean))
    assert np.all(left.max(axis=1) < 1e-5 * np.abs(data.mean).max(axis=1))


@pytest.mark.slow
def test_a_guess_from_measurement_finds_the_steady_state_of_other_parameters():
    data = Points.of(tone_groups([tone(18.0, 0.5), tone(6.0, 0.5)]))
    # Newton's error is squared twice, from a motion that is off by five in a hundred.
    changed = theta(delta=320.0, zeta=0.0103)
    joint = BoucWen(118.0, 0.0103, 500.0, 320.0, 60.0)
    found = np.asarray(motion_of(changed, data))
    exact = np.asarray(steady_state(joint, np.asarray(data.omega), GAIN * 0.5, 4))
    assert np.abs(found - exact).max() < 2e-5 * np.abs(exact).max()


def test_a_held_response_is_compared_by_its_force():
    """One harmonic of motion: the force follows from the loop's own harmonic, closed form."""
    freq, y = np.linspace(18.0, 19.5, 7), 0.8e-3
    omega = 2 * np.pi * freq
    z_1 = complex(steady_loop(JOINT, y).z_1)
    force = (JOINT.k - omega**2 + 2j * JOINT.zeta * JOINT.omega_n * omega) * y + z_1
    channels = {
        "frequency": freq,
        "force": np.abs(force) / GAIN,
        "acceleration": omega**2 * y,
        "phase": np.pi - np.angle(force),
    }
    units = {"frequency": "Hz", "force": "N", "acceleration": "m/s^2", "phase": "rad"}
    test = Test("frf", (Record(float("nan"), channels, units),), "held", 10.0)
    group = curve_group(test)
    assert group.of_force
    data = Points.of([group])
    left = np.abs(np.asarray(data.misfit(theta())))
    # Quadrature of the loop's harmonic on both sides: rounding, amplified by cancellation.
    assert left.max() < 1e-9 * np.abs(force).max() / GAIN


def test_a_cubic_stiffness_beside_the_joint_adds_its_describing_function():
    r"""$f_1 = \tfrac34 \lambda_3 Y^3$ for $y = Y \cos\theta$."""
    y = jnp.asarray([2e-4, 8e-4])
    stiffer = BoucWen(118.0, 0.01, 500.0, 340.0, 60.0, restoring=Cubic(3e8))
    added = equivalent_stiffness(stiffer, y) - equivalent_stiffness(JOINT, y)
    np.testing.assert_allclose(added, 0.75 * 3e8 * y**2, rtol=1e-10)


@pytest.mark.slow
def test_an_frf_without_amplitude_is_that_of_the_sticking_joint():
    freq = np.linspace(17.0, 20.0, 13)
    omega = 2 * np.pi * freq
    h = GAIN / (JOINT.omega_n**2 - omega**2 + 2j * JOINT.zeta * JOINT.omega_n * omega)
    channels = {
        "frequency": freq, "force": np.ones(13), "displacement": np.abs(h), "phase": np.angle(h)
    }  # fmt: skip
    units = {"frequency": "Hz", "force": "N", "displacement": "m", "phase": "rad"}
    record = Record(float("nan"), channels, units, provenance={"ratio": "m/N"})
    data = Points.of([curve_group(Test("frf", (record,), "frf", 1.0))])
    left = np.abs(np.asarray(data.predict(theta()) - data.mean))
    # Softening at an amplitude of 1e-9: alpha delta Y of omega_n^2, amplified 50 times.
    assert left.max() < 1e-6 * np.abs(h).max()


def test_the_equivalent_stiffness_of_many_amplitudes_is_that_of_each():
    y = jnp.geomspace(1e-4, 1e-3, 40)
    each = jax.vmap(lambda one: steady_loop(JOINT, one).z_1 / one)(y)
    # Sixteen nodes over a decade; what converges is what the loop leaves of alpha.
    np.testing.assert_allclose(equivalent_stiffness(JOINT, y), each, atol=1e-9 * JOINT.alpha)


@pytest.mark.slow
def test_stepped_sines_are_cut_into_their_steps():
    one, two = tone(5.0, 0.3, repeats=1), tone(6.0, 0.3, repeats=1)
    joined = {
        role: np.concatenate([t.records[0].channels[role] for t in (one, two)])
        for role in ("input", "velocity")
    }
    record = Record(512.0, joined, one.records[0].units, "stepped_01")
    test = Test("stepped", (record,), "stepped", 0.3, (5.0, 6.0), dwell=8.0, settle=2.0)
    data = Points.of(stepped_groups(test))
    left = np.abs(np.asarray(data.predict(theta()) - data.mean))
    assert np.all(left.max(axis=1) < 1e-5 * np.abs(data.mean).max(axis=1))
    short = Test("stepped", (record,), "short", 0.3, (5.0, 6.0, 7.0), dwell=8.0)
    with pytest.raises(DataError, match="must contain 3 steps of 8 s, but lasts 16 s"):
        stepped_groups(short)


@pytest.mark.release  # test_contract.py has the slopes of points
def test_derivatives_are_the_implicit_ones():
    data = Points.of(tone_groups([tone(18.2, 0.5), tone(6.0, 0.5)]))

    def first(zeta, delta):
        return motion_of(theta() | {"zeta": zeta, "delta": delta}, data)[0, 0].real

    slopes = jax.grad(first, (0, 1))(jnp.asarray(0.01), jnp.asarray(340.0))

    def exact(zeta, delta):
        joint = BoucWen(118.0, zeta, 500.0, delta, 60.0)
        return float(np.real(steady_state(joint, 2 * np.pi * 18.2, GAIN * 0.5, 8)[0]))

    by_zeta = (exact(0.010001, 340.0) - exact(0.009999, 340.0)) / 2e-6
    by_delta = (exact(0.01, 340.1) - exact(0.01, 339.9)) / 0.2
    # Central differences of a converged balance: 1e-6; four orders for eight: 1e-6.
    np.testing.assert_allclose(slopes, [by_zeta, by_delta], rtol=2e-5)


def test_noise_of_a_group_is_that_of_its_repeats():
    test = tone(6.0, 0.5, repeats=400, noise=1e-4)
    data = Points.of(tone_groups([test]))
    # An amplitude from N samples has 2 sigma^2 / N in each of its two parts; 798 degrees of
    # freedom know it to 2.5 %.
    expected = 1e-4 * np.sqrt(2 / 4096)
    np.testing.assert_allclose(data.groups.noise_std, expected, rtol=4 * 0.025)
