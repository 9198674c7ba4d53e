"""Several joints of a structure in the steady state: golden harmonics and backbones, identities."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiling import Compiled
from test_joints import GOLDEN, alike, pair, structure_of
from test_structure import two_modes
from tiers import represented_by

import jbw
from jbw.errors import ConfigError
from jbw.oscillator.laws.iwan import Iwan4

PERIODIC, BACKBONES = (GOLDEN[group]["cases"] for group in ("periodic", "backbone"))


def with_kinks(cases):
    """Cases, of which those of two smooth joints wait for a release."""
    return [
        pytest.param(case, marks=pytest.mark.release if case["name"] == "bw+bw" else ())
        for case in cases
    ]


def complexes(pairs):
    return np.array([complex(*each) for each in pairs])


@pytest.mark.slow
@pytest.mark.parametrize("num_harmonics", represented_by(32, 16))  # the closer one
@pytest.mark.parametrize(
    "case", with_kinks(PERIODIC), ids=lambda case: f"{case['name']}-{case['f_hz']:g}"
)
def test_golden_harmonics(case, num_harmonics):
    """What the harmonics beyond leave out; sliders of Jenkins and Iwan have the longest tails."""
    omega = 2 * np.pi * case["f_hz"]
    structure = structure_of(case["system"])
    found = jbw.steady_state(structure, omega, case["A"], num_harmonics)
    unit = np.max(np.abs(complexes(case["q"]["1"])))
    bound = {16: 1e-7, 32: 5e-9}[num_harmonics]
    for i, order in enumerate(("1", "3", "5")):
        assert np.max(np.abs(found.q[:, i] - complexes(case["q"][order]))) < bound * unit
        # A joint sees several modes, up to 1.9 times each.
        assert np.max(np.abs(found.x[:, i] - complexes(case["x"][order]))) < 5 * bound * unit


@pytest.mark.slow
@pytest.mark.parametrize(
    "case", with_kinks(BACKBONES), ids=lambda case: f"{case['name']}-{case['mode']}"
)
def test_golden_backbones(case):
    """All five amplitudes of a case, against the mode's own coordinate."""
    points = case["points"]
    levels = np.array([point["a"] for point in points])
    found = jbw.backbone(structure_of(case["system"]), levels, mode=case["mode"])
    golden = {name: np.array([point[name] for point in points]) for name in ("omega", "zeta_eq")}
    np.testing.assert_allclose(found.omega, golden["omega"], rtol=1e-7)
    np.testing.assert_allclose(found.zeta, golden["zeta_eq"], rtol=1e-5)
    shares = np.array([point["share_of_loss"] for point in points])
    np.testing.assert_allclose(found.loss_share, shares, rtol=0, atol=1e-5)
    for i, point in enumerate(points):
        # Of the shape as of zeta, whose error by the ninth harmonic on is the largest.
        assert np.max(np.abs(found.shape[i] - complexes(point["shape"]))) < 1e-5
        assert np.max(np.abs(found.x[i, :, 0] - complexes(point["x1"]))) < 1e-5 * point["a"]
        assert np.max(np.abs(found.q[i, :, 1] - complexes(point["q3"]))) < 1e-6 * point["a"]
    np.testing.assert_allclose(found.a, levels, rtol=1e-9)
    np.testing.assert_allclose(found.x_peak, np.abs(found.x[..., 0]), rtol=1e-12)


@pytest.mark.slow
def test_every_mode_has_the_program_of_the_first():
    """A structure drawn with all its modes compiles one backbone, whatever their number."""
    structure, programs = structure_of(BACKBONES[0]["system"]), []
    for mode in range(3):
        with Compiled() as compiled:
            found = jbw.backbone(structure, np.array([0.0, 1e-9]), mode=mode, num_harmonics=2)
        programs.append(compiled)
        # In full stick, of any mode, joints that move to either side turn twice a period.
        np.testing.assert_allclose(found.omega[0], structure.omega_n[mode], rtol=1e-12)
    assert "jit(_backbone)" in programs[0]
    assert not programs[1] + programs[2]


def one_row():
    one = two_modes()
    return one, replace(one, h=one.h[None], p=one.p[:, None], laws=(one.laws,))


@pytest.mark.release  # golden motions and backbones are above
def test_the_curve_of_one_row_is_that_of_one_joint():
    curve, same = (jbw.response_curve(s, 114.0, 117.0, 2.0, 4) for s in one_row())
    np.testing.assert_allclose(same.omega, curve.omega, rtol=1e-10)
    alike(same.harmonics.x[:, 0], curve.harmonics.x, 1e-9)


@pytest.mark.release  # golden motions and backbones are above
def test_one_row_is_one_joint():
    """Newton's round-off; the amplitude of a row is the mode's coordinate, h of which is one."""
    one, row = one_row()
    alone, rowed = (jbw.steady_state(s, 2 * np.pi * 18.7, 2.0, 4) for s in (one, row))
    alike(rowed.q, alone.q, 1e-12)
    alike(rowed.x[0], alone.x, 1e-12)
    along = jbw.backbone(one, np.array([1e-3, 3e-3]), num_harmonics=4)
    again = jbw.backbone(row, along.a, num_harmonics=4)
    np.testing.assert_allclose(again.omega, along.omega, rtol=1e-11)
    np.testing.assert_allclose(again.zeta, along.zeta, rtol=1e-9)
    np.testing.assert_allclose(again.x_peak[:, 0], along.x_peak, rtol=1e-9)
    assert np.all(np.asarray(along.loss_share) == 1.0)


@pytest.mark.release  # golden motions and backbones are above
def test_joints_each_on_a_mode_of_its_own_are_oscillators():
    """The other joint does not move at all; its backbone is the closed one with one harmonic."""
    two = replace(pair(), h=np.eye(2))
    found = jbw.steady_state(two, 117.0, 2.0, 4)
    for i in range(2):
        alone = jbw.Oscillator(two.omega_n[i], two.zeta[i], two.laws[i])
        alike(found.x[i], jbw.steady_state(alone, 117.0, 2.0 * two.b[i], 4), 1e-12)
        along = jbw.backbone(two, np.array([0.0, 1e-3]), mode=i, num_harmonics=1)
        closed = jbw.backbone(alone, np.array([0.0, 1e-3]))
        np.testing.assert_allclose(along.omega, closed.omega, rtol=1e-12)
        np.testing.assert_allclose(along.zeta, closed.zeta, rtol=1e-12)
        np.testing.assert_allclose(along.loss_share[1], np.eye(2)[i], rtol=0, atol=1e-12)
        assert np.all(np.isnan(along.loss_share[0]))


@pytest.mark.slow
def test_outputs_do_not_know_the_gauge():
    """A row of h and a column of p by 1.2 with the law rescaled."""
    given = pair()
    law = given.laws[1][0]
    scaled = jbw.laws.BoucWenLaw(law.alpha / 1.2**2, law.delta / 1.2, law.gamma / 1.2)
    s = np.array([1.0, 1.2])
    h = s[:, None] * given.h
    other = replace(given, h=h, p=given.h.T * s, laws=(given.laws[0], (scaled,)))
    # The scaling of p by s with h by s multiplies the force by s^2 / s^2 of the law's own scale.
    one, two = (jbw.steady_state(x, 117.0, 2.0, 4) for x in (given, other))
    alike(two.y, one.y, 1e-12)


@pytest.mark.release  # test_traced_numbers.py has those of a structure
def test_gradients_are_slopes():
    structure = jax.tree.map(jnp.asarray, pair())

    def told(structure):
        tone = jbw.steady_state(structure, 2 * np.pi * 18.7, 2.0, 4)
        along = jbw.backbone(structure, np.array([1e-3, 3e-3]), num_harmonics=4)
        shares = jnp.sum(along.loss_share[:, 0])
        return (
            1e3 * jnp.abs(tone.y[0, 0]) + jnp.sum(along.omega / 118.0 + 100 * along.zeta) + shares
        )

    valued = jax.jit(jax.value_and_grad(told))
    slopes = valued(structure)[1]
    way = jax.tree.map(lambda x: 1e-6 * x, structure)
    ahead, behind = (jax.tree.map(lambda x, d, s=s: x + s * d, structure, way) for s in (1, -1))
    parts = jax.tree.map(lambda g, d: float(jnp.sum(g * d)), slopes, way)
    # Round-off of the two values over their difference.
    expected = float(valued(ahead)[0] - valued(behind)[0]) / 2
    assert sum(jax.tree.leaves(parts)) == pytest.approx(expected, rel=1e-6)


def test_a_mode_that_does_not_vibrate_has_no_backbone():
    rigid = replace(pair(), omega_n=np.array([118.0, 0.0]), h=np.array([[1.0, 0.0], [0.7, 0.0]]))
    with pytest.raises(ConfigError, match="`mode` must be a mode that vibrates"):
        jbw.backbone(rigid, 1e-3, mode=1)


def force_of_sliders(x, stiffness, limit, chi, num=4000):
    """Force less stiffness x along the second of two periods, of an Iwan joint's sliders (beta 0).

    Stiffness of the sliders that slip up to phi is K (phi / phi_max)^(1 + chi), which is all of it
    at phi_max = F_S (2 + chi) / (K (1 + chi)); each of so many cells slips at its middle.
    """
    phi_max = limit * (2.0 + chi) / (stiffness * (1.0 + chi))
    edges = phi_max * np.linspace(0.0, 1.0, num + 1)
    springs = stiffness * np.diff((edges / phi_max) ** (1.0 + chi))
    slips, before = 0.5 * (edges[:-1] + edges[1:]), np.concatenate([[0.0], x, x])
    slid, forces = np.zeros(num), []
    for rise in np.diff(before):
        slid = np.clip(slid + rise, -slips, slips)
        forces.append(springs @ slid)
    return np.array(forces)[x.size :] - stiffness * x


@pytest.mark.slow
def test_three_masses_of_tmdsimpy_balance_with_four_thousand_sliders():
    """Its example `vprnm_rom_iwan`, whose third harmonic meets the second mode.

    The harmonics must balance with the force of sliders along the path found; their cells leave
    1e-5 of it, by the smallest of three loops.
    """
    omega_n, num = np.array([1.12237817, 3.20004176, 7.5]), 2048
    h, b = np.array([-0.86383265, -2.06247258, 0.0]), np.array([1.13167848, -1.92854967, -2.0])
    law = Iwan4.of_segalman(0.6, 10.0, -0.5, 0.0)
    structure = jbw.Structure(omega_n, 0.005 / omega_n, h[None], b=b, c=np.ones(3), laws=((law,),))
    tones = np.array([0.7, 0.9, 0.93])
    steady = jbw.steady_state(structure, tones, 20.0, 16)
    third = []
    for tone, x, q in zip(tones, np.asarray(steady.x)[:, 0], np.asarray(steady.q), strict=True):
        orders = np.arange(1, 2 * x.size, 2)
        path = np.real(np.exp(2j * np.pi * np.outer(np.arange(num) / num, orders)) @ x)
        force = np.fft.fft(force_of_sliders(path, 0.6, 10.0, -0.5))[orders] * 2.0 / num
        inertia = omega_n[:, None] ** 2 - (orders * tone) ** 2 + 0.01j * orders * tone
        drive = 20.0 * np.outer(b, orders == 1)
        assert np.max(np.abs(inertia * q + h[:, None] * force - drive)) < 1e-5 * np.abs(force[0])
        third.append(np.abs(q[1, 1]))
    # A third of the freed second frequency, 2.80 rad/s, is 0.934 rad/s.
    assert third[2] > third[1] > 10 * third[0]
