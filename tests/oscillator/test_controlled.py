"""Force and frequency that hold a motion: Bouc-Wen's describing function, and SciPy's motion."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from describing import describing_function
from scipy.integrate import solve_ivp
from scipy.optimize import root

from jbw import BoucWen
from jbw.oscillator.steady.backbone import force_at, tone_at_phase

OMEGA_N, ZETA = 2 * np.pi * 18.8, 0.003
# One that softens less than it damps, and one whose S-curves fold.
PAPER = BoucWen(OMEGA_N, 0.00444, 497.40, 340.21, 32.84)
FOLDED = BoucWen(OMEGA_N, ZETA, 3000.0, 340.21, 3.0)
PHASE = -np.pi / 2


def arrays(function):
    """A function compiled once for all joints and amplitudes, which are arrays to it."""
    compiled = jax.jit(function, static_argnums=3)

    def called(joint, *values, num_harmonics=4):
        leaves = jax.tree.map(jnp.asarray, joint)
        return compiled(leaves, *map(jnp.asarray, values), num_harmonics)

    return called


held, locked = arrays(force_at), arrays(tone_at_phase)


def size_and_force(joint, omega, y_peak, num_harmonics):
    force = force_at(joint, omega, y_peak, num_harmonics)
    return jnp.abs(force), force


sloped = arrays(jax.value_and_grad(size_and_force, 2, has_aux=True))  # by the amplitude


@pytest.mark.parametrize("joint", [PAPER, FOLDED])
@pytest.mark.parametrize("y_peak", [2e-4, 2e-3, 6e-3])
def test_one_harmonic_is_the_describing_function(joint, y_peak):
    """The rest is the linear oscillator. Tolerance: that of the quadrature."""
    omega = 0.97 * OMEGA_N
    linear = joint.k - omega**2 + 2j * joint.zeta * OMEGA_N * omega
    expected = (linear + describing_function(joint, y_peak)) * y_peak
    assert complex(held(joint, omega, y_peak, num_harmonics=1)) == pytest.approx(expected, rel=1e-9)


@pytest.mark.slow  # the first case compiles for all
@pytest.mark.parametrize("phase", [-np.pi / 2, -np.pi / 3, -2.5])
def test_the_frequency_of_one_harmonic_is_in_closed_form(phase):
    """Its quadratic equation, solved by NumPy."""
    y_peak = 3e-3
    z = describing_function(PAPER, y_peak)
    s, c = np.sin(phase), np.cos(phase)
    square = [-s, 2 * PAPER.zeta * OMEGA_N * c, s * (PAPER.k + z.real) + c * z.imag]
    omega = max(np.roots(square).real)
    found, force = map(float, locked(PAPER, y_peak, phase, num_harmonics=1))
    assert found == pytest.approx(omega, rel=1e-10)
    lost = 2 * PAPER.zeta * OMEGA_N * omega + z.imag
    assert force == pytest.approx(-lost * y_peak / s, rel=1e-8)


def motion_of(joint, omega, amplitude, start):
    """Fundamental of the periodic motion near a start, stable or not, by SciPy's integrator.

    Odd motions: half a period turns the state over. Its steps end where v or z passes zero, so that
    the law's kinks cost no accuracy.
    """

    def rates(t, state):
        y, v, z = state
        bend = joint.gamma * abs(v) * z + joint.delta * v * abs(z)
        force = amplitude * np.cos(omega * t)
        return [v, force - 2 * joint.zeta * OMEGA_N * v - joint.k * y - z, joint.alpha * v - bend]

    half = np.pi / omega
    options = dict(method="DOP853", rtol=1e-10, atol=1e-13, max_step=half / 60)

    def turned(state):
        return solve_ivp(rates, (0, half), state, **options).y[:, -1] + state

    scale = np.array([1.0, omega, joint.alpha])
    solved = root(lambda x: turned(x * scale) / scale, start / scale, tol=1e-9)
    assert np.linalg.norm(solved.fun) < 1e-8 * np.linalg.norm(solved.x)
    theta = np.pi * np.arange(400) / 400
    path = solve_ivp(rates, (0, half), solved.x * scale, t_eval=theta / omega, **options)
    return 2 * np.mean(path.y[0] * np.exp(-1j * theta))


def start_of(joint, omega, y_peak, phase):
    """State at t = 0 of the first harmonic alone."""
    z = describing_function(joint, y_peak)
    y = y_peak * np.exp(1j * phase)
    return np.array([y.real, (1j * omega * y).real, (z * y).real])


@pytest.mark.slow  # the first case compiles for all
@pytest.mark.parametrize(("y_peak", "phase"), [(5e-4, PHASE), (6e-3, PHASE), (3e-3, -np.pi / 3)])
def test_a_locked_tone_is_the_motion_of_the_equation(y_peak, phase):
    """Tolerance: a hundredth of the noise of such tests; four harmonics leave 1e-6."""
    omega, amplitude = map(float, locked(PAPER, y_peak, phase))
    moved = motion_of(PAPER, omega, amplitude, start_of(PAPER, omega, y_peak, phase))
    assert abs(moved) == pytest.approx(y_peak, rel=2e-5)
    assert np.angle(moved) == pytest.approx(phase, abs=2e-5)


@pytest.mark.slow  # the first case compiles for all
@pytest.mark.parametrize("y_peak", [1e-3, 2.2e-3, 4e-3])
def test_a_force_holds_every_branch_of_an_s_curve(y_peak):
    """The middle amplitude lies between the folds, where the force falls as the motion grows."""
    omega = 2 * np.pi * 18.2
    (_, force), slope = sloped(FOLDED, omega, y_peak)
    force = complex(force)
    assert (float(slope) < 0) == (y_peak == 2.2e-3)
    phase = -np.angle(force)
    moved = motion_of(FOLDED, omega, abs(force), start_of(FOLDED, omega, y_peak, phase))
    assert abs(moved) == pytest.approx(y_peak, rel=1e-4)
    assert np.angle(moved) == pytest.approx(phase, abs=1e-4)
