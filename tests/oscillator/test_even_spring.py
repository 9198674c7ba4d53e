"""The even spring k_2 y^2, against SciPy's motion; no periodic motion of odd orders has it."""

import numpy as np
import pytest
from scipy_motion import scipy_motion

import jbw
from jbw.errors import ModelError
from jbw.oscillator.laws.springs import Cubic, Square

FS = 1024.0
TIME = np.arange(512) / FS
INPUT = 8.0 * np.sin(2 * np.pi * 17 * TIME) * np.sin(2 * np.pi * 3 * TIME)


def test_the_motion_is_scipys():
    joint = jbw.Oscillator(118.0, 0.01, (Square(8e5), Cubic(2e8)))
    found = jbw.simulate(joint, INPUT, FS, substeps=4)
    y, v, _ = scipy_motion(lambda y, v, m: 8e5 * y**2 + 2e8 * y**3, 118.0**2, 2.36, INPUT, FS)
    # Order 4 at 2.9e-2 rad a step; the test's integrator 1e-10.
    for one, other in ((found.y, y), (found.v, v)):
        assert np.max(np.abs(one - other)) < 1e-7 * np.max(np.abs(other))
    assert abs(np.mean(y)) > 0.02 * np.max(np.abs(y))  # it moves off its rest


def test_a_cubic_spring_about_another_rest_is_a_square_and_a_cubic_one():
    r"""$k_3 ((y + y_0)^3 - y_0^3) = 3 k_3 y_0^2\,y + 3 k_3 y_0\,y^2 + k_3\,y^3$."""
    k_3, y_0, omega_n = 2e8, 4e-4, 118.0
    shifted = jbw.Oscillator(
        np.sqrt(omega_n**2 + 3 * k_3 * y_0**2), 0.01, (Square(3 * k_3 * y_0), Cubic(k_3))
    )
    found = jbw.simulate(shifted, INPUT, FS, substeps=4)
    damping = 0.02 * np.sqrt(omega_n**2 + 3 * k_3 * y_0**2)
    y, *_ = scipy_motion(
        lambda y, v, m: k_3 * ((y + y_0) ** 3 - y_0**3), omega_n**2, damping, INPUT, FS
    )
    assert np.max(np.abs(found.y - y)) < 1e-7 * np.max(np.abs(y))


def test_steady_responses_refuse_it():
    joint = jbw.Oscillator(118.0, 0.01, (Square(8e5),))
    with pytest.raises(ModelError, match="even"):
        jbw.frequency_response(joint, np.array([110.0]), 0.1)


def test_free_motion_is_softened_to_second_order():
    r"""Frequency of free motion of $\omega_n^2 y + k_2 y^2$ by its energy's period, in closed form
    to order 2: $\omega = \omega_n (1 - 5 k_2^2 Y^2 / (12 \omega_n^4))$."""
    omega_n, k_2, reach = 118.0, 4e5, 3e-3
    # The turning points of one motion: equal potential, and the quadrature of dy / v.
    potential = np.polynomial.Polynomial([0, 0, omega_n**2 / 2, k_2 / 3])
    energy = potential(reach)
    ends = sorted(root.real for root in (potential - energy).roots())[-2:]
    middle, half = np.mean(ends), np.diff(ends)[0] / 2
    theta = (np.arange(200) + 0.5) * np.pi / 200
    y = middle + half * np.cos(theta)
    period = 2 * np.mean(half * np.sin(theta) / np.sqrt(2 * (energy - potential(y)))) * np.pi
    found = jbw.backbone(jbw.Oscillator(omega_n, 0.0, (Square(k_2),)), half)
    softening = 1 - found.omega / omega_n
    assert softening > 2e-3
    # What is left is of fourth order: a few times the square of the softening.
    assert abs(2 * np.pi / period / found.omega - 1) < 5 * softening**2
