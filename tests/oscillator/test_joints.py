"""Several joints of a structure in time: golden motions, works, gradients, identities, refusals.

The golden numbers come from an integrator that locates every turn, slip and zero of a force.
"""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_structure import two_modes

import jbw
from jbw.errors import ConfigError, ModelError
from jbw.oscillator.laws import law_named
from jbw.oscillator.laws.iwan import Iwan4

GOLDEN = json.loads((Path(__file__).parents[1] / "golden_assemblies.json").read_text())
CASES = GOLDEN["transient"]["cases"]
FS = GOLDEN["transient"]["fs"]
BOUC_WEN = {"alpha": 497.4, "delta": 340.2, "gamma": 32.8}


def law_of(joint):
    """The law of a golden joint."""
    if joint["law"] == "bouc_wen":
        return jbw.laws.BoucWenLaw(joint["alpha"], joint["delta"], joint["gamma"])
    if joint["law"] == "jenkins":
        return law_named("jenkins").build({"stiffness_1": joint["alpha"], "slip_1": joint["phi"]})
    return Iwan4.of_segalman(joint["K_T"], joint["F_S"], joint["chi"], joint["beta"])


def structure_of(system):
    omega, zeta, h, b = (np.array(system[name]) for name in ("omega", "zeta", "H", "b"))
    laws = tuple((law_of(joint),) for joint in system["joints"])
    return jbw.Structure(omega, zeta, h, b=b, c=np.ones(len(omega)), laws=laws)


def input_of(case):
    t, given = np.arange(GOLDEN["transient"]["num_samples"]) / FS, case["input"]
    phase = given["f0"] * t + given["rate"] * t**2 / 2
    return given["A"] * np.sin(2 * np.pi * phase + given["phase"])


@cache
def motion(place, substeps):
    case = CASES[place]
    return jbw.simulate(structure_of(case["system"]), input_of(case), FS, substeps=substeps)


def error_of(place, substeps):
    """Worst error of q at the golden samples over the largest."""
    q = np.asarray(motion(place, substeps).q)
    expected = np.transpose(CASES[place]["q"])
    return np.max(np.abs(q[:, CASES[place]["index"]] - expected)) / np.max(np.abs(q))


@pytest.mark.slow
@pytest.mark.parametrize("place", range(len(CASES)), ids=[case["name"] for case in CASES])
def test_golden_motions_the_order_and_the_works(place):
    """Bounds of the step at 0.8 rad a step of the highest mode, and at a half and a quarter of it.

    Order 4 with kinks of both joints in one step; slips of a slider leave 3.4 of it.
    """
    case = CASES[place]
    once, twice, four = (error_of(place, substeps) for substeps in (1, 2, 4))
    assert once < 1e-5
    assert twice < 1e-6
    assert four < 1e-7
    if {joint["law"] for joint in case["system"]["joints"]} == {"bouc_wen"}:
        assert np.log(once / four) / np.log(4.0) > 3.8
    assert not any(float(motion(place, substeps).guesses) for substeps in (1, 2, 4))
    moved = motion(place, 4)
    np.testing.assert_allclose(moved.work, case["work_of_r"], rtol=1e-6)
    for found, expected in ((moved.x, case["x"]), (moved.r, case["r"])):
        # As q, and the force by a slope of order one.
        worst = np.max(np.abs(np.asarray(found)[:, case["index"]] - np.transpose(expected)))
        assert worst < 1e-6 * np.max(np.abs(found))


@pytest.mark.slow
def test_the_input_pays_for_the_losses_and_for_what_is_stored():
    r"""u sum b q' = viscous losses + works of the joints + energy of the modes, along one record.

    The works at four steps a sample; the other integrals by Simpson's rule over sixteenths of a
    sample, between which the input is the same straight line.
    """
    structure, every = structure_of(CASES[0]["system"]), 16
    coarse = input_of(CASES[0])[:257]
    place = np.arange(256 * every + 1) / every
    u = np.interp(place, np.arange(257), coarse)
    work = jbw.simulate(structure, coarse, FS, substeps=4).work
    moved = jbw.simulate(structure, u, every * FS)
    dq, omega = np.asarray(moved.dq), structure.omega_n

    def integral(f):
        return (f[0] + f[-1] + 4.0 * f[1::2].sum() + 2.0 * f[2:-1:2].sum()) / (3.0 * every * FS)

    paid = integral(u * (structure.b @ dq))
    viscous = integral((2.0 * structure.zeta * omega) @ dq**2)
    stored = 0.5 * np.sum(dq[:, -1] ** 2 + (omega * np.asarray(moved.q)[:, -1]) ** 2)
    assert abs(paid - viscous - stored - float(jnp.sum(work))) < 1e-7 * paid


def parameters_of(case):
    """Numbers of every joint's law, of the second frequency and of H_21."""
    system = case["system"]
    laws = [{k: jnp.asarray(v) for k, v in j.items() if k != "law"} for j in system["joints"]]
    return laws, jnp.asarray(system["omega"][1]), jnp.asarray(system["H"][1][0])


def half_square(case, substeps, laws, omega_2, h_21):
    system = case["system"]
    h = jnp.asarray(system["H"]).at[1, 0].set(h_21)
    omega = jnp.asarray(system["omega"]).at[1].set(omega_2)
    named = ({"law": j["law"], **law} for j, law in zip(system["joints"], laws, strict=True))
    structure = replace(
        structure_of(system), omega_n=omega, h=h, laws=tuple((law_of(law),) for law in named)
    )
    return 0.5 * jnp.sum(jbw.simulate(structure, input_of(case), FS, substeps=substeps).v ** 2)


@pytest.mark.slow
@pytest.mark.parametrize("place", range(len(CASES)), ids=[case["name"] for case in CASES])
def test_golden_gradients_at_four_steps_a_sample(place):
    """By every law's parameters, and by the two numbers of modes; P follows H."""
    case = CASES[place]
    total = jax.jit(jax.value_and_grad(lambda at: half_square(case, 4, *at)))
    value, (laws, omega_2, h_21) = total(parameters_of(case))
    assert float(value) == pytest.approx(case["J"], rel=1e-7)
    smooth = all(joint["law"] == "bouc_wen" for joint in case["system"]["joints"])
    rel = 1e-5 if smooth else 1e-4
    for found, golden in zip(laws, case["grad_J"], strict=True):
        for name, slope in found.items():
            assert float(slope) == pytest.approx(golden[name], rel=rel), name
    assert float(h_21) == pytest.approx(case["grad_J_H_21"]["value"], rel=rel)
    assert float(omega_2) == pytest.approx(case["grad_J_omega_2"], rel=rel)


def chirped(num=256, amplitude=6.0):
    t = np.arange(num) / FS
    return amplitude * np.sin(2 * np.pi * (5.0 * t + 60.0 * t**2))


def alike(found, expected, rel):
    assert np.max(np.abs(found - expected)) < rel * np.max(np.abs(expected))


def pair():
    """Two modes with two unlike joints."""
    one = two_modes()
    h = np.array([one.h, [0.7, 1.3]])
    laws = ((one.laws[0],), (jbw.laws.BoucWenLaw(900.0, 500.0, 120.0),))
    return replace(one, h=h, p=None, c=np.eye(2), laws=laws)


@pytest.mark.slow
def test_one_row_is_one_joint():
    """The same numbers with and without an axis of joints."""
    one = two_modes()
    row = replace(one, h=one.h[None], p=one.p[:, None], laws=(one.laws,))
    alone, rowed = (jbw.simulate(s, chirped(), FS) for s in (one, row))
    for name in ("q", "dq", "y", "a"):
        alike(getattr(rowed, name), getattr(alone, name), 1e-13)
    for name in ("x", "z", "r", "work"):
        alike(getattr(rowed, name)[0], getattr(alone, name), 1e-13)
    assert alone.x.shape == (256,)
    assert rowed.x.shape == (1, 256)
    assert alone.work.shape == ()


@pytest.mark.slow
def test_gradients_of_one_row_are_those_of_one_joint():
    """By every number of modes and law; the same sums, whose order may differ."""

    def half_square(h, p, laws):
        moved = jbw.simulate(replace(two_modes(), h=h, p=p, laws=laws), chirped(), FS)
        return 0.5 * jnp.sum(moved.v**2)

    slopes = jax.jit(jax.grad(half_square, (0, 1, 2)))
    one = jax.tree.map(jnp.asarray, two_modes())
    h, p, (law,) = slopes(one.h, one.p, one.laws)
    h_row, p_row, ((law_row,),) = slopes(one.h[None], one.p[:, None], (one.laws,))
    alike(h_row[0], h, 1e-13)
    alike(p_row[:, 0], p, 1e-13)
    for found, expected in zip(jax.tree.leaves(law_row), jax.tree.leaves(law), strict=True):
        alike(found, expected, 1e-13)


@pytest.mark.slow
def test_two_joints_that_share_one_law_are_one_joint():
    one = two_modes()
    whole = jbw.laws.BoucWenLaw(**BOUC_WEN)
    half = replace(whole, alpha=whole.alpha / 2)
    both = replace(
        one, h=np.stack([one.h] * 2), p=np.stack([one.p] * 2, 1), laws=((half,), (half,))
    )
    alone, split = (jbw.simulate(s, chirped(), FS) for s in (one, both))
    alike(split.q, alone.q, 1e-12)
    alike(jnp.sum(split.r, 0), alone.r, 1e-12)
    assert float(jnp.sum(split.work)) == pytest.approx(float(alone.work), rel=1e-12)


def test_joints_each_on_a_mode_of_its_own_are_oscillators():
    two = replace(pair(), h=np.eye(2))
    found = jbw.simulate(two, chirped(), FS)
    for i in range(2):
        alone = jbw.Oscillator(two.omega_n[i], two.zeta[i], two.laws[i])
        expected = jbw.simulate(alone, two.b[i] * chirped(), FS)
        # Round-off of two orders of summation, as of one joint.
        alike(found.y[i], expected.y, 1e-13)
        alike(found.z[i], expected.z, 1e-12)


def test_outputs_do_not_know_the_gauge():
    """A row of h and a column of p by 1.2 with the law rescaled, and all of a mode by 1.2."""
    given, s, t = pair(), np.array([1.0, 1.2]), np.array([1.0, 1.2])
    law = given.laws[1][0]
    scaled = jbw.laws.BoucWenLaw(law.alpha / 1.2**2, law.delta / 1.2, law.gamma / 1.2)
    other = replace(
        given, h=s[:, None] * given.h / t, p=t[:, None] * given.h.T * s, b=given.b * t,
        c=given.c / t, laws=(given.laws[0], (scaled,)),
    )  # fmt: skip
    one, two = (jbw.simulate(x, chirped(), FS) for x in (given, other))
    alike(two.y, one.y, 1e-12)


@pytest.mark.slow
def test_records_beside_each_other_keep_the_axis_of_joints():
    u = np.stack([chirped(128), 2.0 * chirped(128)])
    both, alone = (jbw.simulate(pair(), x, FS) for x in (u, u[1]))
    assert both.x.shape == (2, 2, 128)
    assert both.work.shape == (2, 2)
    np.testing.assert_allclose(both.x[1], alone.x, rtol=0, atol=1e-14)


@pytest.mark.slow
def test_a_stock_solver_agrees_with_the_step():
    """Motion, forces and works at Dopri8's tolerance and the step's order at eight a sample."""
    drag = law_named("quadratic_damping").build({"quadratic_damping": 1e-12})
    stepped = pair()
    damped = replace(stepped, laws=(stepped.laws[0], (*stepped.laws[1], drag)))
    ours, stock = (jbw.simulate(s, chirped(256), FS, substeps=8) for s in (stepped, damped))
    for name in ("q", "x", "r", "work"):
        alike(getattr(stock, name), getattr(ours, name), 1e-7)


@pytest.mark.slow
def test_a_period_ends_where_it_starts_and_its_works_are_losses():
    """The works over a period are what the joints lose; the input pays for them and for zeta."""
    t = np.arange(256) / FS
    u = 3.0 * np.sin(2 * np.pi * 20.0 * t)
    options = dict(periodic=True, hold="band_limited", substeps=4)
    moved = jbw.simulate(pair(), u, FS, **options)
    assert float(moved.residual) < 1e-10
    assert np.all(np.asarray(moved.work) > 0.0)
    s, dq = pair(), np.asarray(moved.dq)
    # The mean of a smooth periodic function is that of its samples.
    paid = np.mean(u * (s.b @ dq)) * 256 / FS
    viscous = np.mean((2.0 * s.zeta * s.omega_n) @ dq**2) * 256 / FS
    # Of kinks at 51 samples a period the mean of the samples knows less.
    assert float(jnp.sum(moved.work)) == pytest.approx(paid - viscous, rel=1e-5)


@pytest.mark.slow
def test_a_start_holds_the_memories_of_every_joint():
    """Halves of a record joined by the state between."""
    whole = jbw.simulate(pair(), chirped(), FS)
    start = (whole.q[:, 128], whole.dq[:, 128], tuple((z,) for z in whole.z[:, 128]))
    again = jbw.simulate(pair(), chirped()[128:], FS, initial=start)
    alike(again.x, whole.x[:, 128:], 1e-12)
    with pytest.raises(ConfigError, match="internal states of the laws"):
        jbw.simulate(pair(), chirped(64), FS, initial=(0.0, 0.0, (0.1, 0.2)))


@pytest.mark.slow
def test_a_rigid_mode_that_moves_no_joint_moves_the_output():
    """Under a constant push x = b u t^2 / 2 beside what the other modes do."""
    free = pair()
    wide = jbw.Structure(
        np.append(free.omega_n, 0.0), np.append(free.zeta, 0.0),
        np.hstack([free.h, np.zeros((2, 1))]), b=np.append(free.b, 0.5), c=np.eye(3),
        laws=free.laws,
    )  # fmt: skip
    found = jbw.simulate(wide, np.full(64, 2.0), FS)
    alone = jbw.simulate(free, np.full(64, 2.0), FS)
    np.testing.assert_allclose(found.y[2], 0.5 * found.t**2, rtol=1e-13, atol=1e-18)
    alike(found.y[:2], alone.y, 1e-13)


@pytest.mark.parametrize(
    ("changed", "error", "said"),
    [
        ({"h": np.ones((2, 3))}, ConfigError, r"`h` .* must have the shape \(2, 2\)"),
        ({"p": np.ones((3, 2))}, ConfigError, r"`p` .* must have the shape \(2, 2\)"),
        ({"laws": ()}, ConfigError, "tuple of laws for each of the 2 joints"),
        ({"laws": pair().laws[0] * 2}, ConfigError, "kinds BoucWenLaw"),
        ({"h": np.ones(2)}, ConfigError, "`laws` .* must contain laws if `h` has one number"),
        ({"h": np.zeros((0, 2)), "laws": ()}, ConfigError, "at least one row"),
        ({"h": np.array([[1.0, 1.0], [0.0, 0.0]])}, ConfigError, "but it is 0 for joint 1"),
        ({"omega_n": np.array([0.0, 359.0])}, ModelError, "moves joint 0 by 1"),
        ({"omega_n": np.array([-1.0, 359.0])}, ModelError, "at least 0 .* mode 0 is -1"),
        ({"b": None}, ConfigError, "`b` of a `Structure` .* is missing"),
        ({"c": None}, ConfigError, "`c` of a `Structure` .* is missing"),
    ],
)
def test_what_cannot_be_meant_is_refused_in_one_sentence(changed, error, said):
    with pytest.raises(error, match=said):
        jbw.simulate(replace(pair(), **changed), chirped(64), FS)


@pytest.mark.slow
def test_the_substeps_that_are_named_suffice():
    fast = replace(pair(), omega_n=np.array([118.0, 9e3]))
    with pytest.raises(ConfigError, match=r"at most pi rad\.\n.*`substeps=9`"):
        jbw.simulate(fast, chirped(64), FS)
    jbw.simulate(fast, chirped(64), FS, substeps=9)


def test_joints_that_are_stiffer_together_than_the_structure_are_named():
    """Each joint holds 0.6 of its mode's stiffness, and they share it: 1.2 of it."""
    law = jbw.laws.BoucWenLaw(6000.0, 300.0, 100.0)
    stiff = jbw.Structure(
        np.array([100.0, 400.0]), np.full(2, 0.01), np.array([[1.0, 0.0], [1.0, 0.0]]),
        b=np.ones(2), c=np.ones(2), laws=((law,), (law,)),
    )  # fmt: skip
    with pytest.warns(UserWarning, match="The joints are stiffer .* one is 1.2"):
        jbw.simulate(stiff, np.zeros(64), 1000.0)
