"""The steady response against golden numbers, shooting in time, limits and energy balance."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jbw.errors import ConfigError, ModelError
from jbw.oscillator.oscillator import BoucWen
from jbw.oscillator.periodic import shooting
from jbw.oscillator.steady.cycle import steady_cycle, steady_state
from jbw.paper.kernels import h1

OMEGA_N = 2 * np.pi * 18.8
PAPER = BoucWen(OMEGA_N, 0.00444, 497.4, 340.21, 32.84)
NAMES = ("omega_n", "zeta", "alpha", "delta", "gamma")
# At a third of its natural frequency this joint's third harmonic turns the motion six times.
STRONG = BoucWen(OMEGA_N, 0.003, 3000.0, 340.0, 33.0)
STRONG_TONE = (0.33 * OMEGA_N, 10.0)


@pytest.fixture(scope="module")
def cases(golden):
    return golden["true_oscillator_steady"]["cases"]


def column(cases, *names):
    columns = [np.array([case[name] for case in cases]) for name in names]
    return columns[0] if len(columns) == 1 else columns


def batch(cases):
    joint = BoucWen(*column(cases, *NAMES))
    return joint, 2 * np.pi * column(cases, "f_hz"), column(cases, "A")


def golden_harmonics(cases):
    parts = np.stack(column(cases, "Y1", "Y3", "Y5"), axis=1)
    return parts[..., 0] + 1j * parts[..., 1]


def relative(found, wanted):
    return np.max(np.abs(found - wanted) / np.abs(wanted), axis=0)


@pytest.fixture(scope="module")
def resolved(cases):
    """All cases with as many harmonics as the golden numbers have."""
    return np.asarray(steady_state(*batch(cases), num_harmonics=32))


def test_golden_steady_state(cases, resolved):
    joint, omega, _ = batch(cases)
    harmonics = resolved
    # The golden file states 1e-9 or better; both sides are balances with 32 odd harmonics.
    assert np.all(relative(harmonics[:, :3], golden_harmonics(cases)) < 1e-11)
    cycle = steady_cycle(joint, harmonics, omega, num_points=8192)
    # The golden maxima come from 8192 samples.
    for name, found in (("ymax", cycle.y), ("vmax", cycle.v), ("Zmax", cycle.z)):
        assert np.all(relative(np.abs(found).max(axis=-1), column(cases, name)) < 1e-6)
    start = np.stack([cycle.y[:, 0], cycle.v[:, 0], cycle.z[:, 0]], axis=1)
    peaks = np.stack(column(cases, "ymax", "vmax", "Zmax"), axis=1)
    # The golden states come from shooting; 32 harmonics leave the tail n^-3 of v out.
    assert np.all(np.abs(start - column(cases, "state_at_t0")) < [1e-9, 1e-7, 1e-8] * peaks)


@pytest.mark.parametrize(
    ("num_harmonics", "bounds"),
    [
        (2, (9e-6, 4e-4)),
        pytest.param(4, (2e-6, 4e-6), marks=pytest.mark.slow),
        (8, (5e-8, 8e-8)),
    ],
)
def test_truncation_is_as_stated(cases, num_harmonics, bounds):
    harmonics = steady_state(*batch(cases), num_harmonics=num_harmonics)
    assert np.all(relative(harmonics[:, :2], golden_harmonics(cases)[:, :2]) < bounds)


@pytest.mark.parametrize("place", [3, 9])
@pytest.mark.slow
def test_agrees_with_shooting_in_time(cases, resolved, place):
    omega, amplitude = 2 * np.pi * cases[place]["f_hz"], cases[place]["A"]
    orbit = shooting(PAPER, omega, amplitude)
    # Of Y_1: what 32 harmonics leave out, and the integrator's error at the kinks (tolerance
    # 1e-12) over the damping.
    assert np.max(np.abs(orbit.harmonics - resolved[place, :8])) < 2e-10 * abs(resolved[place, 0])
    cycle = steady_cycle(PAPER, resolved[place], omega, num_points=256)
    assert orbit.initial[2] == pytest.approx(float(cycle.z[0]), rel=1e-7)
    assert np.all(np.abs(orbit.multipliers) < 1.0)


@pytest.mark.slow
def test_motion_that_turns_six_times_a_period():
    omega, amplitude = STRONG_TONE
    harmonics = steady_state(STRONG, omega, amplitude)
    orbit = shooting(STRONG, omega, amplitude)
    # Eight harmonics, and this joint softens six times as much as the paper's.
    assert np.max(np.abs(orbit.harmonics - harmonics)) < 1e-5 * np.abs(harmonics[0])
    cycle = steady_cycle(STRONG, harmonics, omega, num_points=2048, max_turns=10)
    assert np.sum(cycle.v * np.roll(cycle.v, 1) < 0.0) == 6
    assert orbit.initial[2] == pytest.approx(float(cycle.z[0]), rel=1e-4)
    check_energy(STRONG, omega, amplitude, harmonics, cycle)
    # Under jit there is no second try, and no wrong number either.
    assert np.all(
        np.isnan(jax.jit(partial(steady_state, num_harmonics=3))(STRONG, omega, amplitude))
    )


def check_energy(joint, omega, amplitude, harmonics, cycle):
    """Work of the force over a period = what the damper and the loop dissipate."""
    n = 2 * np.arange(harmonics.shape[-1]) + 1
    work = -np.pi * amplitude * harmonics[0].imag
    damper = 2 * joint.zeta * joint.omega_n * omega * np.pi * np.sum(np.abs(n * harmonics) ** 2)
    loop = np.mean(cycle.z * cycle.v) * 2 * np.pi / omega
    # The mean over a uniform grid sees the kinks of z at the turning points, of order N^-2.
    assert work == pytest.approx(float(damper + loop), rel=1e-5)


def test_energy_balance():
    omega, amplitude = 2 * np.pi * 18.5, 2.0
    harmonics = steady_state(PAPER, omega, amplitude)
    cycle = steady_cycle(PAPER, harmonics, omega, num_points=2048)
    check_energy(PAPER, omega, amplitude, harmonics, cycle)


def test_cycle_satisfies_the_equation_of_motion(cases, resolved):
    omega, amplitude = 2 * np.pi * cases[2]["f_hz"], cases[2]["A"]
    theta, y, v, a, z = steady_cycle(PAPER, resolved[2], omega)
    force = a + 2 * PAPER.zeta * PAPER.omega_n * v + PAPER.k * y + z
    # z beyond the 63rd harmonic, which falls as n^-2 from its kinks, is unbalanced.
    assert np.max(np.abs(force - amplitude * np.cos(theta))) < 1e-6 * amplitude


def test_without_hysteresis_it_is_the_linear_oscillator():
    omega = OMEGA_N * np.array([0.3, 0.99, 1.0, 2.0])
    linear = BoucWen(OMEGA_N, 0.00444, 497.4, 0.0, 0.0)
    for joint, amplitude in ((linear, 3.0), (PAPER, 1e-9)):
        harmonics = steady_state(joint, omega, amplitude)
        # Roundoff over the damping; at 1e-9 N/kg the joint softens by 1e-8 over the damping.
        wanted = amplitude * h1(omega, OMEGA_N, 0.00444)
        assert np.all(relative(harmonics[:, 0], wanted) < (1e-12 if joint is linear else 1e-7))
        assert np.all(np.abs(harmonics[:, 1:]) < 1e-7 * np.abs(harmonics[:, :1]))
    assert np.all(steady_state(PAPER, omega, 0.0) == 0.0)


PROPERTY = settings(deadline=None, max_examples=25, derandomize=True)
SCALE = st.floats(0.05, 20.0)
TONE = {"part": st.sampled_from([0.27, 0.33, 0.8, 1.1]), "load": st.floats(0.5, 12.0)}
STEADY = partial(steady_state, num_harmonics=8)


@PROPERTY
@given(s=SCALE, **TONE)
def test_amplitude_scales_out(s, part, load):
    one = STEADY(PAPER, part * OMEGA_N, load)
    softer = BoucWen(OMEGA_N, 0.00444, 497.4, 340.21 / s, 32.84 / s)
    # Newton ends within 1e-11 of the balance; harmonics far below the first share its error.
    other = STEADY(softer, part * OMEGA_N, s * load)
    np.testing.assert_allclose(other, s * one, rtol=1e-9, atol=1e-10 * abs(s * one[0]))


@PROPERTY
@given(c=SCALE, **TONE)
def test_time_scales_out(c, part, load):
    one = STEADY(PAPER, part * OMEGA_N, load)
    slower = BoucWen(OMEGA_N / c, 0.00444, 497.4 / c**2, 340.21, 32.84)
    other = STEADY(slower, part * OMEGA_N / c, load / c**2)
    np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-10 * abs(one[0]))


@PROPERTY
@given(alpha=st.floats(1.0, 1e4), **TONE)
def test_a_joint_without_hysteresis_is_linear_for_every_alpha(alpha, part, load):
    joint = BoucWen(OMEGA_N, 0.00444, alpha, 0.0, 0.0)
    found = STEADY(joint, part * OMEGA_N, load)
    np.testing.assert_allclose(found[0], load * h1(part * OMEGA_N, OMEGA_N, 0.00444), rtol=1e-10)
    assert np.abs(found[1:]).max() < 1e-12 * abs(found[0])


@pytest.mark.slow
def test_derivatives_forward_reverse_and_by_differences():
    point = jnp.array([OMEGA_N, 0.00444, 497.4, 340.21, 32.84, 2 * np.pi * 18.5, 2.0])

    @jax.jit
    def parts(p):
        harmonics = steady_state(BoucWen(*p[:5]), p[5], p[6])
        return jnp.concatenate([harmonics.real, harmonics.imag])

    forward = np.asarray(jax.jit(jax.jacfwd(parts))(point))
    reverse = np.asarray(jax.jit(jax.jacrev(parts))(point))
    np.testing.assert_allclose(
        forward / np.abs(forward).max(0), reverse / np.abs(forward).max(0), atol=1e-12
    )
    steps = 1e-4 * np.diag(point)
    weights = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))
    differences = np.stack(
        [
            sum(w * (parts(point + m * e) - parts(point - m * e)) for m, w in weights) / e.sum()
            for e in steps
        ],
        axis=1,
    )
    # Sixth-order differences; the resonance is narrow against 1e-4 of omega: (1e-4/zeta)^6 = 1e-10.
    assert np.all(np.abs(forward - differences).max(0) < 1e-8 * np.abs(forward).max(0))


@pytest.mark.slow
def test_broadcasts_joints_frequencies_and_levels():
    joints = BoucWen(OMEGA_N, np.array([0.004, 0.005])[:, None, None], 497.4, 340.21, 32.84)
    omega, amplitude = 2 * np.pi * np.array([5.0, 18.7, 20.0]), np.array([0.5, 2.0])[:, None]
    harmonics = steady_state(joints, omega, amplitude)
    assert harmonics.shape == (2, 2, 3, 8)
    one = BoucWen(OMEGA_N, 0.005, 497.4, 340.21, 32.84)
    single = steady_state(one, float(omega[1]), 2.0)
    assert single.shape == (8,)
    np.testing.assert_allclose(harmonics[1, 1, 1], single, rtol=1e-12)
    cycle = steady_cycle(joints, harmonics, omega, num_points=16)
    assert cycle.z.shape == (2, 2, 3, 16)
    assert cycle.theta.shape == (16,)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"omega": 0.0}, "`omega` must be greater than 0"),
        ({"amplitude": -1.0}, "`amplitude` must be at least 0"),
        ({"amplitude": np.nan}, "`amplitude` must be finite"),
        ({"num_harmonics": 0}, "`num_harmonics`"),
        ({"max_turns": 3}, "`max_turns`"),
        ({"joint": BoucWen(OMEGA_N, 0.004, 497.4, 340.0, 32.0, nu=2.0)}, "`nu` must be 1"),
    ],
)
def test_refuses_what_cannot_be_meant(change, words):
    arguments = {"joint": PAPER, "omega": 30.0, "amplitude": 1.0} | change
    with pytest.raises((ConfigError, ModelError), match=words):
        steady_state(**arguments)


def test_refuses_float32():
    with jax.enable_x64(False), pytest.raises(ConfigError, match="float64"):
        steady_state(PAPER, 30.0, 1.0)


def test_says_which_tone_did_not_converge(monkeypatch):
    monkeypatch.setattr("jbw.oscillator.steady.cycle.MANY_TURNS", 2)
    omega, amplitude = STRONG_TONE
    with pytest.raises(ModelError, match=r"1 of 2 tones.*omega = 38\.98.*amplitude = 10.*6 turn"):
        steady_state(STRONG, np.array([20.0, omega]), amplitude)


@pytest.mark.release  # test_adjoint.py has those of a record
def test_second_derivatives_of_the_steady_state():
    point = jnp.array([497.4, 340.21, 32.84])

    def y_3(p):
        joint = BoucWen(OMEGA_N, 0.00444, *p)
        return steady_state(joint, 2 * np.pi * 18.5, 2.0)[1].real

    program = jax.jit(lambda p: (jax.grad(y_3)(p), jax.hessian(y_3)(p)))
    hessian = np.asarray(program(point)[1])

    def gradient(p):
        return np.asarray(program(p)[0])

    steps = 1e-4 * np.diag(point)
    weights = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))
    differences = np.stack(
        [
            sum(w * (gradient(point + m * e) - gradient(point - m * e)) for m, w in weights)
            / e.sum()
            for e in steps
        ]
    )
    # Differences of gradients: roundoff 1e-14 over the step 1e-4, and some digits of the gradient.
    np.testing.assert_allclose(hessian, differences, rtol=1e-7)
