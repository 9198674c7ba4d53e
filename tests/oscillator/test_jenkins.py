"""Jenkins sliders: golden numbers, SciPy located at its events, and the doors."""

import itertools
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from known_laws import compiled
from scipy.integrate import solve_ivp
from tiers import represented_by

import jbw
from jbw.oscillator.laws.jenkins import Jenkins

GOLD = json.loads((Path(__file__).parents[1] / "golden_laws.json").read_text())
RULES = GOLD["conventions"]
TIME = np.arange(RULES["N"]) / RULES["fs"]
INPUT = (
    RULES["A"]
    * np.sin(2 * np.pi * 1.9 * TIME)
    * (np.sin(2 * np.pi * 17 * TIME) + 0.6 * np.sin(2 * np.pi * 41 * TIME + 0.7))
)


def joint(name):
    law = Jenkins(GOLD[name]["alpha"], GOLD[name]["phi"])
    return jbw.Oscillator(RULES["omega_n"], RULES["zeta"], (law,))


@compiled
def steady(law, y_peak):
    """Loop, harmonics exact and on a grid, force at the tip, and on the way down."""
    q = y_peak * jnp.array([1.0, 0.0], complex)
    exact, generic = (law.harmonics(q, turns) + law.stiffness() * q for turns in (2, 4))
    tip = law.force(y_peak, 1.0, law.at_tip(y_peak))
    angles = jnp.arccos(jnp.array([0.5, 0.0, -0.5]))
    return law.loop(y_peak), exact, generic, tip, law.force_over_period(q, angles, 2)


@compiled
def moved(law, y, memory, dy):
    memory = law.move(y, memory, dy)
    return memory, law.force(y + dy, dy, memory)


@pytest.mark.parametrize("name", ["jenkins", "jenkins_array"])
def test_the_steady_loop_is_golden(name):
    law = joint(name).laws[0]
    for row in GOLD[name]["steady"]:
        y_peak, kappa = row["Y"], complex(*row["kappa"])
        loop, harmonics, generic, tip, down = steady(law, y_peak)
        np.testing.assert_allclose(complex(loop.stiffness, loop.damping), kappa, rtol=1e-12)
        np.testing.assert_allclose(loop.energy(y_peak), row["energy"], rtol=1e-12, atol=1e-16)
        np.testing.assert_allclose(harmonics[0] / y_peak, kappa, rtol=1e-12)
        np.testing.assert_allclose(harmonics[1], complex(*row["F3"]), rtol=1e-9, atol=1e-14)
        # Of the 512-point grid that laws have without more knowledge, an error of second order.
        np.testing.assert_allclose(generic, harmonics, atol=1e-4 * abs(kappa) * y_peak)
        np.testing.assert_allclose(tip, row["F_tip"], rtol=1e-12)
        np.testing.assert_allclose(down, row["F_unloading"], rtol=1e-10, atol=1e-13)


@pytest.mark.parametrize("name", ["jenkins", "jenkins_array"])
def test_prescribed_motion_is_golden(name):
    law = joint(name).laws[0]
    memory, force, y = law.at_rest(), [], 0.0
    turns = GOLD["path"]["turning_points"]
    for before, after in itertools.pairwise(turns):
        for _ in range(2):
            dy = 0.5 * (after - before)
            memory, end = moved(law, y, memory, dy)
            y += dy
            force.append(float(end))
    np.testing.assert_allclose(force, GOLD[name]["path_force"], rtol=1e-12, atol=1e-14)


# Measured 2.8e-7, 8e-9 and 8e-10, the last being what the golden numbers are good to.
@pytest.mark.parametrize(("substeps", "error"), represented_by((4, 2e-9), (1, 6e-7), (2, 2e-8)))
@pytest.mark.parametrize("name", ["jenkins", "jenkins_array"])
def test_the_transient_is_golden(name, substeps, error):
    response = jbw.simulate(joint(name), INPUT, RULES["fs"], substeps=substeps)
    for letter, found in (("y", response.y), ("v", response.v), ("F", response.z)):
        golden = np.asarray(GOLD[name]["transient"][letter])
        misfit = np.max(np.abs(np.asarray(found)[RULES["indices"]] - golden))
        assert misfit <= error * np.max(np.abs(golden))


def located(omega_n, zeta, alpha, phi, u, fs):
    """One slider by SciPy's DOP853 from event to event: slip begins, motion turns."""
    y, v, x, out = 0.0, 0.0, 0.0, [(0.0, 0.0)]
    for n in range(len(u) - 1):
        t, mode = 0.0, 0.0
        while t < 1 / fs:
            heading = v if v else u[n] - omega_n**2 * y
            mode = np.sign(heading) if abs(x) >= phi and x * heading > 0 else 0.0

            def rate(s, state, mode=mode, n=n):
                push = u[n] + (u[n + 1] - u[n]) * s * fs
                inner = alpha * state[2] + (omega_n**2 - alpha) * state[0]
                a = push - 2 * zeta * omega_n * state[1] - inner
                return [state[1], a, 0.0 if mode else state[1]]

            events = [lambda s, state: state[1]] if mode else [
                lambda s, state: state[2] - phi, lambda s, state: state[2] + phi
            ]  # fmt: skip
            for event, side in zip(events, (-mode,) if mode else (1.0, -1.0), strict=True):
                event.terminal, event.direction = True, side
            run = solve_ivp(
                rate, (t, 1 / fs), [y, v, x], "DOP853", events=events, rtol=1e-12, atol=1e-15
            )
            t, (y, v, x) = run.t[-1], run.y[:, -1]
            if run.status == 1:
                x = np.clip(np.sign(x) * phi, -phi, phi)
                v = 0.0 if mode else v
        out.append((y, v))
    return np.array(out).T


def test_the_transient_is_that_of_an_event_located_reference():
    alpha, phi = 700.0, 1.1e-3
    u = INPUT[:160]
    y, v = located(RULES["omega_n"], RULES["zeta"], alpha, phi, u, RULES["fs"])
    law = jbw.Oscillator(RULES["omega_n"], RULES["zeta"], (Jenkins([alpha], [phi]),))
    found = jbw.simulate(law, u, RULES["fs"], substeps=4)
    np.testing.assert_allclose(found.y, y, atol=1e-8 * np.max(np.abs(y)))
    np.testing.assert_allclose(found.v, v, atol=1e-8 * np.max(np.abs(v)))


@pytest.mark.release  # the contract of laws takes it through each of them
def test_every_door_takes_the_array():
    array = jax.tree.map(lambda x: jnp.asarray(x, float), joint("jenkins_array"))
    fs, omega = RULES["fs"], 112.0
    sampled = jbw.simulate(array, 5 * np.cos(omega * TIME), fs, hold="band_limited", substeps=2)
    called = jbw.simulate(array, lambda t: 5 * jnp.cos(omega * t), fs, num_samples=TIME.size)
    np.testing.assert_allclose(sampled.y, called.y, atol=1e-6 * np.max(np.abs(called.y)))
    batch = jax.tree.map(lambda x: x * jnp.array([1.0, 1.01]), array)
    both = jbw.simulate(batch, INPUT, fs)
    np.testing.assert_allclose(both.y[0], jbw.simulate(array, INPUT, fs).y, rtol=1e-9, atol=1e-12)

    def last(joint):
        return jbw.simulate(joint, INPUT[:128], fs).y[-1]

    @jax.jit
    def both_modes(joint):
        return jax.grad(last)(joint), jax.jvp(last, (joint,), (joint,))[1]

    gradient, tangent = both_modes(array)
    products = jax.tree.map(lambda a, b: a * b, gradient, array)
    np.testing.assert_allclose(tangent, sum(jax.tree.leaves(products)), rtol=1e-9)

    curve = jbw.response_curve(array, 95.0, 125.0, 5.0, num_harmonics=4)
    at = jbw.steady_state(array, curve.omega[10], 5.0, 4)
    np.testing.assert_allclose(at, curve.harmonics[10], atol=1e-9 * abs(complex(at[0])))
    grid = jbw.frequency_response(array, jnp.array([100.0, 112.0]), jnp.array([1.0, 5.0]), 4)
    np.testing.assert_allclose(grid[1, 1], jbw.steady_state(array, 112.0, 5.0, 4), atol=1e-12)
    cycle = jbw.steady_cycle(array, grid, jnp.array([100.0, 112.0]))
    work = np.mean(np.asarray(cycle.z * cycle.v), axis=-1)[1, 1] * 2 * np.pi / 112.0
    damping = array.loop(np.max(np.abs(cycle.y[1, 1]))).energy(np.max(np.abs(cycle.y[1, 1])))
    np.testing.assert_allclose(work, damping, rtol=5e-3)
    assert np.all(np.asarray(jbw.steady_state(array, 112.0, 0.0)) == 0.0)
    slow = jbw.backbone(array, jnp.array([1e-4, 5e-3])).omega
    assert slow[0] == pytest.approx(RULES["omega_n"])
    assert slow[1] < slow[0]


def test_a_start_on_the_loop_stays_there():
    array = joint("jenkins_array")
    tip = array.at_tip(3e-3)
    response = jbw.simulate(array, np.zeros(4), RULES["fs"], initial=(3e-3, 0.0, tip))
    np.testing.assert_allclose(response.z[0], array.force(3e-3, 0.0, tip))
    with pytest.raises(jbw.ConfigError, match="a single z"):
        jbw.simulate(array, np.zeros(4), RULES["fs"], initial=(0.0, 0.0, 1.0))
