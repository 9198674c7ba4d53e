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
# # 11 Two bolts told apart
#
# *A finite-element model states where the bolts are. Which of them damps which mode?*
#
# Two bolts hold two lapped beams together. The matrices of the model describe the beams. Each bolt
# adds its stiffness when fully stuck, and slips by its own law. The only measurements are sweeps at
# one point of the structure, with a measured force.

# %%
# %matplotlib inline
import tempfile
from pathlib import Path

import numpy as np
import scipy.io

import jbw

jbw.enable_x64()
beams = jbw.rig.lapped_beams()
print(beams.model)

# %% [markdown]
# ## Before any test
#
# The model is reduced to its modes with the joints fully stuck. Residual modes keep the static
# flexibility of the joints and of the input. The energy share of a joint in a mode bounds its
# effect on that mode. The matrix B shows which joints the swept modes separate.

# %%
reduced = beams.reduced(to_hz=400.0)
print(reduced)
print("energy shares [%]:", (100 * jbw.energy_shares(reduced)[:, :2]).round(2).tolist())
print(jbw.joint_separability(reduced, modes=(0,)))
print(jbw.joint_separability(reduced, modes=(0, 1)))

# %% [markdown]
# The first mode moves both bolts equally: alone it determines their sum. The second mode moves only
# the second bolt, although that bolt holds only three per cent of its energy. You must sweep both
# modes.
#
# ## The measurement
#
# The structure is simulated with all modes to 1000 Hz, whereas the identification uses those to 400
# Hz. The third mode, which no test drives, responds to harmonics of the second. The bolts differ:
# the second is stiffer and loses more energy. One per cent of noise is added.

# %%
FS, SECONDS = 1024.0, 1.0
SWEEPS = {"first": ((25.0, 40.0), (0.2, 0.5, 1.0)), "second": ((75.0, 100.0), (0.4, 0.9, 2.0))}
truth = {
    "alpha@bolt_1": 6e6, "delta@bolt_1": 3e5, "gamma@bolt_1": 4e4,
    "alpha@bolt_2": 9e6, "delta@bolt_2": 2e5, "gamma@bolt_2": 6e4,
}  # fmt: skip
bolts = [
    jbw.BoucWen(1.0, 0.0, *(truth[f"{name}@{bolt}"] for name in ("alpha", "delta", "gamma"))).laws[
        0
    ]
    for bolt in ("bolt_1", "bolt_2")
]
fine = beams.with_laws(*bolts).reduced(to_hz=1000.0).structure()
folder = Path(tempfile.mkdtemp())
rng = np.random.default_rng(0)
time = np.arange(int(SECONDS * FS)) / FS
window = np.clip(time / 0.1, 0, 1) * np.clip((SECONDS - time) / 0.3, 0, 1)
tests = []
for mode, ((start, stop), forces) in SWEEPS.items():
    for force in forces:
        phase = 2 * np.pi * (start * time + (stop - start) * time**2 / (2 * SECONDS))
        u = force * np.sin(0.5 * np.pi * window) ** 2 * np.sin(phase)
        v = np.asarray(jbw.simulate(fine, u, FS, hold="band_limited", substeps=64).v)
        v = v + 0.01 * np.std(v) * rng.standard_normal(len(v))
        name = f"{mode}_{force:g}N"
        np.savez(folder / f"{name}.npz", force=u, velocity=v)
        tests.append((name, force))

# %% [markdown]
# ## The campaign file
#
# The file states the matrices, the units, the places of the input, of the laser and of the bolts,
# and the tests. The middle level of each mode is held out.

# %%
dofs = np.array([str(dof) for dof in beams.model.dofs], dtype=object)[:, None]
scipy.io.savemat(
    folder / "beams.mat", {"M": beams.model.mass, "K": beams.model.stiffness, "dofs": dofs}
)
text = """[campaign]
name = "two bolts"

[structure]
matrices = "beams.mat"
units = "SI"
to_hz = 400.0
damping = 0.004
input = "1:z"
points = { tip = "105:z" }

[identify]
offsets = "none"
hold_out = ["first_0.5N", "second_0.9N"]
"""
for joint in beams.joints:
    places = ", ".join(f'"{dof}" = {factor}' for dof, factor in dict(joint.weights).items())
    text += f"""
[[joint]]
name = "{joint.name}"
weights = {{ {places} }}
stiffness = {joint.stiffness}
"""
for name, force in tests:
    text += f"""
[[test]]
name = "{name}"
kind = "sweep"
files = "{name}.npz"
channels = {{ force = "force", velocity = "velocity" }}
units = {{ force = "N", velocity = "m/s" }}
fs = {FS}
level = {force}
"""
(folder / "campaign.toml").write_text(text)
print(text[: text.index("[[test]]")])

# %% [markdown]
# ## Which bolt damps which mode

# %%
campaign = jbw.load_campaign(folder / "campaign.toml")
study = jbw.identify(campaign, seed=1)
print(study)

# %% [markdown]
# Every parameter of each bolt, with the true values of the rig:

# %%
posterior = study.tree["posterior"].to_dataset()
for name, value in truth.items():
    low, high = np.quantile(posterior[name], [0.005, 0.995])
    print(f"{name:>13}: {value:8.4g} in [{low:.4g}, {high:.4g}]: {low < value < high}")

# %% [markdown]
# Mode 2 is damped by bolt 2. The next cell shows the held-out sweeps:

# %%
for name in campaign.settings.hold_out:
    found = study.tree[f"verification/sweep/{name}"].attrs
    print(
        f"{name}: missed by {found['nrmse']:.2%} of its rms, "
        f"{found['coverage']:.1%} of the values in the 99 % band"
    )

# %% [markdown]
# ## Backbones
#
# The figure shows frequency and damping of both modes against the modal amplitude, for the model
# with the posterior mean of the bolts. It also shows the second bolt's share of the losses.

# %%
import matplotlib.pyplot as plt

mean = {name: float(posterior[name].mean()) for name in truth}
identified = [
    jbw.BoucWen(1.0, 0.0, *(mean[f"{name}@{bolt}"] for name in ("alpha", "delta", "gamma"))).laws[0]
    for bolt in ("bolt_1", "bolt_2")
]
structure = beams.with_laws(*identified).reduced(to_hz=400.0).structure()
amplitude = np.linspace(1e-5, 2.5e-4, 25)
figure, axes = plt.subplots(3, 2, sharex=True, figsize=(8, 6), layout="constrained")
for mode, column in enumerate(axes.T):
    curve = jbw.backbone(structure, amplitude, mode=mode)
    rows = curve.omega / (2 * np.pi), 100 * curve.zeta, 100 * curve.loss_share[:, 1]
    for ax, values in zip(column, rows, strict=True):
        ax.plot(1e3 * amplitude, values)
    column[0].set_title(f"mode {mode + 1}")
    column[2].set(xlabel="modal amplitude [10⁻³ m √kg]", ylim=(0, 105))
for ax, label in zip(
    axes[:, 0], ("frequency [Hz]", "damping ratio [%]", "losses of bolt 2 [%]"), strict=True
):
    ax.set_ylabel(label)
plt.show()

# %% [markdown]
# Both modes soften as the bolts slip. Their damping grows many times in the first mode and by half
# in the second. Both bolts damp the first mode; bolt 2 alone damps the second.
