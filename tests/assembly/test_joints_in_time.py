"""Reduced beams with two and three joints in time, against all degrees of freedom.

The golden motion is that of 18 and 19 degrees of freedom, by adaptive steps with every event
located; the golden errors are those of the same reduction in the same integrator.
"""

import numpy as np
import pytest
from golden_beams import CASES, joints, reduced

import jbw
from jbw.errors import JbwError
from jbw.oscillator.laws.bouc_wen import BoucWenLaw
from jbw.oscillator.laws.jenkins import Jenkins
from jbw.oscillator.modes.structure import Structure, admitted

LAWS = {
    "bouc_wen": lambda law: BoucWenLaw(law["alpha"], law["delta"], law["gamma"]),
    "jenkins": lambda law: Jenkins((law["alpha"],), (law["phi"],)),
}


def takes_several_joints():
    try:
        admitted(Structure(np.ones(2), np.ones(2), np.ones((2, 2)), np.ones((2, 2)), np.ones(2),
                           np.ones(2), ((), ())))  # fmt: skip
    except (JbwError, TypeError):
        return False
    return True


pytestmark = [
    pytest.mark.slow,  # compiles steps of eight modes
    pytest.mark.skipif(not takes_several_joints(), reason="a `Structure` has one joint here"),
]


def chirp(case):
    drive, t = case["input"], np.arange(case["num_samples"]) / case["input"]["fs"]
    phase = 2 * np.pi * (drive["f0"] * t + drive["rate"] * t**2 / 2) + drive["phase"]
    return drive["A"] * np.sin(phase) * np.sin(np.pi * np.minimum(t, 0.02) / 0.04) ** 2


@pytest.mark.parametrize("case", CASES, ids=[case["name"] for case in CASES])
def test_the_motion_of_the_reduced_beams_is_that_of_all_degrees_of_freedom(case):
    places = [
        jbw.Joint(joint.name, joint.weights, stiffness=joint.stiffness, laws=LAWS[law["law"]](law))
        for joint, law in zip(joints(case), case["joints"], strict=True)
    ]
    structure = reduced(case, 5, places=places).structure()
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
    exact, golden = np.array(case["tip"]), np.array(reduction["tip"])
    error, golden_error = (
        np.linalg.norm(tip - exact) for tip in (np.asarray(response.y)[index], golden)
    )
    assert error == pytest.approx(golden_error, rel=0.1)
