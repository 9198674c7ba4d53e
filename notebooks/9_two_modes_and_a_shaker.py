# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     name: python3
# ---

# %% [markdown]
# # 9 Two modes and a shaker
#
# *What does the shaker add to a structure, and do two modes meet in one joint?*
#
# A structure of two modes is built on the virtual rig: each mode has a shape at the drive point, at
# the joint and at the laser, and a shaker with an armature of its own pushes it. The rig integrates
# all of it by code that shares nothing with what identifies it.

# %%
# %matplotlib inline
from dataclasses import replace

import numpy as np

import jbw
from jbw import rig

jbw.enable_x64()
shapes = rig.Shapes(
    omega=2 * np.pi * np.array([18.8, 57.2]), zeta=np.array([0.006, 0.008]),
    drive=np.array([0.7, 0.9]), joint=np.array([1.0, -0.8]), output=np.array([1.0, 0.7]),
)  # fmt: skip
armature = rig.Armature(gain=20.0, mass=0.01, damping=1.2, stiffness=300.0)
joint = jbw.BoucWen(omega_n=float(shapes.omega[0]), zeta=0.006, alpha=3e3, delta=340.0, gamma=90.0)
every = {"sources": ("input", "force", "drive_point"), "drive": "voltage"}
plans = [rig.Plan("noise", "noise", rig.Noise(0.01, 64.0, settle=16.0), 1, (10.0, 70.0), **every)]
levels = {"low": (14.0, 24.0, (0.05, 0.08, 0.12)), "high": (50.0, 64.0, (0.25, 0.4, 0.7))}
plans += [
    rig.Plan(
        f"{mode}_{i}", "sweep",
        rig.Sweep(*ends, volts, burst=3.0, fade=0.2, duration=4.0), 2, sources=("force",),
    )
    for mode, (*ends, each) in levels.items()
    for i, volts in enumerate(each)
]  # fmt: skip
preset = rig.Preset(
    name="two modes", gain=1.0, input_range=64.0, velocity_range=8.0, plans=tuple(plans),
    noise_ratio=0.01, shapes=shapes, armature=armature,
)  # fmt: skip

# %% [markdown]
# ## The shaker
#
# Voltage, force and the drive point's motion were recorded together. Step 2 of the FRF by force
# reads the structure alone; the force by the voltage and the motion reads the shaker; and from both
# follows what a test that is driven by voltage would read. `jbw check` says this sentence of every
# test that has the three channels.

# %%
noise = rig.measure(preset, joint=joint, tests=["noise"], fs=256.0, seed=1).tests[0]
read = jbw.steps.read_shaker(noise, modes=2)
print(jbw.steps.shaker_sentence("noise", read))
for name, found in (("mass", read.shaker.mass), ("damping", read.shaker.damping)):
    print(f"armature's {name}: {found:.4g}, built with {getattr(armature, name):g}")

# %% [markdown]
# The modes that a voltage drives lie elsewhere and are more damped than those of the structure: a
# campaign of both says `drive` in its tests and shares one joint, not one frequency.
#
# ## Two modes, one joint
#
# Sweeps through both modes, three levels each, by the measured force. `[structure] modes` states
# the modes; the first keeps the meaning of one mode alone, the second adds how far it moves the
# joint (`shape_2`) and what the joint does to it (`coupling_2`). The middle level of each is left
# out, to be predicted.

# %%
swept = [plan.name for plan in plans[1:]]
campaign = rig.measure(preset, joint=joint, tests=swept, fs=256.0, seed=1)
settings = {"fit_repeats": 2, "offsets": "none", "hold_out": ["low_1", "high_1"]}
campaign = replace(campaign, structure={"modes": (18.8, 57.2)}, settings=settings)
study = jbw.identify(campaign, seed=1)
print(study)

# %% [markdown]
# What the rig was built with, in the same parameters, beside the 99 % intervals:

# %%
modes = rig.modal_truth(shapes)
first, second = ({name: values[i] for name, values in modes.items()} for i in (0, 1))
truth = {
    "omega_n": first["omega_n"], "zeta": first["zeta"], "omega_2": second["omega_n"],
    "zeta_2": second["zeta"], "shape_2": abs(second["h"]),
    "coupling_2": abs(second["p"]) * second["h"] ** 2, **rig.law_of_mode(joint.laws[0], shapes),
}  # fmt: skip
posterior = study.tree["posterior"].to_dataset()
for name, value in truth.items():
    low, high = np.quantile(posterior[name], [0.005, 0.995])
    print(f"{name:>10}: {value:10.5g} in [{low:.5g}, {high:.5g}]: {low < value < high}")

# %% [markdown]
# All lie inside. Were only the first mode swept, the second's `shape_2` would be known poorly: it
# has to move the joint itself. And where no mode is driven beyond delta x = 0.3, the joint is known
# by its products alone.
#
# The levels that no fit saw:

# %%
for name in ("low_1", "high_1"):
    found = study.tree[f"verification/sweep/{name}"].attrs
    print(
        f"{name}: missed by {found['nrmse']:.2%} of its rms (a linear structure: "
        f"{found['nrmse_linear']:.0%}), {found['coverage']:.1%} of the values in the 99 % band"
    )

# %% [markdown]
# One per cent of noise over the root of two repeats is 0.71 %: the rest is predicted.
#
# ## Backbones and shapes
#
# Frequency, damping and deflection of both modes against the joint's amplitude, of the posterior's
# mean. The second mode softens too, by the same joint, and both change their shapes as it slips.

# %%
names = [name for name in posterior if name in truth or name in ("gain", "gain_ratio_2")]
theta = {name: float(posterior[name].mean()) for name in names} | {"sign_2": -1.0}
structure = jbw.structure_of(theta, campaign.laws)
axes = jbw.draw_backbones(structure, np.linspace(0.0, 3e-3, 13))
axes.flat[0].figure

# %% [markdown]
# A title says where one mode meets an odd multiple of another: there the curve is one of both, and
# a test that is driven there shows it.
