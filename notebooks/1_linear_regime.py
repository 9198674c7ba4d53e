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
# # 1 The linear regime
#
# *What are the natural frequency and the damping of the structure while its joint sticks, and how
# small must a vibration be for this question to have an answer?*
#
# Notebooks 1 to 4 follow the steps of the paper (Teloli et al., *Bayesian model identification of
# higher-order frequency response functions for structures assembled by bolted joints*) on a virtual
# test rig. The rig is the paper's cantilever with a known joint, recorded by a noisy laser. Step 1
# is the measurement itself; this notebook shows Step 2. To use your own records, call
# `jbw.load_campaign` instead.
#
# Per unit of modal mass the model is
#
# $$\ddot y + 2\zeta\omega_n\dot y + (\omega_n^2 - \alpha)\,y + Z = u \tag{1}$$
# $$\frac{\mathrm{d}Z}{\mathrm{d}y} =
#   \alpha - \gamma\,\mathrm{sgn}(\dot y)\,Z - \delta\,|Z| \tag{2}$$
#
# While $Z$ is small, (2) is $Z = \alpha y$, and (1) is a linear oscillator of natural frequency
# $\omega_n$ and damping ratio $\zeta$.

# %%
# %matplotlib inline
import matplotlib.pyplot as plt
import numpy as np
import virtual_rig

import jbw
from jbw import rig

campaign = virtual_rig.campaign()
tests = {test.name: test for test in campaign.tests}
for test in campaign.tests:
    record = test.records[0]
    seconds = record.num_samples / record.fs
    print(f"{test.name:14s} {test.kind:6s} {test.level:5g} V  {len(test.records)} x {seconds:g} s")

# %% [markdown]
# ## The frequency response and its coherence
#
# The receptance is estimated by $H_1 = S_{uy}/S_{uu}$ over windows of 8 s, a usual choice in a
# laboratory. The velocity is divided by $\mathrm{j}\omega$. The time factor is
# $\exp(+\mathrm{j}\omega t)$, so the phase falls through $-90°$ at the resonance.

# %%
noise = tests["noise_0p005V"]
fs = noise.records[0].fs
u = np.stack([record.channels["input"] for record in noise.records])
v = np.stack([record.channels["velocity"] for record in noise.records])
wide = {"response": "velocity", "band": (10.0, 30.0)}
frf = jbw.frf(u, v, fs, window_s=8.0, **wide)
print(f"{frf.num_averages:.0f} independent averages, a line every {1 / frf.window_s:g} Hz")

# %%
fig, (left, middle, right) = plt.subplots(1, 3, figsize=(10, 3), layout="constrained")
left.semilogy(frf.freq, np.abs(frf.h))
left.set(ylabel="receptance [m/V]")
middle.plot(frf.freq, np.degrees(np.angle(1j * frf.h)) - 90.0)  # from -270 to 90, no jump at -180
middle.set(ylabel="phase [°]", yticks=[-180, -90, 0])
right.plot(frf.freq, frf.coherence)
right.set(ylabel="coherence [-]", ylim=(0.0, 1.05))
for ax in (left, middle, right):
    ax.set(xlabel="frequency [Hz]")

# %% [markdown]
# The figure shows one mode. The coherence is high around it, falls where the laser records mainly
# its own noise, and dips at the resonance. Neither the joint nor the laser causes the dip. The
# window is too short for so narrow a peak, and the leakage between the lines is not coherent. The
# leakage also makes the damping wrong, as the next cell shows.
#
# ## The line fit, and what the window does to it
#
# The line fit compares
#
# $$H(\omega) = \frac{g}{\omega_n^2 - \omega^2 + 2\mathrm{j}\zeta\omega_n\omega} \tag{23}$$
#
# with the estimate by weighted least squares (38). Under random input a Hann window $w$ smears the
# peak: $H_1$ tends to $\int H(\omega')\,|W(\omega-\omega')|^2\,\mathrm{d}\omega'$, however long you
# average. `line_fit` therefore compares the *smeared* model. `smear=False` compares (23) itself, as
# a plain curve fit does.

# %%
windows = (4.0, 8.0, 16.0, 32.0, 64.0)
fits = {smear: [] for smear in (False, True)}
for window_s in windows:
    one = jbw.frf(u, v, fs, window_s=window_s, **wide)
    for smear, found in fits.items():
        found.append(jbw.line_fit(one, band=(17.0, 20.5), smear=smear))

print("window   zeta by (23)   zeta by the smeared (23)")
for window_s, plain, smeared in zip(windows, fits[False], fits[True], strict=True):
    print(f"{window_s:4g} s     {plain.zeta:.3%}       {smeared.zeta:.3%} +- {smeared.std[1]:.3%}")
print(f"truth    {rig.TRUTH.zeta:.3%}")

# %%
fig, ax = plt.subplots(figsize=(5, 3), layout="constrained")
for smear, label, marker in ((False, "(23) itself", "o"), (True, "(23) smeared", "s")):
    zeta, std = (100 * np.array([getattr(f, key) for f in fits[smear]]) for key in ("zeta", "std"))
    ax.errorbar(windows, zeta, 2.58 * std[:, 1], fmt=marker, capsize=3, label=label)
ax.axhline(100 * rig.TRUTH.zeta, color="k", lw=0.8, label="truth")
ax.set(xscale="log", xlabel="window [s]", ylabel=r"damping ratio $\zeta$ [%]")
ax.set_xticks(windows, [f"{w:g}" for w in windows])
ax.minorticks_off()
ax.legend()

# %% [markdown]
# The plain fit reads the window as damping: about a third too much with 8 s, nearly twice with 4 s.
# Its 99 % bars do not contain this error. The smeared fit is correct with every window; a short
# window only widens its bars. You may therefore choose the window for many averages instead of high
# resolution.
#
# ## Repeat by repeat
#
# The paper gives the coefficient of variation (CV) over repeats. `pool` also compares the variation
# with the one expected from the errors of the single fits (a ratio of variances).

# %%
each = [
    jbw.line_fit(jbw.frf(one_u, one_v, fs, window_s=16.0, **wide), band=(17.0, 20.5))
    for one_u, one_v in zip(u, v, strict=True)
]
pooled = jbw.pool(each)
std = np.sqrt(np.diag(pooled.covariance))
print("          mean       std        CV        scatter / promise        truth")
for i, name in enumerate(("omega_n", "zeta", "gain")):
    print(
        f"{name:8s}  {pooled.mean[i]:<9.6g}  {std[i]:<9.2g}  {pooled.cv[i]:<9.2g} "
        f"{pooled.scatter_ratio[i]:6.2f} (p = {pooled.scatter_p[i]:.2f})"
        f"{virtual_rig.TRUTH[name]:>12.6g}"
    )

# %% [markdown]
# The repeats of one assembly vary no more than their noise predicts; p is the probability of such a
# ratio or a larger one. Now the joint is taken apart and bolted together again before every record,
# which moves $\omega_n$ by 0.18 %, the value in the paper.

# %%
days = virtual_rig.measure(["noise_0p005V"], omega_n_cv=0.0018, seed=1)
reassembled = jbw.pool(
    [
        jbw.line_fit(
            jbw.frf(*(day.records[0].channels[c] for c in ("input", "velocity")), fs, **wide),
            band=(17.0, 20.5),
        )
        for day in days.tests
    ]
)
print(f"CV of omega_n      {pooled.cv[0]:.2g} before, {reassembled.cv[0]:.2g} reassembled")
print(f"scatter / promise  {pooled.scatter_ratio[0]:.2g} before, ", end="")
print(f"{reassembled.scatter_ratio[0]:.2g} reassembled")

# %% [markdown]
# Such a large ratio shows that the assemblies differ, and by how much. A CV alone cannot
# distinguish this from noise. A campaign file states `assembly = "..."` for each such test, and the
# identification then gives every assembly its own $\omega_n$ and $\zeta$.
#
# ## What "linear" means at 0.005 V
#
# A Bouc-Wen joint has no threshold: (2) softens and dissipates at every amplitude, to first order
#
# $$\frac{\Delta\omega}{\omega_n} = -\frac{2}{3\pi}\,\frac{\alpha\delta}{\omega_n^2}\,Y, \qquad
#   \Delta\zeta = \frac{2}{3\pi}\,\frac{\alpha\gamma}{\omega_n^2}\,Y .$$
#
# `backbone` computes both without the series. A narrow-band random vibration of standard deviation
# $\sigma$ softens the joint as much as a steady one of amplitude
# $Y = \frac{3}{4}\sqrt{2\pi}\,\sigma = 1.88\,\sigma$ (statistical linearisation of a force that
# grows as $y\,|y|$). Is the vibration at 0.005 V small enough?

# %%
joint = rig.TRUTH
y_peak = np.geomspace(1e-6, 5e-3, 200)
curve = jbw.backbone(joint, y_peak)
shift_hz = np.asarray(curve.omega - joint.omega_n) / (2 * np.pi)
levels = {}
for name in ("noise_0p005V", "noise_0p05V"):
    records = tests[name].records
    v_rms = np.std([record.channels["velocity"] for record in records])
    levels[name] = 0.75 * np.sqrt(2 * np.pi) * v_rms / joint.omega_n

# %%
fig, axes = plt.subplots(1, 2, figsize=(8.5, 3), layout="constrained")
axes[0].semilogx(1e3 * y_peak, shift_hz)
axes[0].set(ylabel="frequency less $f_n$ [Hz]")
axes[1].semilogx(1e3 * y_peak, 100 * np.asarray(curve.zeta))
axes[1].set(ylabel="equivalent damping ratio [%]")
for ax in axes:
    ax.set(xlabel="amplitude [mm]")
    for (name, y), colour in zip(levels.items(), ("C2", "C1"), strict=True):
        ax.axvline(1e3 * y, color=colour, ls="--", lw=1, label=tests[name].name)
axes[0].legend()

# %%
for name, y in levels.items():
    records = tests[name].records
    one_u, one_v = (np.stack([r.channels[role] for r in records]) for role in ("input", "velocity"))
    fit = jbw.line_fit(jbw.frf(one_u, one_v, fs, **wide), band=(17.0, 20.5))
    expected = np.interp(y, y_peak, shift_hz)
    seen = (fit.omega_n - joint.omega_n) / (2 * np.pi)
    print(
        f"{name:12s} amplitude {1e6 * y:5.1f} um: expected {1e3 * expected:+6.2f} mHz, fitted "
        f"{1e3 * seen:+6.2f} +- {1e3 * fit.std[0] / (2 * np.pi):.2f} mHz; "
        f"zeta {fit.zeta:.4%} +- {fit.std[1]:.4%}"
    )

# %% [markdown]
# The joint softens at both levels as the backbone predicts: by about 1 mHz at 0.005 V, and ten
# times as much at 0.05 V. Even the smaller shift exceeds its error. "Linear" therefore describes
# the length of the record and the laser, not the joint. Step 2 takes the frequency at about 30
# micrometres as $\omega_n$, and its standard error does not contain the difference. This does no
# harm in Step 3, which uses only $H_1(3\omega)$ from here. The joint posterior of notebook 3 does
# not use the approximation. It also includes the noise records, with the softening and damping of
# the joint at their amplitude.
