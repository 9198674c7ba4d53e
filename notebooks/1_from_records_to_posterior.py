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
# # From vibration records to a joint model, step by step
#
# How stiff is a bolted joint, and what does it dissipate, when it is shaken hard? This notebook
# takes the virtual test rig (the paper's cantilever) through the four steps of the procedure, one
# function call each. Your own records enter by `jbw.load_campaign` instead.

# %%
import matplotlib.pyplot as plt
import numpy as np

import jbw
from jbw import rig

jbw.enable_x64()
campaign = rig.measure(
    tests=["noise_0p005V", "tone_5p00Hz", "tone_6p00Hz", "tone_6p75Hz", "sweep_0p20V"], repeats=4
)
tests = {test.name: test for test in campaign.tests}
truth = rig.TRUTH

# %% [markdown]
# ## Step 2: the linear regime
#
# At 5 mV the joint sticks. The line fit reads natural frequency, damping and gain off the FRF; the
# window's smearing is part of the fitted model: even a short window does not inflate the damping.

# %%
noise = tests["noise_0p005V"].records[0]
frf = jbw.frf(noise.channels["input"], noise.channels["velocity"], noise.fs, response="velocity")
line = jbw.line_fit(frf, band=(17.0, 20.5))
for name, value, std in zip(("omega_n", "zeta", "gain"), line.theta, line.std, strict=True):
    print(f"{name:8s} {value:.6g} +- {std:.2g}")

# %%
near = (frf.freq > 16) & (frf.freq < 21.5)
fig, ax = plt.subplots()
model = line.gain * np.abs(jbw.h1(2 * np.pi * frf.freq[near], line.omega_n, line.zeta))
ax.semilogy(frf.freq[near], np.abs(frf.h[near]), ".", ms=3, label="measured")
ax.semilogy(frf.freq[near], model, label="line fit")
ax.set(xlabel="frequency [Hz]", ylabel="receptance [m/V]")
ax.legend()
# %% [markdown]
# ## Step 3: the third-order kernel
#
# A tone near a third of the resonance lets the joint's own third harmonic ring. The measured kernel
# against the paper's closed form (31) at the *true* parameters: even without noise the closed form
# is off, in modulus and above all in phase, for it has no gamma.

# %%
joint = truth
for name in ("tone_5p00Hz", "tone_6p00Hz", "tone_6p75Hz"):
    test = tests[name]
    omega = 2 * np.pi * test.tones_hz[0]
    u = line.gain * np.stack([record.channels["input"] for record in test.records])
    v = np.stack([record.channels["velocity"] for record in test.records])
    measured = jbw.third_order_kernel(
        u, v, test.records[0].fs, omega, response="velocity",
        h1_3omega=complex(jbw.h1(3 * omega, line.omega_n, line.zeta)),
    )  # fmt: skip
    printed = jbw.h3(joint, omega, measured.y_peak.mean(), variant="printed")
    ratio = measured.h3.mean() / complex(printed)
    print(f"{name}: measured / printed = {abs(ratio):.3f}, {np.degrees(np.angle(ratio)):+.1f} deg")

# %% [markdown]
# ## Step 4: the sweep
#
# A strong sweep drives the joint through all of its hysteresis. The response at the true parameters
# under the *measured* input differs from the record by the laser's noise, and by nothing else.

# %%
sweep = tests["sweep_0p20V"].records[0]
model = jbw.simulate(
    joint, 15.0 * sweep.channels["input"], sweep.fs, hold="band_limited", substeps=2
)
left = sweep.channels["velocity"] - np.asarray(model.v)
print(f"rms of velocity {np.std(model.v):.3f} m/s, of what is left {1e6 * np.std(left):.1f} um/s")

# %%
fig, axes = plt.subplots(1, 2, figsize=(9, 3.5))
axes[0].plot(np.asarray(model.t), sweep.channels["velocity"], lw=0.4)
axes[0].set(xlabel="time [s]", ylabel="velocity [m/s]")
part = slice(3500, 4200)
force = np.asarray(joint.k * model.y + model.z)[part]
axes[1].plot(1e3 * np.asarray(model.y)[part], force, lw=0.6)
axes[1].set(xlabel="displacement [mm]", ylabel="restoring force [N/kg]")
fig.tight_layout()

# %% [markdown]
# ## All of it at once
#
# `jbw.identify(campaign)` runs these steps, the paper's chains, the joint posterior of all
# parameters from the sweeps, the verification of FRFs and sweeps and the validation of loops, and
# judges the result. `jbw demo` does it on the whole campaign of the rig.
