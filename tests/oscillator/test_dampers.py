"""Forces of the velocity itself: closed forms, quadrature and SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy_motion import scipy_motion

import jbw
from jbw.oscillator.laws.dampers import CubicDamping, QuadraticDamping
from jbw.oscillator.laws.springs import Cubic
from jbw.oscillator.oscillator import Oscillator

OMEGA_N, ZETA, FS = 118.0, 0.002, 1024.0
TIME = np.arange(256) / FS
INPUT = 8.0 * np.sin(2 * np.pi * 17 * TIME) * np.sin(2 * np.pi * 3 * TIME)
LAWS = {"quadratic": QuadraticDamping(6.0), "cubic": CubicDamping(20.0)}
FORCES = {"quadratic": lambda v: 6.0 * v * abs(v), "cubic": lambda v: 20.0 * v**3}


def oscillator(*laws):
    return jax.tree.map(lambda x: jnp.asarray(x, float), Oscillator(OMEGA_N, ZETA, laws))


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("hold", ["first", "zero"])
def test_the_motion_is_that_of_scipy(name, hold):
    law = LAWS[name]
    if hold == "first":
        y, v, _ = scipy_motion(
            lambda y, v, m: FORCES[name](v), OMEGA_N**2, 2 * ZETA * OMEGA_N, INPUT, FS
        )
    else:
        state, found = np.zeros(2), []
        for push in INPUT:
            found.append(state)

            def field(t, x, push=push):
                a = push - 2 * ZETA * OMEGA_N * x[1] - OMEGA_N**2 * x[0] - FORCES[name](x[1])
                return [x[1], a]

            run = solve_ivp(field, (0, 1 / FS), state, "DOP853", rtol=1e-11, atol=1e-15)
            state = run.y[:, -1]
        y, v = np.array(found).T
    for substeps, tolerance in ((1, 3e-7), (4, 2e-9)):
        found = jbw.simulate(oscillator(law), INPUT, FS, substeps=substeps, hold=hold)
        for wanted, x in ((y, found.y), (v, found.v)):
            np.testing.assert_allclose(x, wanted, atol=tolerance * np.max(np.abs(wanted)))


@pytest.mark.parametrize("name", LAWS)
def test_harmonics_and_losses_are_those_of_quadrature(name):
    law, y_peak, omega = LAWS[name], 3e-3, 105.0
    first, third = (
        1j / np.pi * quad(
            lambda theta, n=n: FORCES[name](y_peak * omega * np.sin(theta)) * np.sin(n * theta),
            0.0, 2 * np.pi, points=[np.pi], epsabs=1e-14, epsrel=1e-12,
        )[0]
        for n in (1, 3)
    )  # fmt: skip
    np.testing.assert_allclose(1j * law.loop(y_peak, omega).damping * y_peak, first, rtol=1e-12)
    turn = np.exp(0.7j)
    q = jnp.array([y_peak * turn, 0.0])
    for max_turns, tolerance in ((2, 1e-12), (4, 1e-5)):
        found = law.harmonics(q, max_turns, omega)
        wanted = [first * turn, third * turn**3]
        np.testing.assert_allclose(found, wanted, atol=tolerance * abs(first))


@pytest.mark.parametrize("name", LAWS)
def test_a_free_decay_is_the_closed_form(name):
    r"""To first order $\dot A = -\zeta\omega A - \mathrm{Im}\,\kappa A/(2\omega)$."""
    law, start = LAWS[name], {"quadratic": 4e-4, "cubic": 1.2e-3}[name]
    joint = Oscillator(OMEGA_N, 0.0, (jax.tree.map(lambda x: 3.0 * x, law),))
    found = jbw.simulate(joint, np.zeros(1024), FS, initial=(start, 0.0), substeps=2)
    size = np.hypot(found.y, found.v / OMEGA_N)
    power = {"quadratic": 1, "cubic": 2}[name]
    rate = 3.0 * float(law.loop(1.0, OMEGA_N).damping) / (2 * OMEGA_N)
    wanted = (start**-power + power * rate * TIME_LONG) ** (-1 / power)
    assert wanted[-1] < 0.9 * start
    np.testing.assert_allclose(size, wanted, rtol=5e-3)


TIME_LONG = np.arange(1024) / FS


def test_the_backbone_holds_the_damper_at_its_own_frequency():
    cubic, damper = Cubic(2e8), CubicDamping(20.0)
    found = jbw.backbone(oscillator(cubic, damper), 3e-3)
    square = OMEGA_N**2 + 0.75 * 2e8 * 3e-3**2
    np.testing.assert_allclose(found.omega**2, square, rtol=1e-14)
    added = 0.75 * 20.0 * 3e-3**2 * np.sqrt(square) / 2
    np.testing.assert_allclose(found.zeta, ZETA * OMEGA_N / np.sqrt(square) + added, rtol=1e-13)


def test_a_slow_loop_feels_no_damper():
    y = jnp.linspace(0.0, 1e-3, 50)
    np.testing.assert_allclose(oscillator(LAWS["cubic"]).force_along(y), OMEGA_N**2 * y, rtol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_the_steady_state_is_that_of_a_periodic_record(name):
    """The frequency enters the balance, in whatever units it is solved."""
    joint, omega = oscillator(LAWS[name]), 112.0
    phase = 2 * np.pi * np.arange(64) / 64
    record = jbw.simulate(
        joint, 4.0 * np.cos(phase), 64 * omega / (2 * np.pi),
        hold="band_limited", periodic=True, substeps=8,
    )  # fmt: skip
    first = 2 * np.mean(np.asarray(record.y) * np.exp(-1j * phase))
    harmonics = jbw.steady_state(joint, omega, 4.0, 8)
    assert abs(first / complex(harmonics[0]) - 1) < 1e-7
