"""Two lapped beams built in OpenSees from its own elements, with the exported joints in them.

OpenSees runs in a process of its own: it keeps its model in the process, and speaks at its end.
"""

import numpy as np
import pytest
import scipy.signal
import two_bolts
from full_model import joints_read, moved
from in_opensees import commands_of, needs_opensees, ran
from joints_tree import tree_of

from jbw.export.exports import PROGRAMS
from jbw.export.several_joints import export_joints
from jbw.rig.assemblies import BAR, CLAMPING, lapped_beams

# Beams along x that bend in x and z: their rotation about y is -dw/dx.
RUN = """
ops.model("basic", "-ndm", 3, "-ndf", 6)
for node, x in asked["nodes"]:
    ops.node(node, x, 0.0, 0.0)
    ops.fix(node, *([1] * 6 if node in asked["clamped"] else [1, 1, 0, 1, 0, 1]))
ops.geomTransf("Linear", 1, 0.0, 1.0, 0.0)
E, A, I, mass = asked["section"]
for tag, (a, b) in enumerate(asked["beams"], 1):
    ops.element("elasticBeamColumn", tag, a, b, A, E, E, I, I, I, 1, "-mass", mass, "-cMass")
ops.uniaxialMaterial("Elastic", 9, asked["clamping"])
for tag, (a, b) in enumerate(asked["bolts"], 101):
    ops.element("zeroLength", tag, a, b, "-mat", 9, "-dir", 3)
for line in asked["lines"]:
    command, *rest = line.split()
    getattr(ops, command)(*map(word, rest))
ops.timeSeries("Path", 1, "-dt", asked["h"], "-values", *asked["force"], "-factor", 1.0)
ops.pattern("Plain", 1, 1)
ops.load(asked["driven"], 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
ops.constraints("Lagrange")
ops.numberer("Plain")
ops.system("UmfPack")
ops.test("NormUnbalance", 1e-9, 20)
ops.algorithm("Newton")
ops.integrator("Newmark", 0.5, 0.25)
ops.analysis("Transient")
found = []
for _ in asked["force"][1:]:
    assert ops.analyze(1, asked["h"]) == 0
    found.append([ops.nodeVel(asked["tip"], 3), *(ops.nodeDisp(n, 1) for n in asked["joints"])])
print(json.dumps(found))
"""
pytestmark = [
    pytest.mark.slow,
    needs_opensees,
]
FIRST, SECOND = (0.1, 0.1, 0.05, 0.04), (0.04, 0.08, 0.08, 0.08)  # elements of `lapped_beams`
FACTOR, SAMPLES = 64, 80  # steps a sample; 0.16 s, in which both bolts slip


def test_opensees_moves_as_the_whole_matrices_do(tmp_path):
    result = export_joints(tree_of(), draw=0)
    (file,) = PROGRAMS["opensees"].joints.card(tmp_path, result)
    text = file.read_text()
    rig, fs = lapped_beams(), two_bolts.FS
    t = np.arange(SAMPLES) / fs
    u = 40.0 * np.sin(np.pi * t * fs / SAMPLES) ** 2 * np.sin(2 * np.pi * 60.0 * t)
    velocity, motion = moved(rig, joints_read(text), u, fs, zeta=0.0, factor=FACTOR)
    lap = FIRST[0] + FIRST[1] + FIRST[2]  # where the second beam begins
    places = [(100, 0.0), *((i + 1, sum(FIRST[: i + 1])) for i in range(4))]
    places += [(101 + i, lap + sum(SECOND[:i])) for i in range(5)]
    model = {
        "nodes": places,
        "clamped": [100],
        "section": (BAR.modulus, BAR.width * BAR.thickness, BAR.bending / BAR.modulus, BAR.mass),
        "beams": [(100, 1), (1, 2), (2, 3), (3, 4), (101, 102), (102, 103), (103, 104), (104, 105)],
        "bolts": [(3, 101), (4, 102)],
        "clamping": CLAMPING,
        "lines": commands_of(text),
        "force": scipy.signal.resample(u, len(u) * FACTOR).tolist(),
        "h": 1 / (fs * FACTOR),
        "driven": 1,
        "tip": 105,
        "joints": [1001, 1002],
    }
    found = ran(RUN, model, timeout=300)[FACTOR - 1 :: FACTOR]
    tip, bolts = found[:, 0], found[:, 1:]
    # Samples 1 on. OpenSees steps the law by Euler's rule backwards, 1 % of a step of that size.
    assert np.std(tip - velocity[1:]) < 5e-3 * np.std(velocity)
    # Rotations about y are the other way there, and so is the motion of both bolts.
    for x, whole in zip(-bolts.T, motion[1:].T, strict=True):
        assert np.std(x - whole) < 1e-2 * np.std(whole)
        assert np.abs(whole).max() > 2e-6  # delta x of 0.5 and more
    linear = [joint._replace(material=(1.0, *joint.material[1:])) for joint in joints_read(text)]
    stuck, _ = moved(rig, linear, u, fs, zeta=0.0, factor=FACTOR)
    assert np.std(stuck - velocity) > 0.05 * np.std(velocity)  # without slip it is another motion
