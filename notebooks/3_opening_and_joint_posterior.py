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
# # 3 The opening of the loop, and all parameters together
#
# *Steps 2 and 3 assume a closed loop. What does a strong sweep determine about its opening
# $\gamma$, and what if no parameter is held?*
#
# Step 4 of the paper takes the velocity $v(t)$ of sweeps up to strong hysteresis and infers only
# $\gamma$. The other parameters are held at the means of Steps 2 and 3 (a *cut*: the sweeps may not
# correct them):
#
# $$\log p(v \mid \gamma) = -N\log\sigma - \frac{1}{2\sigma^2}\sum_t |v(t) - \hat v(t; \gamma)|^2
# \tag{37}$$
#
# The alternative needs no further measurement. It uses the same sweeps and the noise records, with
# $\omega_n, \zeta, \alpha, \delta, \gamma$ and the gain all free. `jbw.identify` does both.

# %%
# %matplotlib inline
from dataclasses import replace

import arviz as az
import matplotlib.pyplot as plt
import numpy as np
import virtual_rig

import jbw
from jbw import rig

campaign = virtual_rig.campaign()
tests = {test.name: test for test in campaign.tests}

# %% [markdown]
# ## Before any sampling: what can the data determine?
#
# `jbw.identifiability` fits the joint and compares the information in the data with that in the
# prior. The first run uses only the noise tests, whose vibration is small; the second uses the
# whole campaign.

# %%
noise = replace(campaign, tests=tuple(t for t in campaign.tests if t.kind == "noise"))
for label, some in (("noise alone", noise), ("whole campaign", campaign)):
    found = jbw.identifiability(some)
    print(f"{label}:")
    for sentence in found.statements:
        print("  ", sentence)

# %% [markdown]
# The noise tests determine $\omega_n$, $\zeta$ and the gain, and add nothing to the prior of the
# joint. A small vibration determines at best the products $\alpha\delta$ and $\alpha\gamma$, to
# leading order. Strong sweeps ($\delta Y$ of the order of one) separate the factors.
#
# ## The run
#
# `virtual_rig.run()` calls `study = jbw.identify(campaign)` and `study.save(folder)` once, and
# reads the saved `posterior.nc`. This is a tree of ArviZ's groups with the joint posterior at its
# root and the paper's steps under `steps`.

# %%
tree = virtual_rig.run().tree
names = ["omega_n", "zeta", "alpha", "delta", "gamma", "gain"]
az.summary(tree, var_names=names, ci_prob=0.99, round_to="6g")

# %% [markdown]
# ## Gamma alone, and what the cut costs

# %%
jbw.plots.draw(tree, "figure_10")

# %%
joint = tree["posterior"].to_dataset()
cut = tree["steps/opening_nuts/posterior"].to_dataset()
for label, draws in (("gamma alone (cut)", cut), ("all together", joint)):
    mean, std = float(draws["gamma"].mean()), float(draws["gamma"].std())
    off = abs(mean - rig.TRUTH.gamma)
    print(f"{label:18s} {mean:7.4f} +- {std:.4f} 1/m, off by {off:.3f} = {off / std:.3g} std")

# %% [markdown]
# The result of the cut is many of its own standard deviations away from the truth. It is narrow
# *because* it is conditional. It excludes the errors of Step 3, which are larger, and $\gamma$
# alone has to compensate for them. The next cell shows how little it can.

# %%
sweep = tests["sweep_0p20V"].records[0]
third = tree["steps/third_order_nuts/posterior"].to_dataset()
linear = tree["steps/linear"].attrs
means = {
    "by the cut": {
        "omega_n": linear["pooled_omega_n"],
        "gain": linear["pooled_gain"],
        **{name: float(third[name].mean()) for name in ("zeta", "alpha", "delta")},
        "gamma": float(cut["gamma"].mean()),
    },
    "all together": {name: float(joint[name].mean()) for name in names},
}
left = {}
for label, mean in means.items():
    gain = mean.pop("gain")
    model = jbw.simulate(
        jbw.BoucWen(**mean), gain * sweep.channels["input"], sweep.fs,
        hold="band_limited", substeps=2,
    )  # fmt: skip
    left[label] = sweep.channels["velocity"] - np.asarray(model.v)
    print(f"{label:13s} leaves {np.std(left[label]) / np.std(sweep.channels['velocity']):.2%} rms")
print(f"laser noise        {virtual_rig.LASER_NOISE / np.std(sweep.channels['velocity']):.2%}")

# %%
fig, (upper, lower) = plt.subplots(2, 1, figsize=(7, 4), sharex=True, layout="constrained")
time = np.arange(sweep.num_samples) / sweep.fs
upper.plot(time, sweep.channels["velocity"], color="0.4", lw=0.4)
upper.set(ylabel="measured [m/s]")
for (label, rest), colour in zip(left.items(), ("C1", "C0"), strict=True):
    lower.plot(time, rest, color=colour, lw=0.6, label=label)
lower.set(xlabel="time [s]", ylabel="left by the model [m/s]")
lower.legend(loc="upper right")

# %% [markdown]
# The residual of the cut in the strongest sweep is several times the noise and looks like the
# response: its parameters are wrong together. With everything free, only the laser's noise remains.
#
# ## The joint posterior compared with the paper's route

# %%
jbw.plots.draw(tree, "routes")

# %%
jbw.plots.draw(tree, "ridge")

# %%
jbw.plots.draw(tree, "trace_rank")

# %% [markdown]
# With the joint route every interval contains the truth, and the ridge of Step 3 has shrunk to a
# small ellipse. $\alpha$ and $\delta$ are still correlated, but only within a percent or so. The
# chains look alike and their ranks are even.
#
# ## After sampling

# %%
jbw.plots.draw(tree, "identifiability")

# %%
for name in ("zeta", "alpha", "delta", "gamma", "alpha_delta", "alpha_gamma"):
    print(f"{name:12s} CV {float(joint[name].std() / joint[name].mean()):.2%}")

# %% [markdown]
# The circles come from the derivatives of the fit, before any draw was made; the dots are the
# draws. They agree, so the posterior is nearly Gaussian. `jbw.identifiability` alone would have
# shown within seconds what this campaign can determine. Here, too, the products are known better
# than their factors.
