"""The joint's smoothed oscillator by kernels, against scipy's integration and differences."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.integrate import solve_ivp

from jbw.oscillator.oscillator import BoucWen
from jbw.paper.coefficients import Smoothing, branch, smoothing
from jbw.paper.equivalent import (
    equivalent_acceleration,
    simulate_equivalent,
    smoothed_harmonics,
    square_wave,
)
from jbw.paper.kernel_responses import (
    periodic_response,
    synthesize,
    tone_response,
    volterra_response,
)
from jbw.paper.kernels import cubic_kernel, h3
from jbw.paper.polynomial import PolynomialOscillator, cubic_oscillator
from jbw.paper.probing import cross_kernel, kernel, leading_diagonals

JOINT = BoucWen(2 * np.pi * 18.8, 0.00444, 497.40, 340.21, 32.84)
FS = 512.0


def integrated(system, u):
    """Displacement of the cubic oscillator under joined lines of input, by DOP853."""
    state, motion = np.zeros(2), [0.0]
    for start, end in itertools.pairwise(u):

        def rate(t, state, start=start, end=end):
            y, v = state
            push = start + (end - start) * t * FS
            spring = system.stiffness * y + system.lambda_3 * y**3
            return [v, push - system.damping * v - spring]

        options = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-18}
        state = solve_ivp(rate, (0.0, 1 / FS), state, **options).y[:, -1]
        motion.append(state[0])
    return np.array(motion)


def test_response_by_kernels_meets_the_equivalent_system_with_its_slope():
    # The joint's cubic oscillator (26) at 0.8 mm, swept through its resonance in half a second.
    system = cubic_oscillator(JOINT, smoothing(JOINT, 8e-4))
    t = np.arange(256) / FS
    shape = np.sin(2 * np.pi * (10.0 * t + 18.0 * t**2))
    errors = {3: [], 5: []}
    for amplitude in (4.0, 2.0):
        exact = integrated(system, amplitude * shape)
        response = volterra_response(system, amplitude * shape, FS, substeps=8, max_order=5)
        for order in errors:
            part = np.sum(response.y[:order], axis=0)
            errors[order].append(np.max(np.abs(part - exact)))
    # Without rho the first order left out is y_5, then y_7; the next one bends the slope.
    for order, (coarse, fine) in errors.items():
        assert np.log2(coarse / fine) == pytest.approx(order + 2, abs=0.2)


def test_the_equivalent_systems_own_integration_meets_the_kernels():
    polynomial = smoothing(JOINT, 8e-4)
    closed = Smoothing(0.0, polynomial.lambda_1, 0.0, polynomial.lambda_3)
    t = np.arange(256) / FS
    u = 0.5 * np.sin(2 * np.pi * (10.0 * t + 18.0 * t**2))
    own = simulate_equivalent(JOINT, closed, u, FS, substeps=8)
    kernels = volterra_response(cubic_oscillator(JOINT, polynomial), u, FS, substeps=8, max_order=5)
    total = np.sum(kernels.y, axis=0)
    # Tsit5 at omega h = 0.03 is good to 1e-10 of the motion; y_7 at this input is smaller still.
    np.testing.assert_allclose(own.y, total, rtol=0, atol=1e-7 * np.max(np.abs(total)))


def test_golden_loops_end_where_the_branches_meet(golden):
    for case in golden["steady_loop"]["cases"]:
        law = BoucWen(100.0, 0.01, case["alpha"], case["delta"], case["gamma"])
        # z at the tip is up to alpha Y: a few roundings of it.
        scale = case["alpha"] * case["Y"]
        loading, unloading = (branch(law, case["Y"], case["y0"], path) for path in (4, 1))
        np.testing.assert_allclose(loading, case["Zmax"], rtol=0, atol=1e-14 * scale)
        np.testing.assert_allclose(unloading, case["Zmax"], rtol=0, atol=1e-12 * scale)


@pytest.mark.filterwarnings("ignore:The smoothing holds for weak hysteresis")
def test_golden_harmonics_of_the_loop_by_the_chebyshev_cubic(golden):
    for case in golden["steady_loop"]["cases"]:
        law = BoucWen(100.0, 0.01, case["alpha"], case["delta"], case["gamma"])
        first, third = smoothed_harmonics(smoothing(law, case["Y"], "chebyshev"), case["Y"])
        scale = case["alpha"] * case["Y"]
        # The cosine parts are kept exactly; of the sine parts the cubic keeps a share.
        np.testing.assert_allclose(first.real, case["Z1"][0], rtol=0, atol=1e-13 * scale)
        np.testing.assert_allclose(third.real, case["Z3"][0], rtol=0, atol=1e-13 * scale)


def test_printed_print_is_right_with_itself():
    # (10) and (15) carry the same reversed sign: together they are the corrected force.
    corrected, printed = smoothing(JOINT, 8e-4), smoothing(JOINT, 8e-4, "printed")
    theta = np.linspace(0.1, 3.0, 5)
    right = square_wave(corrected.lambda_0, theta)
    both = square_wave(printed.lambda_0, theta, "printed")
    # (10) drops terms of 0.9 % at 0.8 mm.
    np.testing.assert_allclose(both, right, rtol=0.02)


SYSTEM = PolynomialOscillator(0.25, 1.0, 0.4, -0.3)
RECORD = 0.2 * np.sin(0.3 * np.arange(24))


@pytest.mark.parametrize(
    "function",
    [
        lambda s: kernel(s, 0.3, -0.7, 1.1, 0.4),
        lambda s: leading_diagonals(s, 0.3, 4)[3],
        lambda s: cross_kernel(s, (0.3, 0.5, 0.9), (0, 1, 1)),
        lambda s: synthesize(tone_response(s, np.array([0.3, 0.8]), np.array([0.2, 0.1j])), 1.7),
        pytest.param(  # a periodic record stands for it
            lambda s: volterra_response(s, RECORD, 4.0).y[:, -3], marks=pytest.mark.release
        ),
        lambda s: periodic_response(s, RECORD, 4.0).y[:, 5],
    ],
    ids=["kernel", "diagonal", "cross", "tones", "record", "periodic"],
)
def test_gradients_in_the_oscillator_are_those_of_differences(function):
    def parts(values):
        found = jnp.asarray(function(PolynomialOscillator(*values)))
        return jnp.stack([found.real, found.imag]) if jnp.iscomplexobj(found) else found

    values = tuple(map(jnp.asarray, jax.tree.leaves(SYSTEM)))
    # Central differences of 1e-5 of numbers of order one: 1e-10 of truncation, 1e-11 of rounding.
    check_grads(jax.jit(parts), (values,), 1, eps=1e-5, atol=1e-6, rtol=1e-6)


@pytest.mark.parametrize(
    "function",
    [
        lambda j, y: branch(j, y, 1e-5, 2) / (j.alpha * 8e-4),
        lambda j, y: branch(j, y, 1e-5, 3, order=3) / (j.alpha * 8e-4),
        lambda j, y: equivalent_acceleration(j, smoothing(j, y), 3e-4, -0.1, 1.0),
        pytest.param(  # test_traced_numbers.py has its slope
            lambda j, y: jnp.abs(h3(j, 36.0, y)) * 1e9, marks=pytest.mark.release
        ),
        lambda j, y: jnp.angle(cubic_kernel(36.0, j.omega_n, j.zeta, -6e7)),
    ],
    ids=["branch", "taylor", "acceleration", "h3", "cubic_kernel"],
)
def test_gradients_in_the_joint_are_those_of_differences(function):
    def value(parts):
        omega_n, zeta, alpha, delta, gamma, y_peak = parts * scale
        return function(BoucWen(omega_n, zeta, alpha, delta, gamma), y_peak)

    scale = jnp.array([118.1, 0.00444, 497.4, 340.21, 32.84, 8e-4])
    # Parameters over their size; differences of 1e-4 of it have an error of 1e-8.
    check_grads(jax.jit(value), (jnp.ones(6),), 1, eps=1e-4, atol=1e-5, rtol=1e-5)
