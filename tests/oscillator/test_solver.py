"""The parts of the hysteresis-exact step against closed forms, mpmath and scipy."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from jbw.oscillator.hold import input_polynomials, quintic, substep_matrices
from jbw.oscillator.laws.piecewise_map import distance, segment, smooth_move
from jbw.oscillator.linear import impulse_moments


@pytest.mark.parametrize(
    ("stiffness", "damping", "dt"),
    [(118.0**2, 1.05, 1 / 1024), (118.0**2, 0.0, 1 / 128), (100.0, 20.0, 0.05), (4.0, 9.0, 0.1)],
    ids=["paper", "undamped", "critical", "overdamped"],
)
def test_moments_match_the_augmented_exponential(stiffness, damping, dt):
    num = 6
    chain = np.zeros((2 + num, 2 + num))
    chain[0, 1] = 1.0
    chain[1, :3] = [-stiffness, -damping, 1.0]
    chain[2:-1, 3:] += np.eye(num - 1)
    exact = scipy.linalg.expm(chain * dt)
    m = impulse_moments(stiffness, damping, dt, num)
    free = np.array([[m.f_11, m.f_12], [m.f_21, m.f_22]])
    np.testing.assert_allclose(free, exact[:2, :2] - np.eye(2), rtol=1e-11)
    # Column 2 + j answers t^j / j!; the moments answer (t/h)^j. scipy's expm keeps fewer digits
    # in the tiny last columns.
    powers = np.array([float(mpmath.factorial(j)) / dt**j for j in range(num)])
    np.testing.assert_allclose(m.y, exact[0, 2:] * powers, rtol=1e-10)
    np.testing.assert_allclose(m.v, exact[1, 2:] * powers, rtol=1e-10)


def test_moments_of_a_free_particle_are_powers():
    m = impulse_moments(0.0, 0.0, 0.5, 6)
    j = np.arange(6)
    np.testing.assert_allclose(m.v, 0.5 / (j + 1), rtol=1e-15)
    np.testing.assert_allclose(m.y, 0.25 / ((j + 1) * (j + 2)), rtol=1e-15)


# XLA flushes subnormal numbers to zero; products must not fall there.
RATES = st.floats(-400, 400).filter(lambda c: c == 0 or abs(c) > 1e-100)
MOVES = st.floats(-4, 4).filter(lambda x: x == 0 or abs(x) > 1e-100)
move_fn, smooth_fn, distance_fn = (
    jax.jit(f) for f in (lambda *args: segment(*args)[0], smooth_move, distance)
)


def _exact_move(alpha, c, z, dy):
    with mpmath.workdps(30):
        c, dy = mpmath.mpf(c), mpmath.mpf(dy)
        phi = dy if c == 0 else -mpmath.expm1(-c * dy) / c
        return float(z + (alpha - c * z) * phi)


@settings(deadline=None, max_examples=60)
@given(c=RATES, x=MOVES, z=st.floats(-1, 1))
def test_move_solves_its_branch(c, x, z):
    dy = x / max(abs(c), 1.0) if abs(c) > 1e-3 else 1e-3 * x
    expected = _exact_move(500.0, c, z, dy)
    scale = max(abs(expected), abs(z), 500.0 * abs(dy))
    # Rounding, most of it in the terms that nearly cancel.
    assert float(move_fn(500.0, c, z, dy)) == pytest.approx(expected, abs=1e-12 * scale + 1e-300)
    if abs(c * dy) <= 1.0:
        assert float(smooth_fn(500.0, c, z, dy)) == pytest.approx(
            expected, abs=1e-12 * scale + 1e-300
        )


@settings(deadline=None, max_examples=60)
@given(c=RATES, x=MOVES)
def test_distance_inverts_the_move_from_zero(c, x):
    d = x / max(abs(c), 1.0)
    w = _exact_move(1.0, c, 0.0, d)
    # Where exp(-c d) is small, w holds d only to exp(c d) rounding errors.
    assert float(distance_fn(c, w)) == pytest.approx(
        d, abs=(1e-12 + 1e-15 * np.exp(c * d)) * abs(d) + 1e-300
    )


def test_derivatives_of_move_and_distance_match_differences():
    def check(function, *args, steps):
        args = tuple(jnp.float64(a) for a in args)
        for i, (a, step) in enumerate(zip(args, steps, strict=True)):
            slopes = [
                (function(*args[:i], a + h, *args[i + 1 :])
                 - function(*args[:i], a - h, *args[i + 1 :])) / (2 * h)
                for h in (step, 2 * step)
            ]  # fmt: skip
            expected = (4 * slopes[0] - slopes[1]) / 3
            # Fourth-order differences: truncation and rounding leave about 1e-9.
            assert float(jax.grad(function, i)(*args)) == pytest.approx(
                float(expected), rel=1e-8, abs=1e-10
            )

    for c in (-350.0, 0.0, 370.0):
        check(move_fn, 500.0, c, 0.4, 2e-3, steps=(0.1, 0.3, 1e-3, 1e-5))
        check(move_fn, 500.0, c, -0.4, 8e-3, steps=(0.1, 0.3, 1e-3, 1e-5))
        check(distance_fn, c, 1.1e-3, steps=(0.3, 1e-5))


def test_saturation_is_good_to_the_last_digits():
    x = np.linspace(-1, 1, 401)[np.arange(401) != 200]
    # From z = 0 with alpha = c = 1 the force is 1 - exp(-x).
    np.testing.assert_allclose(smooth_move(1.0, 1.0, 0.0, x), -np.expm1(-x), rtol=1e-14)


def test_quintic_reproduces_a_quintic():
    poly = np.polynomial.Polynomial([0.3, -1.0, 0.5, 2.0, -0.7, 0.2])
    ends = [jnp.array([p(s) for p in (poly, poly.deriv(), poly.deriv(2))]) for s in (0.0, 1.0)]
    np.testing.assert_allclose(quintic(*ends), poly.coef, atol=1e-13)


def test_substeps_carry_on_the_same_polynomial():
    c = np.array([0.3, -1.0, 0.5, 2.0])
    for i, matrix in enumerate(substep_matrices(4, 3)):
        s = np.linspace(0, 1, 5)
        part = np.polynomial.polynomial.polyval(s, matrix @ c)
        whole = np.polynomial.polynomial.polyval((i + s) / 3, c)
        np.testing.assert_allclose(part, whole, atol=1e-14)


def _between(coefficients, s):
    return np.polynomial.polynomial.polyval(s, np.asarray(coefficients).T, tensor=False)


def test_periodic_band_limited_input_meets_the_signal_between_samples():
    n = np.arange(256)
    signal = lambda n: np.cos(2 * np.pi * 10 * n / 256 + 0.3) + np.sin(2 * np.pi * 21 * n / 256)  # noqa: E731
    c = input_polynomials(jnp.asarray(signal(n)), "band_limited", periodic=True)
    # (omega h)^6 / 46080 at omega h = 2 pi 21/256.
    assert c.shape == (256, 6)
    assert np.abs(_between(c, 0.37) - signal(n + 0.37)).max() < 5e-7


def test_record_band_limited_input_is_good_up_to_its_edges():
    n = np.arange(1000)
    signal = lambda n: np.sin(0.2 * n + 0.7) * (1 + 0.001 * n)  # noqa: E731
    c = input_polynomials(jnp.asarray(signal(n)), "band_limited", periodic=False)
    error = np.abs(_between(c, 0.5) - signal(n[:-1] + 0.5))
    # Inside: the quintic. At the edges the unknown outside costs a part of the curvature, and
    # still less than a straight line would.
    assert error[20:-20].max() < 1e-6
    line = np.abs(0.5 * (signal(n[:-1]) + signal(n[1:])) - signal(n[:-1] + 0.5)).max()
    assert error.max() < 0.35 * line


@pytest.mark.parametrize("num", [2, 3, 40])
def test_holds_pass_through_the_samples(num):
    u = jnp.asarray(np.random.default_rng(num).normal(size=num))
    for hold in ("zero", "first", "band_limited"):
        c = input_polynomials(u, hold, periodic=False)
        np.testing.assert_allclose(c[:, 0], u[:-1], atol=1e-14)
        if hold != "zero":
            np.testing.assert_allclose(jnp.sum(c, axis=1), u[1:], atol=1e-12)
