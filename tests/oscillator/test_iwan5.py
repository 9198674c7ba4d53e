"""Iwan's array whose sliders slide at less than they stick: golden paths and loops, and Iwan-4."""

import json
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest

import jbw
from jbw.errors import ModelError
from jbw.oscillator.laws.iwan import Iwan4
from jbw.oscillator.laws.iwan5 import Iwan5

GOLDEN = json.loads((Path(__file__).parents[1] / "golden_laws.json").read_text())
ROW, ABOUT = GOLDEN["iwan5_static_kinetic"], GOLDEN["conventions"]
STICKING = Iwan4.of_segalman(ROW["KT"], ROW["FS_static"], ROW["chi"], ROW["beta"])
COUNT = 8000
FS, OMEGA_N, ZETA = ABOUT["fs"], ABOUT["omega_n"], ABOUT["zeta"]
TIME = np.arange(ABOUT["N"]) / FS
INPUT = 12.0 * np.sin(2 * np.pi * 1.9 * TIME) * (
    np.sin(2 * np.pi * 17 * TIME) + 0.6 * np.sin(2 * np.pi * 41 * TIME + 0.7)
)  # fmt: skip


def law_of(theta=ROW["theta"], count=COUNT):
    return Iwan5(**STICKING.parameters(), iwan_theta=theta, count=count)


@jax.jit
def forces_along(law, turns):
    """Forces at the middle and the end of each straight move, from rest."""

    def onward(carry, end):
        y, memory = carry
        half = law.move(y, memory, (end - y) / 2)
        there = law.move((y + end) / 2, half, (end - y) / 2)
        return (end, there), (law.force(y, 0.0, half), law.force(end, 0.0, there))

    _, found = jax.lax.scan(onward, (turns[0], law.at_rest()), turns[1:])
    return jnp.stack(found, axis=1).ravel()


def test_forces_along_the_golden_path():
    found = forces_along(law_of(), jnp.asarray(GOLDEN["path"]["turning_points"]))
    golden = np.array(ROW["path_force"])
    # The golden one has 2e5 sliders, good to 1e-5.
    np.testing.assert_allclose(found, golden, atol=1e-4 * np.max(np.abs(golden)))


@pytest.mark.parametrize("row", ROW["steady"], ids=lambda row: f"{1e3 * row['Y']:g} mm")
def test_steady_loops_are_the_golden_ones(row):
    law, y_peak = law_of(), row["Y"]
    np.testing.assert_allclose(law.virgin(y_peak), row["F_virgin"], rtol=1e-12)
    unloading = zip((0.5 * y_peak, 0.0, -0.5 * y_peak), row["F_unloading"], strict=True)
    tip, size = law.at_tip(y_peak), abs(row["F_tip"])
    for y, force in ((y_peak, row["F_tip"]), *unloading, (-y_peak, row["F_end"])):
        np.testing.assert_allclose(law.unloading(y_peak, y_peak - y), force, atol=1e-12 * size)
        there = law.move(y_peak, tip, y - y_peak)  # by sliders
        assert float(law.force(y, 0.0, there)) == pytest.approx(force, abs=2e-4 * size)
    loop = law.loop(jnp.array([y_peak, 2 * y_peak]))
    found = np.pi * y_peak**2 * loop.damping[0]
    assert float(found) == pytest.approx(row["energy"], rel=1e-12)
    assert float(loop.stiffness[0]) == pytest.approx(row["kappa"][0], rel=1e-12)


def mp_loop(theta, chi, beta, y_peak):
    """Stiffness and damping over K_T at Y in units of phi_max, by the force on the way back."""
    theta, chi, beta, y_peak = (mp.mpf(x) for x in (theta, chi, beta, y_peak))
    spread, lump = 1 / (1 + beta), beta / (1 + beta)
    q = min(y_peak, mp.mpf(1))

    def moments(x):
        zeroth = spread * x ** (chi + 1)
        return zeroth, (chi + 1) / (chi + 2) * x * zeroth

    (zeroth_q, first_q), slip = moments(q), (1 + theta) * q

    def force(angle):
        d = y_peak * (1 - mp.cos(angle))
        zeroth_p, first_p = moments(min(d / (1 + theta), q))
        gone = -theta * first_p + theta * (first_q - first_p) - d * (zeroth_q - zeroth_p)
        last = y_peak - d if y_peak < 1 else theta - d if d < slip else -theta
        return gone + (y_peak - d) * (spread - zeroth_q) + lump * last

    with mp.workdps(30):
        edges = [0, mp.acos(max(1 - slip / y_peak, -1)), mp.pi]
        real, imaginary = (
            2 / (mp.pi * y_peak) * mp.quad(lambda a, f=f: force(a) * f(a), edges)
            for f in (mp.cos, lambda a: -mp.sin(a))
        )
    return float(real), float(imaginary)


@pytest.mark.parametrize("y_peak", [1e-6, 1e-3, 0.1, 0.9, 1.0, 1.1, 3.0, 100.0])
@pytest.mark.parametrize(
    ("theta", "chi", "beta"), [(0.8, -0.5, 0.6), (0.4, 0.7, 2.0), (1.0, -0.9, 0.0)]
)
def test_the_loop_is_that_of_mpmath(theta, chi, beta, y_peak):
    secant = 1e4 / ((1.0 + beta) * (2.0 + chi))
    law = Iwan5(1e4, secant * 0.5 ** (1.0 + chi), chi, beta, theta)
    assert float(law.sticking.phi_max) == pytest.approx(2e-3, rel=1e-13)
    loop = law.loop(float(law.sticking.phi_max) * y_peak)
    real, imaginary = mp_loop(theta, chi, beta, y_peak)
    # Rounding; far beyond macroslip the stiffness is a difference, 1e-3 of its parts.
    np.testing.assert_allclose(loop.stiffness, 1e4 * real, rtol=1e-12 if y_peak < 10 else 1e-11)
    np.testing.assert_allclose(loop.damping, 1e4 * imaginary, rtol=1e-12)


def test_the_loop_has_its_derivatives_where_friction_is_equal():
    parameters = {"iwan_stiffness": 1e4, "iwan_loss": 900.0, "iwan_chi": -0.4, "iwan_beta": 0.3}
    y_peak = 1e-3

    def loops(values):
        five = Iwan5(**values, iwan_theta=1.0).loop(y_peak)
        return five.stiffness, five.damping

    def of_four(values):
        four = Iwan4(**values).loop(y_peak)
        return four.stiffness, four.damping

    found, known = jax.jacfwd(loops)(parameters), jax.jacfwd(of_four)(parameters)
    for mine, theirs in zip(found, known, strict=True):
        for name, slope in theirs.items():
            scale = 1e4 / abs(parameters[name])
            np.testing.assert_allclose(mine[name], slope, rtol=1e-9, atol=1e-9 * scale)
    # By theta from the side on which it is defined, against mpmath.
    phi_max = float(Iwan4(**parameters).phi_max)
    h, ratio = 1e-7, y_peak / phi_max
    values = [mp_loop(1 - k * h, -0.4, 0.3, ratio) for k in (0, 1, 2)]
    slope = jax.jacfwd(lambda theta: Iwan5(**parameters, iwan_theta=theta).loop(y_peak))(1.0)
    for mine, (at, one, two) in zip(
        (slope.stiffness, slope.damping), zip(*values, strict=True), strict=True
    ):
        by_difference = 1e4 * (3 * at - 4 * one + two) / (2 * h)
        assert float(mine) == pytest.approx(by_difference, rel=1e-4)  # of the difference


def test_at_equal_friction_it_is_iwan_4():
    turns = jnp.asarray(GOLDEN["path"]["turning_points"])
    golden = np.array(GOLDEN["iwan4_a"]["path_force"])
    row = GOLDEN["iwan4_a"]
    law = Iwan4.of_segalman(row["KT"], row["FS"], row["chi"], row["beta"])
    found = forces_along(Iwan5(**law.parameters(), iwan_theta=1.0, count=1000), turns)
    np.testing.assert_allclose(found, golden, atol=1e-5 * np.max(np.abs(golden)))


@pytest.mark.parametrize(("theta", "forgets"), [(1.0, True), (0.8, False)])
def test_a_loop_within_a_loop_is_not_forgotten(theta, forgets):
    law = law_of(theta, count=1000)
    straight = forces_along(law, jnp.array([0.0, 1.5e-3, 1.6e-3]))[-1]
    turns = jnp.array([0.0, 1.5e-3, 0.3e-3, 1.5e-3, 1.6e-3])
    behind = forces_along(law, turns)[-1]
    # Sliders that stuck in the loop climb to their limits again before they slide.
    if forgets:
        assert float(behind) == pytest.approx(float(straight), rel=1e-12)
    else:
        assert float(behind) > 1.01 * float(straight)


def test_it_has_the_backbone_of_iwan_4_at_equal_friction():
    amplitude = jnp.array([0.0, 1e-4, 1e-3, 5e-3])
    same, other = (
        jbw.backbone(jbw.Oscillator(OMEGA_N, ZETA, (law,)), amplitude)
        for law in (law_of(theta=1.0), STICKING)
    )
    np.testing.assert_allclose(same.omega, other.omega, rtol=1e-12)
    np.testing.assert_allclose(same.zeta, other.zeta, rtol=1e-12)


# Twice to three times what was found; sliders of one stack say 1e-5, 2e-6 of y.
@pytest.mark.parametrize(("substeps", "most"), [(1, 8e-5), (4, 6e-6)])
def test_at_equal_friction_it_moves_as_the_golden_iwan_4(substeps, most):
    row = GOLDEN["iwan4_a"]
    sticking = Iwan4.of_segalman(row["KT"], row["FS"], row["chi"], row["beta"])
    law = Iwan5(**sticking.parameters(), iwan_theta=1.0, count=1000)
    found = jbw.simulate(jbw.Oscillator(OMEGA_N, ZETA, (law,)), INPUT, FS, substeps=substeps)
    for name, motion in (("y", found.y), ("v", found.v), ("F", found.z)):
        golden = np.array(row["transient"][name])
        error = np.max(np.abs(np.asarray(motion)[ABOUT["indices"]] - golden))
        assert error < most * np.max(np.abs(golden)), name


def leapfrog(law, u, parts=32):
    """Motion by half a move, the force, and half a move, so many times a sample; from rest."""
    stiffness, limit = (np.asarray(x) for x in law.array())
    beside, damping = OMEGA_N**2 - ROW["KT"], 2 * ZETA * OMEGA_N
    h = 1.0 / (FS * parts)
    stretch, direction = np.zeros_like(limit), np.zeros_like(limit)
    y = v = 0.0
    motion = [0.0]
    held = (
        np.linspace(u[:-1], u[1:], parts, endpoint=False, axis=1) + np.diff(u)[:, None] / parts / 2
    )
    for now in held:
        for force in now:
            for half in (0, 1):
                dy = 0.5 * h * v
                way = np.sign(dy)
                stretched = stretch + dy
                slides = (way != 0) & ((direction == way) | (way * stretched >= limit))
                stretch = np.where(slides, way * law.iwan_theta * limit, stretched)
                direction = np.where(slides, way, 0.0 if way else direction)
                y += dy
                if not half:
                    pull = force - beside * y - stiffness @ stretch
                    v = ((1 - damping * h / 2) * v + h * pull) / (1 + damping * h / 2)
        motion.append(y)
    return np.array(motion)


def test_it_moves_as_by_a_leapfrog():
    law, u = law_of(count=300), INPUT[:256]
    exact = leapfrog(law, u)
    joint = jbw.Oscillator(OMEGA_N, ZETA, (law,))
    for substeps, most in ((1, 1e-3), (8, 1e-4)):
        found = jbw.simulate(joint, u, FS, substeps=substeps).y
        assert np.max(np.abs(found - exact)) < most * np.max(np.abs(exact))


def test_a_batch_is_its_members_and_goes_on_from_a_memory():
    u = INPUT[:64]
    one, other = (jbw.Oscillator(OMEGA_N, ZETA, (law_of(theta, 50),)) for theta in (0.8, 0.5))
    both = jax.tree.map(lambda *x: jnp.array(x, float), one, other)
    found = jbw.simulate(both, u, FS)
    for lane, joint in zip(found.y, (one, other), strict=True):
        np.testing.assert_allclose(lane, jbw.simulate(joint, u, FS).y, rtol=1e-12, atol=1e-18)
    law = law_of(count=50)
    memory = law.move(0.0, law.at_rest(), 1e-3)
    start = jbw.simulate(one, u, FS, initial=(1e-3, 0.0, (memory,)))
    # Of fifty sliders one is a hundredth.
    assert float(start.z[0]) == pytest.approx(float(law.virgin(1e-3)), rel=1e-2)


def test_doors_refuse_what_is_not_solved_for():
    joint = jbw.Oscillator(OMEGA_N, ZETA, (law_of(count=50),))

    def moved(zeta):
        return jbw.simulate(replace(joint, zeta=zeta), INPUT[:16], FS).y[-1]

    with pytest.raises(ModelError, match="no derivatives in time"):
        jax.grad(moved)(ZETA)
    with pytest.raises(ModelError, match="periodic motion of the law `iwan5`"):
        jbw.simulate(joint, INPUT[:16], FS, periodic=True)
    with pytest.raises(ModelError, match="periodic motion of the law `iwan5`"):
        jbw.steady_state(joint, 1.0, OMEGA_N)
