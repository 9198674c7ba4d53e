"""Springs of powers, of |y| y and stops: closed forms, quadrature and SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy_motion import scipy_motion

import jbw
from jbw.oscillator.laws.kinked_springs import Quadratic, Stop
from jbw.oscillator.laws.springs import Quintic
from jbw.oscillator.oscillator import Oscillator

OMEGA_N, ZETA, FS = 118.0, 0.01, 1024.0
TIME = np.arange(256) / FS
INPUT = 8.0 * np.sin(2 * np.pi * 17 * TIME) * np.sin(2 * np.pi * 3 * TIME)
LAWS = {
    "quintic": Quintic(2e13),
    "softening": Quadratic(-8e5),
    "stiffening": Quadratic(8e5),
    "pinning": Stop(5e3, 1.1e-3),
    "opening": Stop(-3e3, 1.1e-3),
}


def oscillator(law):
    return jax.tree.map(lambda x: jnp.asarray(x, float), Oscillator(OMEGA_N, ZETA, (law,)))


def harmonic(force, y_peak, n, corners=()):
    """F_n of y = Y cos(theta) by SciPy's quadrature over a quarter of a period, n odd."""
    inside = [np.arccos(c / y_peak) for c in corners if c < y_peak]
    return 4 / np.pi * quad(
        lambda theta: force(y_peak * np.cos(theta)) * np.cos(n * theta),
        0.0, np.pi / 2, points=inside or None, epsabs=1e-14, epsrel=1e-13,
    )[0]  # fmt: skip


FORCES = {
    "quintic": (lambda y: 2e13 * y**5, ()),
    "softening": (lambda y: -8e5 * y * abs(y), ()),
    "stiffening": (lambda y: 8e5 * y * abs(y), ()),
    "pinning": (lambda y: 5e3 * np.sign(y) * max(abs(y) - 1.1e-3, 0.0), (1.1e-3,)),
    "opening": (lambda y: -3e3 * np.sign(y) * max(abs(y) - 1.1e-3, 0.0), (1.1e-3,)),
}


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("y_peak", [4e-4, 1.2e-3, 4e-3])
def test_harmonics_are_those_of_scipys_quadrature(name, y_peak):
    law, (force, corners) = LAWS[name], FORCES[name]
    first, third = (harmonic(force, y_peak, n, corners) for n in (1, 3))
    scale = max(abs(first), 1e-12)
    loop = law.loop(y_peak)
    np.testing.assert_allclose(loop.stiffness * y_peak, first, rtol=1e-12, atol=1e-13)
    assert loop.damping == 0.0
    turn = np.exp(0.7j)
    found = law.harmonics(jnp.array([y_peak * turn, 0.0, 0.0]), 2)
    np.testing.assert_allclose(found[0], first * turn, atol=1e-10 * scale)
    np.testing.assert_allclose(found[1], third * turn**3, atol=1e-10 * scale)
    # Of the grid that serves motions of many turns, an error of its second power.
    many = law.harmonics(jnp.array([y_peak * turn, 0.0, 0.0]), 4)
    np.testing.assert_allclose(many, found, atol=3e-4 * scale)


def test_the_small_loop_is_a_closed_form():
    np.testing.assert_allclose(Quintic(3.0).loop(2.0).stiffness, 5 / 8 * 3.0 * 2.0**4, rtol=1e-14)
    np.testing.assert_allclose(Quadratic(3.0).loop(2.0).stiffness, 16 / np.pi, rtol=1e-14)
    # A stop of no gap is a spring; within its gap it is nothing.
    np.testing.assert_allclose(Stop(3.0, 0.0).loop(2.0).stiffness, 3.0, rtol=1e-14)
    assert Stop(3.0, 2.0).loop(1.0).stiffness == 0.0


@pytest.mark.parametrize("name", LAWS)
def test_the_loop_has_a_slope_at_rest_and_at_the_gap(name):
    for y_peak in (0.0, 1.1e-3):
        slope = jax.grad(lambda y: LAWS[name].loop(y).stiffness)(y_peak)
        assert np.isfinite(slope)


@pytest.mark.parametrize("name", LAWS)
def test_the_motion_is_that_of_scipy_by_a_step_of_order_4(name):
    force, _ = FORCES[name]
    exact = scipy_motion(
        lambda y, v, m: force(y), OMEGA_N**2, 2 * ZETA * OMEGA_N, INPUT, FS
    )  # fmt: skip
    for substeps, tolerance in ((1, 4e-6), (4, 2e-8)):
        found = jbw.simulate(oscillator(LAWS[name]), INPUT, FS, substeps=substeps)
        for wanted, x in zip(exact, (found.y, found.v), strict=False):
            np.testing.assert_allclose(x, wanted, atol=tolerance * np.max(np.abs(wanted)))
