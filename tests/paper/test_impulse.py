"""Kernels in time against trains of impulses, quadrature of their definition and H_n."""

from itertools import product

import jax
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from jbw.errors import ModelError
from jbw.paper.impulse import impulse_1, impulse_2, impulse_3
from jbw.paper.polynomial import PolynomialOscillator, kernel_1, kernel_2, kernel_3

SYSTEM = PolynomialOscillator(damping=0.8, stiffness=4.0, rho=0.7, lambda_3=-0.5)
HITS = ((0.0, 1.0), (0.35, -0.6), (1.1, 0.8))


def orders_after_impulses(system, hits, times):
    """y_1, y_2, y_3 after impulses (time, size), from the hierarchy of linear equations."""

    def rate(_, state):
        y, v = state[:3], state[3:]
        drive = [0, -system.rho * y[0] ** 2]
        drive.append(-2 * system.rho * y[0] * y[1] - system.lambda_3 * y[0] ** 3)
        return [*v, *(drive - system.stiffness * y - system.damping * v)]

    state, found = np.zeros(6), []
    ends = [*(time for time, _ in hits[1:]), max(times)]
    for (start, size), end in zip(hits, ends, strict=True):
        state[3] += size
        asked = [t for t in times if start < t <= end]
        options = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-15}
        run = solve_ivp(rate, (start, end), state, t_eval=sorted({*asked, end}), **options)
        found += [run.y[:3, np.flatnonzero(run.t == t)[0]] for t in asked]
        state = run.y[:, -1].copy()
    return np.array(found).T


def test_response_to_impulses_is_the_sum_over_kernels():
    times = np.array([0.2, 0.8, 1.0, 1.5, 3.0, 6.0])
    expected = orders_after_impulses(SYSTEM, HITS, times)
    first = sum(a * impulse_1(SYSTEM, times - s) for s, a in HITS)
    second = sum(
        a * b * impulse_2(SYSTEM, times - s, times - r) for (s, a), (r, b) in product(HITS, HITS)
    )
    third = sum(
        a * b * c * impulse_3(SYSTEM, times - s, times - r, times - q)
        for (s, a), (r, b), (q, c) in product(HITS, HITS, HITS)
    )
    # The integrator's tolerance, 1e-13 a step over some hundred steps.
    np.testing.assert_allclose(np.stack([first, second, third]), expected, rtol=0, atol=1e-12)


def test_second_kernel_is_its_integral():
    def h(s):
        decay, omega_d = 0.4, np.sqrt(4.0 - 0.16)
        return np.exp(-decay * s) * np.sin(omega_d * s) / omega_d

    for tau in ((0.7, 0.7), (0.4, 2.9), (5.0, 1.3)):
        integral, _ = quad(lambda s, a, b: h(s) * h(a - s) * h(b - s), 0, min(tau), args=tau)
        assert float(impulse_2(SYSTEM, *tau)) == pytest.approx(-0.7 * integral, rel=1e-11)


def test_kernels_are_causal_and_symmetric():
    assert float(impulse_1(SYSTEM, -0.1)) == 0.0
    assert float(impulse_2(SYSTEM, 1.0, -0.1)) == 0.0
    assert float(impulse_3(SYSTEM, 1.0, 2.0, -0.1)) == 0.0
    swapped = impulse_3(SYSTEM, 2.0, 0.5, 1.0)
    np.testing.assert_allclose(impulse_3(SYSTEM, 0.5, 1.0, 2.0), swapped, rtol=1e-12)


def test_transforms_are_the_kernels_in_frequency():
    heavy = PolynomialOscillator(damping=2.4, stiffness=4.0, rho=0.7, lambda_3=-0.5)
    omega = (0.6, -1.1, 1.7)
    fine = 0.01 * np.arange(1000)
    found = [0.01 * np.exp(-1j * omega[0] * fine) @ impulse_1(heavy, fine)]
    step = 0.2
    tau = step * np.arange(40)
    waves = [step * np.exp(-1j * w * tau) for w in omega]
    found.append(waves[0] @ np.asarray(impulse_2(heavy, tau[:, None], tau)) @ waves[1])
    cube = jax.jit(impulse_3)(heavy, tau[:, None, None], tau[:, None], tau)
    found.append(np.einsum("ijk,i,j,k", cube, *waves, optimize=True))
    expected = [kernel_1(heavy, omega[0]), kernel_2(heavy, *omega[:2]), kernel_3(heavy, *omega)]
    # The kernels are cut off at exp(-1.2 * 8) = 7e-5 and, but for the first, flat at both ends,
    # where the trapezoid rule is much better than its second order.
    np.testing.assert_allclose(found, np.array(expected), rtol=1e-3)


def test_kernels_in_time_need_an_underdamped_oscillator():
    for damping in (0.0, 4.0, 5.0):
        with pytest.raises(ModelError, match="damping above zero and below critical"):
            impulse_2(PolynomialOscillator(damping, 4.0, 0.7, -0.5), 1.0, 2.0)
