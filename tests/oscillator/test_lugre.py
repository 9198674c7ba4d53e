"""LuGre's law: its golden motion, Dahl's law as its limit, and what it does not have."""

import json
from pathlib import Path

import numpy as np
import pytest

import jbw
from jbw.errors import ModelError
from jbw.oscillator.laws.lugre import LuGre
from jbw.oscillator.laws.valanis import Valanis

GOLDEN = json.loads((Path(__file__).parents[1] / "golden_laws.json").read_text())
ROW, ABOUT = GOLDEN["lugre"], GOLDEN["conventions"]
FS, OMEGA_N, ZETA = ABOUT["fs"], ABOUT["omega_n"], ABOUT["zeta"]
TIME = np.arange(ABOUT["N"]) / FS
INPUT = 12.0 * np.sin(2 * np.pi * 1.9 * TIME) * (
    np.sin(2 * np.pi * 17 * TIME) + 0.6 * np.sin(2 * np.pi * 41 * TIME + 0.7)
)  # fmt: skip


@pytest.mark.slow
def test_the_motion_is_the_golden_one():
    names = ("sigma0", "F_c", "F_s", "v_s", "sigma1", "sigma2")
    joint = jbw.Oscillator(OMEGA_N, ZETA, (LuGre(*(ROW[name] for name in names)),))
    found = jbw.simulate(joint, INPUT, FS)
    for name, motion in (("y", found.y), ("v", found.v), ("F", found.z)):
        golden = np.array(ROW["transient"][name])
        # The stock solver's tolerance of 1e-8 a step.
        error = np.max(np.abs(np.asarray(motion)[ABOUT["indices"]] - golden))
        assert error < 1e-5 * np.max(np.abs(golden)), name


@pytest.mark.slow
def test_with_one_friction_it_is_dahls():
    friction = ROW["F_c"]
    one, other = (
        jbw.simulate(jbw.Oscillator(OMEGA_N, ZETA, (law,)), INPUT, FS)
        for law in (LuGre(600.0, friction, friction, 0.05), Valanis.dahl(600.0, friction))
    )
    assert np.max(np.abs(one.y - other.y)) < 1e-4 * np.max(np.abs(other.y))


def test_it_has_no_loop_and_no_backbone():
    joint = jbw.Oscillator(OMEGA_N, ZETA, (LuGre(600.0, 0.9, 1.3, 0.05),))
    with pytest.raises(ModelError, match="depends on the rate"):
        jbw.backbone(joint, np.array([1e-4]))
    with pytest.raises(ModelError, match="depends on the rate"):
        jbw.steady_state(joint, 1.0, OMEGA_N)
