"""The lapped beams of the golden numbers: matrices, joints and reductions without code of jbw."""

import json
from pathlib import Path

import numpy as np

from jbw.assembly.joint import Joint
from jbw.assembly.matrices import matrix_model
from jbw.assembly.reduce import reduce

FILE = Path(__file__).parents[1] / "golden_assemblies.json"
CASES = json.loads(FILE.read_text(encoding="utf-8"))["beams"]["cases"]


def symmetric(lower):
    """Return a symmetric matrix from its lower triangle, given as triples."""
    size = 1 + max(row for row, _, _ in lower)
    matrix = np.zeros((size, size))
    for i, j, entry in lower:
        matrix[i, j] = matrix[j, i] = entry
    return matrix


def matrices(case):
    return symmetric(case["M_lower"]), symmetric(case["K_lower"])


def joints(case):
    return [
        Joint(
            f"joint {j}",
            {f"{row + 1}:row": weight for row, weight in place},
            stiffness=law["alpha"],
        )
        for j, (place, law) in enumerate(zip(case["joint_dofs"], case["joints"], strict=True), 1)
    ]


def up_to(case, count):
    """Return a frequency [Hz] between the last kept mode and the next."""
    omega = case["omega"]
    return (omega[count - 1] + omega[count]) / (4 * np.pi)


def reduced(case, count, *, places=None, **options):
    """Return the golden beams with `count` kept modes; residual modes stay as fast as they are."""
    mass, stiffness = matrices(case)
    return reduce(
        matrix_model(mass, stiffness, units="SI"),
        places or joints(case),
        **{
            "to_hz": up_to(case, count),
            "input": f"{case['input_dof'] + 1}:row",
            "outputs": {"tip": f"{case['tip_dof'] + 1}:row"},
            "zeta": case["zeta"],
            "holds_joints": True,
            "slow_residual_modes": False,
        }
        | options,
    )
