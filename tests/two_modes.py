"""Two modes with one Bouc-Wen joint, swept on the rig, whose integrator is independent of jbw.

The source is the measured force, without an armature; the output is not where the force acts.
"""

from dataclasses import replace

import numpy as np

import jbw
from jbw import rig
from jbw.campaign.settings import Identify, Structured
from jbw.rig.generator import Sweep
from jbw.rig.presets import Plan, Preset
from jbw.rig.structure import Armature, Shapes, law_of_mode, modal_truth

SHAPES = Shapes(
    omega=2 * np.pi * np.array([18.8, 57.2]), zeta=np.array([0.006, 0.008]),
    drive=np.array([0.7, 0.9]), joint=np.array([1.0, -0.8]), output=np.array([1.0, 0.7]),
)  # fmt: skip
WING = np.array([0.4, -1.1])  # shapes at a second point
JOINT = jbw.BoucWen(omega_n=float(SHAPES.omega[0]), zeta=0.006, alpha=3e3, delta=340.0, gamma=90.0)
FS, STATED = 256.0, Structured(modes=(18.8, 57.2))
# delta times the joint's motion reaches 0.3 to 1 in the sweeps of each mode.
LEVELS = {"low": (14.0, 24.0, (0.8, 1.2, 2.0)), "high": (50.0, 64.0, (4.0, 7.0, 12.0))}


def truth():
    """Return the true parameters by their names in a campaign, from the shapes alone."""
    modes = modal_truth(SHAPES)
    first, second = ({name: values[i] for name, values in modes.items()} for i in (0, 1))
    found = {"omega_n": first["omega_n"], "zeta": first["zeta"], "gain": first["b"]}
    found |= {"omega_2": second["omega_n"], "zeta_2": second["zeta"]}
    found |= {"gain_ratio_2": second["b"] / first["b"], "shape_2": abs(second["h"])}
    found |= {"sign_2": np.sign(second["h"]), "coupling_2": abs(second["p"]) * second["h"] ** 2}
    law = law_of_mode(JOINT.laws[0], SHAPES)
    return {name: float(value) for name, value in (found | law).items()}


def truth_at_wing():
    """Return the motion of the second point relative to the first in each mode, from the shapes."""
    return {f"point_2_{i + 1}": float(x) for i, x in enumerate(WING / SHAPES.output)}


def swept(names, *, duration=4.0, seed=1, noise_ratio=0.01, shapes=SHAPES):
    """Return a campaign with some of the sweeps, `low_0` to `high_2`, with two repeats each."""
    plans = tuple(
        Plan(f"{band}_{i}", "sweep", Sweep(*ends, level, burst=0.75 * duration, fade=0.2,
             duration=duration), 2, sources=("force",))
        for band, (*ends, levels) in LEVELS.items()
        for i, level in enumerate(levels)
    )  # fmt: skip
    preset = Preset(
        name="two modes", gain=1.0, input_range=64.0, velocity_range=8.0, plans=plans,
        source="force", noise_ratio=noise_ratio, shapes=shapes, armature=Armature(),
    )  # fmt: skip
    taken = rig.measure(preset, joint=JOINT, tests=names, fs=FS, seed=seed)
    settings = Identify.of({"fit_repeats": 2, "offsets": "none"})
    return replace(taken, structure=STATED, settings=settings)


def at_two_points(names, *, seed=1, duration=4.0):
    """Return the sweeps with the velocity also measured at a second point, by another laser."""
    first = swept(names, duration=duration, seed=seed)
    there = SHAPES._replace(output=WING)
    other = swept(names, duration=duration, seed=seed + 1000, shapes=there)
    tests = []
    for test, seen in zip(first.tests, other.tests, strict=True):
        records = tuple(
            replace(one, channels={**one.channels, "velocity": same.channels["velocity"]})
            for one, same in zip(test.records, seen.records, strict=True)
        )
        test = replace(test, run=test.name)
        tests += [test, replace(test, records=records, name=f"{test.name} at wing", point="wing")]
    structure = STATED.model_copy(update={"points": ("wing",)})
    return replace(first, tests=tuple(tests), structure=structure)
