"""Reduced beams with two and three joints in time, against all degrees of freedom.

The golden motion is that of 18 and 19 degrees of freedom, by adaptive steps with every event
located; the golden errors are those of the same reduction in the same integrator.
"""

import warnings

import numpy as np
import pytest
from golden_beams import CASES, joints, reduced
from tiers import represented_by

import jbw
from jbw.oscillator.laws.bouc_wen import BoucWenLaw
from jbw.oscillator.laws.jenkins import Jenkins
from jbw.oscillator.modes.structure import admitted, warn_of_stiff_joints

LAWS = {
    "bouc_wen": lambda law: BoucWenLaw(law["alpha"], law["delta"], law["gamma"]),
    "jenkins": lambda law: Jenkins((law["alpha"],), (law["phi"],)),
}


def with_laws(case):
    """The reduced beams with their golden laws."""
    places = [
        jbw.Joint(joint.name, joint.weights, stiffness=joint.stiffness, laws=LAWS[law["law"]](law))
        for joint, law in zip(joints(case), case["joints"], strict=True)
    ]
    return reduced(case, 5, places=places)


def chirp(case):
    drive, t = case["input"], np.arange(case["num_samples"]) / case["input"]["fs"]
    phase = 2 * np.pi * (drive["f0"] * t + drive["rate"] * t**2 / 2) + drive["phase"]
    return drive["A"] * np.sin(phase) * np.sin(np.pi * np.minimum(t, 0.02) / 0.04) ** 2


@pytest.mark.slow  # compiles steps of eight modes
@pytest.mark.parametrize(  # with the joint at the root the structure is the other and more
    "case", represented_by(CASES[1], CASES[0]), ids=lambda case: case["name"]
)
def test_the_motion_of_the_reduced_beams_is_that_of_all_degrees_of_freedom(case):
    structure = with_laws(case).structure()
    response = jbw.simulate(structure, chirp(case), case["input"]["fs"], substeps=16)
    reduction = case["reduced"]["rubin_5_and_input"]
    index = case["index"]
    # The same reduction: order 4 of the step, the fastest residual mode at 0.4 rad a step.
    for seen, golden in ((response.y, reduction["tip"]), (response.x.T, reduction["x"])):
        expected = np.array(golden)
        np.testing.assert_allclose(
            np.asarray(seen)[index], expected, atol=2e-5 * np.abs(expected).max()
        )
    # All degrees of freedom: the error of the reduction is the golden one at these samples.
    exact_and_golden = (("tip", np.asarray(response.y)), ("x", np.asarray(response.x).T))
    for name, motion in exact_and_golden:
        exact, golden = np.array(case[name]), np.array(reduction[name])
        error, golden_error = (np.linalg.norm(x - exact, axis=0) for x in (motion[index], golden))
        np.testing.assert_allclose(error, golden_error, rtol=0.1, err_msg=name)


@pytest.mark.parametrize("case", CASES, ids=[case["name"] for case in CASES])
def test_joints_that_alone_hold_a_mechanism_are_not_called_stiffer_than_it(case):
    """Freed, the second case is a mechanism: its joints share all of one stiffness, exactly 1."""
    structure = with_laws(case).structure()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_stiff_joints(admitted(structure))
