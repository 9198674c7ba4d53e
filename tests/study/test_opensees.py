"""The exported materials in OpenSees itself, moved along a path beside the laws' exact moves.

OpenSees runs in a process of its own: it keeps its model in the process, and speaks at its end.
"""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from in_opensees import commands_of, needs_opensees, ran
from known_laws import THETA, law_of
from test_exports_elsewhere import MASS, Y_MAX, assert_same, forces, result_of

from jbw.export.exports import PROGRAMS
from jbw.export.exports.opensees import opensees_lines
from jbw.oscillator.laws.sliders import lost_by, sliders_of

# A zeroLength element between a held node and one that is moved; its force after every move.
RUN = """
ops.model("basic", "-ndm", 1, "-ndf", 1)
ops.node(1, 0.0)
ops.node(2, 0.0)
ops.fix(1, 1)
for line in asked["lines"]:
    command, kind, *rest = line.split()
    getattr(ops, command)(kind, *map(word, rest))
ops.element("zeroLength", 1, 1, 2, "-mat", 1, "-dir", 1)
ops.timeSeries("Path", 1, "-dt", 1.0, "-values", 0.0, *asked["y"], asked["y"][-1])
ops.pattern("Plain", 1, 1)
ops.sp(2, 1, 1.0)
ops.constraints("Lagrange")
ops.numberer("Plain")
ops.system("FullGeneral")
ops.test("NormUnbalance", 1e-9, 20)
ops.algorithm("Newton")
ops.integrator("LoadControl", 1.0)
ops.analysis("Static")
found = []
for _ in asked["y"]:
    assert ops.analyze(1) == 0
    found.append(ops.eleResponse(1, "material", 1, "stress")[0])
print(json.dumps(found))
"""
pytestmark = [
    pytest.mark.slow,  # a few seconds each, of moves one by one
    needs_opensees,
]
TURNS = np.concatenate([[0.0], 3e-3 * np.random.default_rng(1).uniform(-1, 1, 12), [3e-3, -3e-3]])
STROKES = 5  # of them, where steps must be short


@cache
def path(steps):
    """Every move between two of the displacements in as many steps."""
    return np.concatenate([np.linspace(a, b, steps + 1)[1:] for a, b in pairwise(TURNS)])


def in_opensees(folder, result, y):
    """Force of spring and joint along a path [N]."""
    (file,) = PROGRAMS["opensees"].card(folder, result)
    return moved(commands_of(file.read_text()), y)


def moved(lines, y):
    """Force of the materials that some commands make, along a path [N]."""
    return ran(RUN, {"lines": [*lines], "y": [*y]}, timeout=120)


def exact(result, laws, y):
    """The same by the laws' own moves."""
    return result.linear["spring"] * y + forces(laws, y, np.zeros(y.size))


@pytest.mark.parametrize("laws", [("jenkins_3", "stop")], ids="+".join)
def test_sliders_and_stops_are_exact(tmp_path, laws):
    result, y = result_of(*laws), path(7)
    assert_same(in_opensees(tmp_path, result, y), exact(result, laws, y))


@pytest.mark.parametrize("law", ["bouc_wen", "bouc_wen_nu"])
def test_bouc_wen_is_the_law_as_steps_get_short(tmp_path, law):
    """OpenSees steps it by Euler's rule, backwards, whose error halves with the step."""
    result = result_of(law)
    ends = exact(result, (law,), TURNS[1:])
    size = np.max(np.abs(ends - result.linear["spring"] * TURNS[1:]))
    error = [
        np.max(np.abs(in_opensees(tmp_path, result, path(steps))[steps - 1 :: steps] - ends)) / size
        for steps in (40, 80)
    ]
    assert error[1] < 1e-2
    assert error[0] / error[1] == pytest.approx(2.0, rel=0.15)


def worn(law, **own):
    """The materials of a law at other parameters, and its force at every turn [N]."""
    theta = {**THETA[law], **own}
    joint = law_of(law, theta)
    (found,) = (one.materials for one in joint.convert(118.0, 0.005, MASS).values())
    memory, ends = joint.at_rest(), []
    for start, end in pairwise(TURNS[: STROKES + 1]):
        memory = joint.move(start, memory, end - start)
        ends.append(MASS * float(joint.force(end, 1.0, memory)))
    return opensees_lines(found), np.array(ends)


@pytest.mark.parametrize(
    ("material", "law", "own"),
    [
        ("BWBN", "bwbn_pinching", {}),
        ("BWBN", "bwbn", {"bwbn_delta_nu": 0.0, "bwbn_delta_eta": 0.0}),
        ("BoucWen", "bwbn", {"bwbn_zeta_s": 0.0}),
    ],
)
def test_pinching_and_degradation_are_those_of_opensees(material, law, own):
    """OpenSees steps them by Euler's rule, backwards: 0.1 % in steps short enough."""
    lines, ends = worn(law, **own)
    assert lines[0].split()[1] == material
    size = np.max(np.abs(ends))
    error = [
        np.max(np.abs(moved(lines, path(n)[: n * STROKES])[n - 1 :: n] - ends)) / size
        for n in (800, 1600)
    ]
    assert error[1] < 1e-3
    assert error[0] / error[1] == pytest.approx(2.0, rel=0.15)


def test_no_material_has_both():
    joint = law_of("bwbn")
    assert joint.bwbn_delta_nu > 0
    assert joint.bwbn_zeta_s > 0
    assert joint.convert(118.0, 0.005, MASS) == {}


@pytest.mark.parametrize("law", ["iwan4", "masing_power", "masing_exponential"])
def test_laws_of_masing_are_sliders(tmp_path, law):
    result, y = result_of(law), path(7)
    found = in_opensees(tmp_path, result, y)
    expected = exact(result, (law,), y)
    size = np.max(np.abs(forces((law,), y, 0.0 * y)))
    # A bin is as wide as a fifteenth of where it lies: the slope there is off by half of it.
    np.testing.assert_allclose(found, expected, atol=2e-3 * size)
    text = (tmp_path / "joint.tcl").read_text()
    assert f"The joint {law} is represented by sliders up to a displacement of 0.008 m" in text
    # What is stated of the loss, by the closed form of sliders and the law's own.
    told = float(text.partition("per cycle is at most ")[2].partition(" %")[0]) / 100.0
    peaks = Y_MAX * np.array([0.1, 0.33, 0.7, 1.0])
    law = law_of(law)
    exactly = [np.pi * y**2 * float(law.loop(y).damping) for y in peaks]
    lost = lost_by(sliders_of(law, 2 * Y_MAX), peaks)
    assert np.max(np.abs(lost / exactly - 1.0)) < 1.3 * told < 0.007
    assert text.count("ElasticPP") >= 55
    assert MASS == result.mass
