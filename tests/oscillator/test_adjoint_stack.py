"""Derivatives of motions whose law remembers reversals, beside other laws, and in lanes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jbw
from jbw.oscillator.laws.bouc_wen import BoucWenLaw
from jbw.oscillator.laws.iwan import Iwan4

pytestmark = pytest.mark.slow  # compiles gradients

FS, NUM = 512.0, 700
# A slow sweep that grows and dies: turns, closures, macroslip and loops within loops.
TIME = np.arange(NUM) / FS
U = jnp.asarray(6.0 * np.sin(np.pi * 30.0 * TIME**2) * np.sin(np.pi * TIME / TIME[-1]) ** 2)
# omega_n, zeta; K_T, F_S, chi, beta; alpha, delta, gamma: macroslip is reached.
POINT = jnp.array([118.0, 0.005, 1500.0, 1.5, -0.3, 0.5, 300.0, 200.0, 100.0])
AT = jnp.array([60, 333, 699])  # samples that are looked at


def motion(x, u=U):
    iwan, bouc_wen = Iwan4.of_segalman(*x[2:6]), BoucWenLaw(*x[6:])
    found = jbw.simulate(jbw.Oscillator(x[0], x[1], (iwan, bouc_wen)), u, FS)
    return jnp.concatenate([found.y[AT] * 1e3, found.v[AT], found.z[AT]])


run = jax.jit(motion)
slopes = jax.jit(jax.jacrev(motion))


@pytest.fixture(scope="module")
def backward():
    return np.asarray(slopes(POINT))


@pytest.mark.release  # differences of the motion are in this file
def test_both_modes_agree(backward):
    forward = np.asarray(jax.jit(jax.jacfwd(motion))(POINT))
    # The same sums in another order.
    np.testing.assert_allclose(forward, backward, rtol=1e-9, atol=1e-12 * np.abs(backward).max())


def test_they_are_differences_of_the_motion(backward):
    step = 1e-6 * POINT
    ends = [
        [run(POINT.at[i].add(sign * step[i]), U) for sign in (1, -1)] for i in range(len(POINT))
    ]
    differences = np.stack([(a - b) / (2.0 * h) for (a, b), h in zip(ends, step, strict=True)], 1)
    # Rounding of the motion over the step, 1e-16 / 1e-6, and what it is amplified by.
    scale = np.abs(differences).max(axis=0)
    assert np.all(np.abs(backward - differences) <= 2e-6 * scale)


@pytest.mark.release  # test_adjoint.py has derivatives by the input
def test_by_the_input(backward):
    bump = jnp.asarray(np.exp(-(((TIME - 0.5) / 0.05) ** 2)))

    @jax.jit
    def by_both_modes(u, bump):
        def of_input(u):
            return motion(POINT, u)

        _, slope = jax.jvp(of_input, (u,), (bump,))
        return slope, jax.grad(lambda u: of_input(u) @ jnp.ones(9))(u)

    slope, by_input = by_both_modes(U, bump)
    difference = (run(POINT, U + 1e-5 * bump) - run(POINT, U - 1e-5 * bump)) / 2e-5
    np.testing.assert_allclose(slope, difference, atol=1e-6 * np.abs(difference).max())
    assert float(by_input @ bump) == pytest.approx(float(jnp.sum(slope)), rel=1e-9)


@pytest.mark.release  # differences of the motion are in this file
def test_lanes_have_the_gradients_of_each(backward):
    points = POINT * (1.0 + 0.02 * jnp.arange(3.0)[:, None])
    found = np.asarray(jax.jit(jax.vmap(jax.jacrev(motion)))(points))
    each = np.stack([slopes(point) for point in points])
    np.testing.assert_allclose(found, each, rtol=1e-9, atol=1e-11 * np.abs(each).max())
