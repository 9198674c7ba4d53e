"""The hand-written derivatives of a step through kinks against differences of the step itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jbw.oscillator.laws.kinked_step import kinked_step

ALPHA, DELTA, GAMMA, LIFT = 500.0, 340.0, 33.0, 1e-5
# (z, slope at the start, slope at the end, rise) in N/kg and m.
CASES = {
    "smooth": (0.3, 1e-3, 1.2e-3, 1.1e-3),
    "turning": (0.3, 1e-3, -0.7e-3, 0.2e-3),
    "turning the other way": (0.25, -1e-3, 0.4e-3, -0.4e-3),
    "zero": (-0.2, 1e-3, 1e-3, 1e-3),
    "zero downwards": (0.2, -1e-3, -1e-3, -1e-3),
    "zero, then turning": (-0.05, 1e-3, -0.7e-3, 0.25e-3),
    "turning, then zero": (0.02, 0.5e-3, -1.5e-3, -0.6e-3),
}


def step(p):
    return jnp.stack(kinked_step((p[0], p[1], p[2]), p[3], (p[4], p[5], p[6]), p[7]))


value, slopes = jax.jit(step), jax.jit(jax.jacfwd(step))


@pytest.mark.parametrize(("delta", "gamma"), [(DELTA, GAMMA), (-90.0, 80.0), (50.0, -20.0)])
@pytest.mark.parametrize("name", CASES)
def test_slopes_match_differences(name, delta, gamma):
    p = np.array([ALPHA, delta, gamma, *CASES[name], LIFT])
    expected = np.stack(
        [(value(p + h) - value(p - h)) / 2e-6 for h in np.diag(1e-6 * np.abs(p))], axis=1
    )
    scale = np.abs(expected).max(axis=1, keepdims=True)
    error = np.abs(slopes(p) * np.abs(p) - expected)
    # Central differences of numbers good to 1e-16, a millionth apart: about 1e-9. On a path that
    # does not turn one Newton step finds the zero of z to order h^3, while the derivative is that
    # of the zero itself.
    tolerance = 3e-4 if name.startswith("zero") else 1e-7
    assert np.all(error <= tolerance * scale), error / scale


def test_smooth_steps_get_no_kick():
    _, impulse_v, impulse_y = value(np.array([ALPHA, DELTA, GAMMA, *CASES["smooth"], LIFT]))
    assert impulse_v == impulse_y == 0.0
