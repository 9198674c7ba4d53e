"""Iwan's array whose sliders slide at less than they stick: golden paths and loops, and Iwan-4."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
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
OMEGA_N, ZETA = ABOUT["omega_n"], ABOUT["zeta"]


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
    # The trapezium over 512 points of half a loop with a kink or two.
    found = np.pi * y_peak**2 * loop.damping[0]
    assert float(found) == pytest.approx(row["energy"], rel=1e-4)
    assert float(loop.stiffness[0]) == pytest.approx(row["kappa"][0], rel=1e-4)


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


def test_it_has_a_backbone_and_is_not_stepped():
    amplitude = jnp.array([0.0, 1e-4, 1e-3, 5e-3])
    same, other = (
        jbw.backbone(jbw.Oscillator(OMEGA_N, ZETA, (law,)), amplitude)
        for law in (law_of(theta=1.0), STICKING)
    )
    np.testing.assert_allclose(same.omega, other.omega, rtol=1e-6)
    np.testing.assert_allclose(same.zeta, other.zeta, rtol=1e-4)
    joint = jbw.Oscillator(OMEGA_N, ZETA, (law_of(),))
    with pytest.raises(ModelError, match="not stepped in time"):
        jbw.simulate(joint, np.zeros(8), 1024.0)
