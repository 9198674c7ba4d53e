"""The Jacobian of the costly fit, by differences, against exact derivatives by JAX."""

import jax.numpy as jnp
import numpy as np
import pytest

from jbw.inference.fit.costly_fit import costly_fit, evaluator, from_search
from jbw.inference.fit.fitting import linearise
from jbw.inference.space.box import box
from jbw.measurement.records import Record, Test
from jbw.observables.dataset import Dataset, stacked
from jbw.observables.records import Records
from jbw.observables.samples import band_limited, response_to

# A difference's error is the step squared, 1e-10, times a third derivative of some hundred, and
# rounding of 1e-16 over the step, 1e-11, times a residual of some thousand deviations.
ACCURACY = 1e-6  # of the largest entry of a column


def saturating(theta, data):
    t = jnp.linspace(0.0, 1.0, 40)
    fall = jnp.exp(-theta["rate"] * t)
    return theta["height"] * (1 - fall) + theta["shift"] * jnp.sin(3 * t) + theta["low"] * t - data


BOUNDS = box(
    # Of positive bounds, of either sign, from zero on, and beyond zero by a little: the search
    # runs over each of these in its own way.
    {"rate": (0.1, 10.0), "shift": (-2.0, 2.0), "height": (0.0, 5.0), "low": (-0.1, 3.0)}
)


def agree(residual, bounds, data, points):
    part = evaluator(residual, bounds, data)
    for s in points:
        x, slope = from_search(jnp.asarray(s), bounds)
        exact, row = (np.asarray(each) for each in linearise(residual, x, bounds, data))
        exact = exact * np.asarray(slope)
        np.testing.assert_allclose(part(s, 0), row, rtol=1e-9, atol=1e-9 * np.abs(row).max())
        largest = np.abs(exact).max(axis=0)
        assert np.all(largest > 0)  # every parameter matters to the data
        assert np.max(np.abs(part(s, 1) - exact) / largest) < ACCURACY


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_of_a_smooth_residual(seed):
    rng = np.random.default_rng(seed)
    agree(saturating, BOUNDS, jnp.asarray(rng.normal(size=40)), rng.uniform(0.02, 0.98, (5, 4)))


def test_the_residual_is_not_solved_again_for_its_jacobian():
    part = evaluator(saturating, BOUNDS, jnp.zeros(40))
    s = np.full(4, 0.4)
    first = part(s, 0)
    assert part(s, 0) is first
    assert part(s, 1).shape == (40, 4)
    assert part(s, 0) is first
    assert part(s + 0.1, 0) is not first


TIME = np.linspace(0.0, 1.0, 200)
NOISE, JUMP, BETWEEN = 0.01, 3e-4, 3e-5  # of values; of the model, and parameters between two


def jumping(theta, data):
    """A line whose values jump as a parameter moves, by far less than the noise."""
    line = theta["offset"] + theta["slope"] * TIME
    phase = jnp.floor(theta["slope"] / BETWEEN + 7.0 * TIME)
    return (line + JUMP * (phase % 2) - data) / NOISE


def smooth(theta, data):
    return (theta["offset"] + theta["slope"] * TIME - data) / NOISE


def test_a_residual_that_jumps_leaves_the_errors_of_a_line():
    bounds = box({"offset": (-2.0, 2.0), "slope": (-2.0, 2.0)})
    rng = np.random.default_rng(0)
    data = jnp.asarray(0.3 + 0.7 * TIME + NOISE * rng.standard_normal(len(TIME)))
    design = np.stack([np.ones_like(TIME), TIME], axis=1)
    covariance = NOISE**2 * np.linalg.inv(design.T @ design)
    start = {"offset": 0.0, "slope": 0.5}
    found = costly_fit(jumping, bounds, data, starts=start)
    # Jumps are 0.3 of a deviation over a difference that crosses two: to a sixth of a slope.
    np.testing.assert_allclose(np.diag(found.covariance), np.diag(covariance), rtol=0.3)
    # Over short differences the jumps are steep, and the slope looks far better known.
    jumps = evaluator(jumping, bounds, data)(np.array([0.575, 0.675]), 1)
    true = 4.0 * design[:, 1] / NOISE  # the box is four wide
    assert np.linalg.norm(jumps[:, 1]) > 1.5 * np.linalg.norm(true)
    # Where nothing jumps the short differences stand.
    same = costly_fit(smooth, bounds, data, starts=start)
    np.testing.assert_allclose(np.diag(same.covariance), np.diag(covariance), rtol=1e-6)


FS = 256.0
TRUTH = {
    "omega_n": 118.0, "zeta": 0.01, "alpha": 500.0, "delta": 300.0, "gamma": 30.0, "gain": 15.0
}  # fmt: skip
PRIOR = box(
    {
        "omega_n": (116.0, 120.0), "zeta": (0.0, 0.05), "alpha": (100.0, 2000.0),
        "delta": (50.0, 1000.0), "gamma": (-100.0, 300.0), "gain": (10.0, 20.0),
    }
)  # fmt: skip


def test_of_a_record_of_a_joint_that_is_solved_in_time():
    rng = np.random.default_rng(1)
    t = np.arange(256) / FS
    u = 0.1 * np.sin(2 * np.pi * 18 * t) * np.sin(np.pi * t) ** 2
    truth = {name: jnp.asarray(value) for name, value in TRUTH.items()}
    clean = np.asarray(response_to(truth, band_limited(u), FS))
    records = tuple(
        Record(FS, {"input": u, "velocity": clean + 1e-3 * rng.normal(size=256)},
               {"input": "V", "velocity": "m/s"})
        for _ in range(3)
    )  # fmt: skip
    data = Dataset.of([Records.of([Test("sweep", records, "sweep", 0.1)])])
    agree(stacked, PRIOR, data, rng.uniform(0.2, 0.8, (3, 6)))
