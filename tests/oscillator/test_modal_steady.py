"""Several modes with one joint in the steady state: golden harmonics and backbones."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_structure import BOUC_WEN, GOLDEN, one_mode, structure_of, two_modes

import jbw
from jbw.errors import ConfigError, ModelError

STEADY, BACKBONES = (GOLDEN[group]["cases"] for group in ("steady", "backbone"))
LAWS = (jbw.laws.BoucWenLaw(**BOUC_WEN),)


def complexes(pairs):
    return np.array([complex(*pair) for pair in pairs])


# Off resonance and in it, of two modes and of three.
@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=() if place in (1, 3) else pytest.mark.release)
        for place, case in enumerate(STEADY)
    ],
    ids=lambda case: f"{case['A']:g}-{case['f_hz']:g}",
)
def test_golden_harmonics(case):
    """1e-8 of the table with 16 harmonics: what the others beyond leave out in resonance."""
    structure = structure_of(case["system"])
    found = jbw.steady_state(structure, 2 * np.pi * case["f_hz"], case["A"], 16)
    unit = abs(complex(*case["q"]["1"][0]))
    for i, order in enumerate(("1", "3", "5")):
        assert np.max(np.abs(found.q[:, i] - complexes(case["q"][order]))) < 1e-8 * unit
        assert abs(found.x[i] - complex(*case["x_joint"][order])) < 1e-8 * unit
    np.testing.assert_allclose(found.y, np.sum(found.q, 0), rtol=0, atol=1e-15)


# Each size and mode is a program: of two modes the first, of three the last in CI.
@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=() if place in (0, 1, 5, 6) else pytest.mark.release)
        for place, case in enumerate(BACKBONES)
    ],
    ids=lambda case: f"{case['mode']}-{case['x_joint_first_harmonic']:g}",
)
def test_golden_backbones(case):
    """The bounds of the table with 8 harmonics; those of the shape as omega's, doubled by X_3."""
    x_peak = case["x_joint_first_harmonic"]
    found = jbw.backbone(structure_of(case["system"]), x_peak, mode=case["mode"])
    assert float(found.omega) == pytest.approx(case["omega"], rel=1e-9)
    assert float(found.zeta) == pytest.approx(case["zeta_eq"], rel=1e-7)
    for i, order in enumerate(("1", "3")):
        assert np.max(np.abs(found.q[:, i] - complexes(case["q"][order]))) < 1e-8 * x_peak
    assert abs(found.x[1] - complex(*case["x_joint_3"])) < 1e-8 * x_peak
    np.testing.assert_allclose(found.shape, found.q[:, 0] / x_peak, rtol=1e-14)


def test_the_response_of_one_mode_is_that_of_the_oscillator():
    """Newton's round-off; the joint's displacement is the mode's."""
    structure, joint = one_mode(LAWS)
    omega = np.linspace(110.0, 120.0, 4)
    one, other = (jbw.frequency_response(x, omega, 2.0, 4) for x in (structure, joint))
    assert np.max(np.abs(one.x - other)) < 1e-13 * np.max(np.abs(other))
    assert np.max(np.abs(one.q[:, 0] - other)) < 1e-12 * np.max(np.abs(other))


@pytest.mark.release  # its response is, in this file
def test_the_curve_of_one_mode_is_that_of_the_oscillator():
    """Newton's round-off; the joint's displacement is the mode's."""
    structure, joint = one_mode(LAWS)
    curve, own = (jbw.response_curve(x, 114.0, 119.0, 2.0, 4) for x in (structure, joint))
    np.testing.assert_allclose(curve.omega, own.omega, rtol=1e-12)
    largest = np.max(np.abs(own.harmonics))
    np.testing.assert_allclose(curve.harmonics.x, own.harmonics, rtol=0, atol=1e-12 * largest)


def test_one_mode_and_one_harmonic_have_the_closed_backbone():
    structure, joint = one_mode(LAWS)
    x = np.array([0.0, 5e-3, 1e-4, 1e-3])  # in any order
    one, other = jbw.backbone(structure, x, num_harmonics=1), jbw.backbone(joint, x)
    np.testing.assert_allclose(one.omega, other.omega, rtol=1e-12)
    np.testing.assert_allclose(one.zeta, other.zeta, rtol=1e-12)


def test_a_structure_without_a_law_has_its_receptance():
    """Mode by mode 1/(w^2 - W^2 + 2 j z w W); its backbone is the modes themselves."""
    linear = replace(two_modes(), laws=())
    omega = 200.0
    s = linear
    q = s.b * 2.0 / (s.omega_n**2 - omega**2 + 2j * s.zeta * s.omega_n * omega)
    found = jbw.steady_state(linear, omega, 2.0, 3)
    # Round-off of the receptances.
    np.testing.assert_allclose(found.q[:, 0], q, rtol=1e-13)
    np.testing.assert_allclose(found.y[0], s.c @ q, rtol=1e-13)
    along = jbw.backbone(linear, np.array([0.0, 1e-3]), mode=1, num_harmonics=2)
    np.testing.assert_allclose(along.omega, 359.0, rtol=1e-14)
    np.testing.assert_allclose(along.zeta, 0.006, rtol=1e-12)
    np.testing.assert_allclose(along.shape[:, 1], 1.0 / s.h[1], rtol=1e-14)


def test_steady_state_is_where_the_motion_goes():
    """Against the periodic solve in time, by other code; straight lines of 64 samples a period."""
    omega, amplitude = 2 * np.pi * 18.7, 2.0
    fs = 64 * 18.7
    u = amplitude * np.cos(omega * np.arange(64) / fs)
    motion = jbw.simulate(two_modes(), u, fs, periodic=True, hold="band_limited", substeps=4)
    first = 2.0 / 64 * motion.q @ np.exp(-1j * omega * np.arange(64) / fs)
    found = jbw.steady_state(two_modes(), omega, amplitude, 16)
    # The step's order at 256 steps a period.
    assert np.max(np.abs(found.q[:, 0] - first)) < 1e-6 * np.max(np.abs(first))


@pytest.mark.release  # test_traced_numbers.py has them
def test_gradients_are_slopes():
    structure = jax.tree.map(jnp.asarray, two_modes())

    def told(structure):
        tone = jbw.steady_state(structure, 2 * np.pi * 18.7, 2.0, 4)
        along = jbw.backbone(structure, np.array([1e-3, 3e-3]), num_harmonics=4)
        return 1e3 * jnp.abs(tone.y[0]) + jnp.sum(along.omega / 118.0 + 100.0 * along.zeta)

    valued = jax.jit(jax.value_and_grad(told))
    slopes = valued(structure)[1]
    way = jax.tree.map(lambda x: 1e-6 * x, structure)
    ahead, behind = (jax.tree.map(lambda x, d, s=s: x + s * d, structure, way) for s in (1, -1))
    parts = jax.tree.map(lambda g, d: float(jnp.sum(g * d)), slopes, way)
    # Round-off of the two values over their difference.
    expected = float(valued(ahead)[0] - valued(behind)[0]) / 2
    assert sum(jax.tree.leaves(parts)) == pytest.approx(expected, rel=1e-6)


def test_internal_resonances_are_named():
    near = replace(two_modes(), omega_n=np.array([118.0, 360.0]))
    (found,) = jbw.internal_resonances(near)
    assert found[:3] == (0, 1, 3)
    assert found.detuning == pytest.approx(360.0 / 354.0 - 1.0)
    assert jbw.internal_resonances(near, within=0.01) == ()
    assert jbw.internal_resonances(replace(near, omega_n=np.array([100.0, 420.0]))) == ()
    with pytest.raises(ConfigError, match="cannot be traced"):
        jax.jit(lambda w: jbw.internal_resonances(replace(near, omega_n=w)))(near.omega_n)


def test_doors_refuse_what_cannot_be_meant():
    with pytest.raises(ConfigError, match="index from 0 to 1"):
        jbw.backbone(two_modes(), 1e-3, mode=2)
    with pytest.raises(ConfigError, match="`y_peak` must be at least 0"):
        jbw.backbone(two_modes(), -1e-3)
    with pytest.raises(ConfigError, match="other than 0 to have a backbone"):
        jbw.backbone(replace(two_modes(), h=np.array([1.0, 0.0])), 1e-3, mode=1)
    with pytest.raises(ConfigError, match="`num_harmonics`"):
        jbw.backbone(two_modes(), 1e-3, num_harmonics=0)
    with pytest.raises(ConfigError, match="`omega` must be greater than 0"):
        jbw.steady_state(two_modes(), 0.0, 1.0)
    with pytest.raises(ModelError, match="`amplitude` must be finite"):
        jbw.steady_state(two_modes(), 100.0, np.nan)
