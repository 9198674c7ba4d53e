"""A backbone among the candidates of a plan: what it tells, by a closed form, and where it is."""

import jax.numpy as jnp
import numpy as np
import pytest

from jbw import rig
from jbw.observables.controlled import ControlledPoints
from jbw.observables.dataset import Dataset
from jbw.planning.description import parse
from jbw.planning.plan import PlannedBackbone
from jbw.planning.prospects import fisher

SIZE, NOISE = 2048, 5e-5  # samples read of a point, and noise of each [m/s]


def test_weak_points_tell_what_a_linear_oscillator_has_in_closed_form():
    r"""f = omega_n / (2 pi) and F = 2 zeta omega_n^2 Y / g.

    Of relative errors eps of the response: (1 / (zeta eps))^2 + (2 / eps)^2 of omega_n, and
    (1 / eps)^2 of zeta, summed over the points; the joint slips by 1e-4 of its stiffness at most.
    """
    amplitudes = np.array([1e-6, 2e-6])
    joint = rig.TRUTH
    theta = {name: jnp.asarray(getattr(joint, name)) for name in
             ("omega_n", "zeta", "alpha", "delta", "gamma")}  # fmt: skip
    theta["gain"] = jnp.asarray(0.5)
    data = ControlledPoints.design(
        theta, amplitudes, response="velocity", noise_std=NOISE, num_samples=SIZE
    )
    names = ("omega_n", "zeta")
    one = {name: np.array([float(value)]) for name, value in theta.items()}
    scale = np.array([[float(theta[name]) for name in names]])
    (information,) = fisher(one, names, scale, Dataset.of([data]), np.ones(4))
    part = NOISE * np.sqrt(2 / SIZE) / (joint.omega_n * amplitudes)
    square = np.sum(part**-2.0)
    expected = [[square * (joint.zeta**-2.0 + 4), 2 * square], [2 * square, square]]
    np.testing.assert_allclose(information, expected, rtol=2e-3)


def test_a_backbone_lasts_as_long_as_its_points():
    candidate = PlannedBackbone(
        0.5, (1e-3, 2e-3, 3e-3), dwell=8.0, settle=2.0, fs=512.0, natural_hz=18.8
    )
    assert candidate.seconds == 24.0
    assert candidate.num_samples == 3072
    assert str(candidate) == "backbone 1-3 mm, 3 points of 8 s"


def test_a_plan_file_states_a_backbone():
    text = """[plan]
natural_hz = 18.8
alpha = 497.4
delta = 340.2
gamma = 32.8
modal_mass = 1.93
noise = 5e-5
[backbone]
amplitudes = [1e-3, 4e-3]
"""
    assert parse(text).grids["backbone"]["amplitudes"] == (1e-3, 4e-3)
    with pytest.raises(Exception, match="settle: must be shorter than dwell"):
        parse(text + "dwell = 2.0\nsettle = 3.0\n")
