"""Bouc-Wen's law behind a gap: golden numbers, and what becomes of it without a gap."""

import itertools
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from known_laws import compiled
from tiers import represented_by

import jbw
from jbw.oscillator.laws.bouc_wen import BoucWenLaw
from jbw.oscillator.laws.gap_move import unloading
from jbw.oscillator.laws.gap_series import GapSeries

GOLD = json.loads((Path(__file__).parents[1] / "golden_laws.json").read_text())
RULES, OWN = GOLD["conventions"], GOLD["gap_series_bouc_wen"]
TIME = np.arange(RULES["N"]) / RULES["fs"]
INPUT = (
    RULES["A"]
    * np.sin(2 * np.pi * 1.9 * TIME)
    * (np.sin(2 * np.pi * 17 * TIME) + 0.6 * np.sin(2 * np.pi * 41 * TIME + 0.7))
)
PARAMETERS = tuple(OWN[name] for name in ("alpha", "delta", "gamma", "gap_half_width"))
LAW = GapSeries(*PARAMETERS)


def joint(law=LAW):
    return jbw.Oscillator(RULES["omega_n"], RULES["zeta"], (law,))


@compiled
def steady(law, y_peak):
    """Memory at the tip, loop, and the way on which the law lets go."""
    tip = law.at_tip(y_peak)
    return tip, law.loop(y_peak), unloading(law, tip[0])


@compiled
def moved(law, memory, dy):
    return law.move(0.0, memory, dy)


def test_the_steady_loop_is_golden():
    for row in OWN["steady"]:
        (z, s), loop, way = steady(LAW, row["Y"])
        np.testing.assert_allclose(z, row["F_tip"], rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(s, min(row["Y"], LAW.gap))
        energy = loop.energy(row["Y"])
        np.testing.assert_allclose(energy, row["energy"], rtol=1e-11, atol=1e-18)
        if "y_gap_entry" in row:
            released = row["Y"] - way
            np.testing.assert_allclose(released, row["y_gap_entry"], rtol=1e-12)


def test_the_stiffness_of_the_loop_is_that_of_its_moves():
    for y_peak in (0.8e-3, 2.4e-3, 4.8e-3):
        theta = np.pi * (np.arange(20_000) + 0.5) / 20_000
        force = [LAW.move(0.0, LAW.at_tip(y_peak), y_peak * (np.cos(theta) - 1.0))[0]]
        real = 2 * np.mean(np.asarray(force[0]) * np.cos(theta)) / y_peak
        np.testing.assert_allclose(LAW.loop(y_peak).stiffness, real, rtol=1e-6)
    assert LAW.loop(0.5e-3) == (0.0, 0.0)


def test_prescribed_motion_is_golden():
    y, memory, found = 0.0, LAW.at_rest(), []
    for before, after in itertools.pairwise(GOLD["path"]["turning_points"]):
        for target in (0.5 * (before + after), after):
            memory = moved(LAW, memory, target - y)
            y = target
            found.append(float(memory[0]))
    np.testing.assert_allclose(found, OWN["path_force"], rtol=1e-12, atol=1e-13)


# Measured 8.8e-7, 8.7e-8 and 6.7e-9.
@pytest.mark.parametrize(("substeps", "error"), represented_by((4, 2e-8), (1, 2e-6), (2, 2e-7)))
def test_the_transient_is_golden(substeps, error):
    response = jbw.simulate(joint(), INPUT, RULES["fs"], substeps=substeps)
    for letter, found in (("y", response.y), ("v", response.v)):
        golden = np.asarray(OWN["transient"][letter])
        misfit = np.max(np.abs(np.asarray(found)[RULES["indices"]] - golden))
        assert misfit <= error * np.max(np.abs(golden))


def test_without_a_gap_it_is_bouc_wens_law():
    alpha, delta, gamma, _ = PARAMETERS
    plain, none = BoucWenLaw(alpha, delta, gamma), GapSeries(alpha, delta, gamma, 0.0)
    y, own, other = 0.0, none.at_rest(), 0.0
    for target in (2e-3, -1e-3, 3e-3, 0.5e-3, -4e-3):
        own, other = moved(none, own, target - y), moved(plain, other, target - y)
        y = target
        np.testing.assert_allclose(own[0], other, rtol=1e-12)
    np.testing.assert_allclose(none.loop(3e-3), plain.loop(3e-3), rtol=1e-11)


def test_a_gap_wider_than_all_motion_never_acts():
    wide = joint(GapSeries(*PARAMETERS[:3], 1.0))
    linear = jbw.Oscillator(RULES["omega_n"], RULES["zeta"], ())
    response = jbw.simulate(wide, INPUT, RULES["fs"])
    np.testing.assert_array_equal(response.z, 0.0)
    np.testing.assert_allclose(response.y, jbw.simulate(linear, INPUT, RULES["fs"]).y, atol=1e-15)


def test_gradients_of_the_transient_are_central_differences():
    def squares(x):
        return jnp.sum(jbw.simulate(joint(GapSeries(*x)), INPUT, RULES["fs"]).v ** 2)

    x = jnp.array(PARAMETERS)
    slope = jax.jit(jax.grad(squares))(x)
    value = jax.jit(squares)
    for i in range(4):
        step = 1e-6 * x[i]
        near = (value(x.at[i].add(step)) - value(x.at[i].add(-step))) / (2 * step)
        # A contact that comes a step earlier bends the sum: an error of first order in the step.
        np.testing.assert_allclose(slope[i], near, rtol=1e-4)
