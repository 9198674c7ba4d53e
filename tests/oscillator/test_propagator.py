import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from volterra.propagator import held_input, hermite_input, propagate, propagator


def exact(stiffness, damping, dt):
    """Transition and moments of one step to 40 digits, by quadrature of the matrix exponential."""
    with mpmath.workdps(40):
        h = mpmath.mpf(dt)
        generator = mpmath.matrix([[0, 1], [-mpmath.mpf(stiffness), -mpmath.mpf(damping)]])
        transition = mpmath.expm(generator * h)

        def moment(row, power):
            def integrand(s):
                return mpmath.expm(generator * (h - s))[row, 1] * (s / h) ** power

            return float(mpmath.quad(integrand, [0, h]))

        rows = [[float(transition[i, k]) for k in range(2)] for i in range(2)]
        return np.array(rows), np.array([[moment(i, j) for j in range(4)] for i in range(2)])


@pytest.mark.parametrize(
    ("stiffness", "damping", "dt"),
    [
        (118.12**2, 2 * 0.00444 * 118.12, 1 / 1024),
        (118.12**2, 2 * 118.12, 1 / 64),  # critical
        (4.0, 50.0, 0.1),  # overdamped
        (9.0, 0.0, 0.3),  # undamped
    ],
)
def test_step_is_exact(stiffness, damping, dt):
    step = propagator(stiffness, damping, dt)
    transition, moments = exact(stiffness, damping, dt)
    # A matrix exponential is good to a few units in the last place of its largest entry, in
    # the scaled state (y, h v).
    np.testing.assert_allclose(step.transition, transition, rtol=2e-13)
    np.testing.assert_allclose(step.moments, moments, rtol=2e-13)


def test_free_mass_under_a_cubic_input():
    # y'' = 1 + s + s^2 + s^3 from rest over 2 s, in steps of 1/4 s: integrated by hand.
    t = jnp.linspace(0.0, 2.0, 9)
    y, v = propagate(
        propagator(0.0, 0.0, 0.25),
        hermite_input(1 + t + t**2 + t**3, 1 + 2 * t + 3 * t**2, 0.25),
    )
    np.testing.assert_allclose(y, t**2 / 2 + t**3 / 6 + t**4 / 12 + t**5 / 20, rtol=1e-13)
    np.testing.assert_allclose(v, t + t**2 / 2 + t**3 / 3 + t**4 / 4, rtol=1e-13)


def test_holds_of_a_ramp():
    t = jnp.linspace(0.0, 2.0, 9)
    step = propagator(0.0, 0.0, 0.25)
    first, _ = propagate(step, held_input(t, "first"))
    np.testing.assert_allclose(first, t**3 / 6, rtol=1e-13)
    # The staircase lags: velocity is the sum of the steps.
    _, zero = propagate(step, held_input(t, "zero"))
    np.testing.assert_allclose(zero, 0.25 * np.concatenate([[0.0], np.cumsum(t[:-1])]))


def test_step_is_differentiable():
    # d/d(stiffness) of the free response of an undamped oscillator, y = cos(w h).
    slope = jax.grad(lambda stiffness: propagator(stiffness, 0.0, 0.3).transition[0, 0])(4.0)
    assert float(slope) == pytest.approx(-0.3 * np.sin(0.6) / 4.0, rel=1e-12)
