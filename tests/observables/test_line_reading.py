"""The line fit of random motion as an observable."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jbw import rig
from jbw.identification.linear_step import linear_step
from jbw.observables.groups import changed
from jbw.observables.line_fit import LineReading
from jbw.oscillator.laws.hysteresis import steady_loop
from jbw.oscillator.modes.parameters import NAMES
from jbw.oscillator.oscillator import BoucWen

TRUTH = {
    "omega_n": 2 * np.pi * 18.8,
    "zeta": 0.00444,
    "alpha": 497.4,
    "delta": 340.21,
    "gamma": 32.84,
    "gain": 15.0,
}


def theta(**changes):
    return {name: jnp.asarray(value) for name, value in {**TRUTH, **changes}.items()}


def test_the_largest_displacement_is_a_quantile_of_rayleighs_amplitudes():
    sigma = 4e-4
    shown = LineReading.of(np.ones(3), np.eye(3), sigma).shown()
    assert shown.y_peak == pytest.approx(stats.rayleigh.ppf(0.99, scale=sigma), rel=1e-12)


def test_the_average_over_amplitudes_is_rayleighs():
    """Monte Carlo over the amplitudes in place of quadrature."""
    sigma = 4e-4
    data = LineReading.of(np.ones(3), np.eye(3), sigma)
    omega, zeta, gain = (float(x) for x in data.predict(theta())[0])
    y = stats.rayleigh.ppf((np.arange(20000) + 0.5) / 20000, scale=sigma)
    names = ("omega_n", "zeta", "alpha", "delta", "gamma")
    joint = BoucWen(*(TRUTH[name] for name in names))
    z_1 = np.asarray(steady_loop(joint, jnp.asarray(y)).z_1)
    stiffness = np.mean(z_1 * y) / np.mean(y**2)
    squared = joint.k + stiffness.real
    # The tail beyond the last of 20,000 quantiles weighs 1e-4 of the second moment.
    assert omega**2 == pytest.approx(squared, rel=1e-5)
    added = stiffness.imag / (2 * squared)
    assert zeta - 0.00444 * joint.omega_n / omega == pytest.approx(added, rel=1e-3)
    assert gain == 15.0


def test_small_amplitudes_shift_by_the_series():
    r"""$\omega_{eq}^2 = \omega_n^2 - \frac{4}{3\pi}\alpha\delta\,3\sqrt{\pi/8}\,\sigma$."""
    sigma = 1e-7
    data = LineReading.of(np.ones(3), np.eye(3), sigma)
    omega = float(data.predict(theta())[0, 0])
    expected = 4 / (3 * np.pi) * 497.4 * 340.21 * 3 * np.sqrt(np.pi / 8) * sigma
    # The next term is of relative order delta sigma = 3e-5; the difference of squares has 12
    # digits less six.
    assert TRUTH["omega_n"] ** 2 - omega**2 == pytest.approx(expected, rel=2e-4)


def test_points_are_read_by_one_program_as_each_by_itself():
    data = LineReading.of(np.ones(3), np.eye(3), 4e-4)
    points = {name: value * np.array([0.9, 1.0, 1.1]) for name, value in TRUTH.items()}
    solution = data.solved(points, 1, writes=True).solution
    alone = [data.predict({name: x[i] for name, x in points.items()}) for i in range(3)]
    # One program adds up the same 24 amplitudes in another order.
    np.testing.assert_allclose(solution, alone, rtol=1e-12)


def test_readings_of_several_modes_are_left_to_the_program_around_them():
    data = LineReading.of(np.ones(3), np.eye(3), 4e-4)
    points = {name: np.full(3, value) for name, value in {**TRUTH, NAMES[0].omega: 500.0}.items()}
    assert data.solved(points, 1, writes=True) is None


def test_where_no_offsets_are_asked_for_the_density_is_at_none():
    """Directions that are known take nothing out of the residual."""
    data = LineReading.of(np.array([120.0, 0.01, 15.0]), np.eye(3), 4e-4)
    moved = replace(data, groups=changed(data.groups, directions=np.ones((1, 2, 3))))
    plain, known = (each.estimate(theta(), 0).log_density for each in (data, moved))
    np.testing.assert_allclose(known, plain, rtol=1e-14)


def test_the_reading_of_the_rig_is_predicted():
    """Truth inside the reading's own errors, at an amplitude where softening is 40 of them."""
    (test,) = rig.measure(seed=3, tests=["noise_0p005V"], repeats=2).tests
    found = linear_step(test)
    data = LineReading.of(found.pooled.mean, found.pooled.covariance, found.y_rms)
    left, _ = data.weighted(theta())
    assert stats.chi2.sf(float(jnp.sum(left**2)), 3) > 1e-4
    ignorant = data.weighted(theta(alpha=1e-9))[0]
    assert stats.chi2.sf(float(jnp.sum(ignorant**2)), 3) < 1e-9
