"""Plans after a run of several modes: every mode is swept, for none tells of the others."""

import json

import numpy as np
import pytest
import xarray as xr
from two_modes import truth

from jbw.errors import ConfigError
from jbw.planning.beliefs import after, modes_of
from jbw.planning.description import parse
from jbw.planning.making import plan_tests

LIMITS = """
[plan]
noise = 1e-3
noise_unit = "m/s"
joints = 2
max_displacement = 1e-3
max_repeats = 4
[sweep]
rates = [3.0]
"""


@pytest.fixture(scope="module")
def tree():
    """Draws of the truth, by a factor of 1.5 where weak motion tells little."""
    rng, parameters = np.random.default_rng(0), truth()
    held = {"sign_2": parameters.pop("sign_2")}
    wide = {"alpha", "delta", "gamma", "shape_2", "coupling_2", "gain_ratio_2", "zeta_2"}
    draws = {
        name: (("chain", "draw"),
               value * np.exp((0.4 if name in wide else 1e-3) * rng.standard_normal((2, 200))))
        for name, value in parameters.items()
    }  # fmt: skip
    attrs = {"laws": json.dumps(["bouc_wen"]), "held": json.dumps(held), "y_peak": 1e-3}
    return xr.DataTree.from_dict({"/": xr.Dataset(attrs=attrs), "/posterior": xr.Dataset(draws)})


@pytest.fixture(scope="module")
def plan(tree):
    return plan_tests(parse(LIMITS, of_run=True), tree)


def test_every_mode_has_sweeps_that_move_the_joint_alike(tree, plan):
    beliefs = after(tree, held={"sign_2": -1.0}, num_joints=2)
    natural = [
        float(np.median(resonances.omega)) / (2 * np.pi) for resonances in modes_of(beliefs.joints)
    ]
    assert natural == pytest.approx([18.8, 57.2], rel=5e-3)  # the draws' own scatter
    assert {row.test[:9] for row in plan.rows} == {"sweep 9.4", "sweep 38-"}
    assert {"shape_2", "coupling_2"} < set(plan.wish.wanted)
    # By the joint's motion over the output's in the second mode, of the joints planned with.
    h = float(np.median(modes_of(beliefs.joints)[1].h))
    high = max(row.y_peak_largest for row in plan.rows if row.test.startswith("sweep 38"))
    low = max(row.y_peak_largest for row in plan.rows if row.test.startswith("sweep 9.4"))
    assert high == pytest.approx(low / h, rel=0.1)


def test_sweeps_of_either_mode_are_combined(plan):
    """Each tells what is its own: the first the law, the second what the joint does to it."""

    def best(begins, name):
        rows = [row for row in plan.rows if row.test.startswith(begins)]
        return min(row.cv[name].median for row in rows)

    assert best("sweep 9.4", "alpha") < 0.5 * best("sweep 38-", "alpha")
    assert best("sweep 38-", "coupling_2") < 0.8 * best("sweep 9.4", "coupling_2")
    assert {chosen.test[:9] for chosen in plan.combination.tests} == {"sweep 9.4", "sweep 38-"}


def test_tones_are_refused(tree):
    limits = parse(LIMITS + "[tones]\nlevels = [1.0]\n", of_run=True)
    with pytest.raises(
        ConfigError, match=r"\[tones\]: tests with steady tones can be planned only"
    ):
        plan_tests(limits, tree)
