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
# *What does the shaker add to a structure, and do two modes share one joint?*
#
# The virtual rig simulates a structure with two modes. Each mode has a shape at the drive point, at
# the joint and at the laser, and a shaker with its own armature drives the structure. The rig
# shares no code with the identification.

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
# Voltage, force and the motion of the drive point were recorded together. Step 2 with the FRF by
# force gives the structure alone. The force, as a function of the voltage and the motion, gives the
# shaker. Together they predict the result of a test driven by voltage. `jbw check` prints this
# sentence for every test with the three channels.

# %%
noise = rig.measure(preset, joint=joint, tests=["noise"], fs=256.0, seed=1).tests[0]
read = jbw.steps.read_shaker(noise, modes=2)
print(jbw.steps.shaker_sentence("noise", read))
for name, found in (("mass", read.shaker.mass), ("damping", read.shaker.damping)):
    print(f"armature's {name}: {found:.4g}, built with {getattr(armature, name):g}")

# %% [markdown]
# The modes driven by a voltage have other frequencies and more damping than those of the structure.
# A campaign with both states `drive` in its tests; the tests then share one joint, but not one
# frequency.
#
# ## Two modes, one joint
#
# The sweeps pass through both modes at three levels each, with the measured force.
# `[structure] modes` states the modes. The first keeps the meaning of a single mode. The second
# adds its motion at the joint (`shape_2`) and the effect of the joint on it (`coupling_2`). The
# middle level of each is held out, to be predicted.

# %%
swept = [plan.name for plan in plans[1:]]
campaign = rig.measure(preset, joint=joint, tests=swept, fs=256.0, seed=1)
settings = {"fit_repeats": 2, "offsets": "none", "hold_out": ["low_1", "high_1"]}
campaign = replace(campaign, structure={"modes": (18.8, 57.2)}, settings=settings)
study = jbw.identify(campaign, seed=1)
print(study)

# %% [markdown]
# The true parameters of the rig, with the 99 % intervals:

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
# All intervals contain the truth. If only the first mode were swept, `shape_2` would be poorly
# determined: the second mode must move the joint itself. If no mode is driven beyond delta x = 0.3,
# the tests determine only the products of the joint.
#
# The held-out levels:

# %%
for name in ("low_1", "high_1"):
    found = study.tree[f"verification/sweep/{name}"].attrs
    print(
        f"{name}: missed by {found['nrmse']:.2%} of its rms (a linear structure: "
        f"{found['nrmse_linear']:.0%}), {found['coverage']:.1%} of the values in the 99 % band"
    )

# %% [markdown]
# One per cent of noise over the root of two repeats is 0.71 %, so the prediction leaves little more
# than noise.
#
# ## Backbones and shapes
#
# The figure shows frequency, damping and deflection of both modes against the amplitude of the
# joint, for the posterior mean. The second mode softens too, through the same joint, and both modes
# change their shapes as it slips.

# %%
names = [name for name in posterior if name in truth or name in ("gain", "gain_ratio_2")]
theta = {name: float(posterior[name].mean()) for name in names} | {"sign_2": -1.0}
structure = jbw.structure_of(theta, campaign.laws)
axes = jbw.draw_backbones(structure, np.linspace(0.0, 3e-3, 13))
axes.flat[0].figure

# %% [markdown]
# A title states where one mode meets an odd multiple of another. There the curve belongs to both
# modes, and a test driven there shows it.
