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
# # 7 One joint under every law
#
# *Which law fits the measurements, how certain is the choice, and what do they not determine?*
#
# The virtual rig is built with an Iwan joint: many small sliders, of which a few slip at the
# smallest motion and all at macroslip. It integrates three hundred sliders with separate code; the
# laws below were not used for the records. A controller holds the displacement at seven levels and
# steps through the resonance, as laboratories do with a beam on a shaker.

# %%
# %matplotlib inline
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import virtual_rig

import jbw
from jbw import rig

iwan = jbw.laws.Iwan4.of_segalman(k_t=1500.0, f_s=3.0, chi=-0.3, beta=0.5)
joint = jbw.Oscillator(118.0, 0.004, (iwan,))
macroslip = float(iwan.phi_max)
print(f"macroslip at {1e3 * macroslip:.2f} mm")

LEVELS = (0.1e-3, 0.2e-3, 0.4e-3, 0.8e-3, 1.6e-3, 2.4e-3, 3.2e-3, 4.8e-3)  # m
FREQ_HZ = tuple(np.arange(16.5, 19.5, 0.1))
plans = tuple(
    rig.Plan(f"held_{1e3 * level:.1f}mm", "frf", rig.Held(FREQ_HZ, level, dwell=4.0), repeats=3)
    for level in LEVELS
)
preset = replace(rig.MIXED, name="every law", plans=plans)
measured = rig.measure(preset, joint=joint, force_noise_std=0.05)
campaign = replace(measured, settings={"hold_out": [plans[-1].name]})

# %% [markdown]
# The highest level, beyond macroslip, is held out. The figure first shows each law alone: the loop
# at 2 mm and the frequency against amplitude, with parameters that make the laws comparable. Each
# law is selected by its name, and has closed forms or exact steps.

# %%
THETA = {
    "bouc_wen": {"alpha": 900.0, "delta": 150.0, "gamma": 120.0},
    "bouc_wen_nu": {
        "nu_stiffness": 900.0, "nu_softening": 0.17, "nu_opening": 0.15, "nu": 0.7
    },
    "iwan4": iwan.parameters(),
    "masing_power": {"power_loss": 200.0, "power_exponent": 0.7},
    "jenkins_1": {"stiffness_1": 900.0, "slip_1": 1.5e-3},
    "cubic": {"cubic": -4e7},
    "quadratic": {"quadratic": -1.5e5},
}  # fmt: skip

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4))
amplitude = np.linspace(1e-5, 4e-3, 200)
path = 2e-3 * np.sin(np.linspace(0, 4.5 * np.pi, 900))
for name, theta in THETA.items():
    law = jbw.laws.law_named(name).of(theta)
    one = jbw.Oscillator(118.0, 0.004, (law,))
    force = one.force_along(path) - one.k * path
    stuck = float(law.stiffness())
    left.plot(1e3 * path[450:], (force - stuck * path)[450:], label=name)
    curve = jbw.backbone(one, amplitude)
    right.plot(1e3 * amplitude, curve.omega / (2 * np.pi), label=name)
left.set(xlabel="displacement [mm]", ylabel="force less the linear spring's [N/kg]")
right.set(xlabel="amplitude [mm]", ylabel="natural frequency [Hz]")
right.legend()
figure.tight_layout()
plt.show()

# %% [markdown]
# ## Before any law
#
# Frequency and damping against amplitude follow from the held curves without a law. Their exponents
# and the ratio of damping to softening sort the families of laws: for sliders, whatever their
# number, the exponent determines the ratio.
#
# ## All laws on the same data
#
# Each law is fitted to the same values with the same weights. Each run is left out in turn and
# predicted from the others. A difference of log scores has a standard error. If the data cannot
# separate two laws, the table says so: a rank alone is no answer.

# %%
found = jbw.compare_laws(
    campaign,
    ["linear", "cubic", "bouc_wen", "bouc_wen_nu", "jenkins_1", "masing_power", "iwan4"],
    report=lambda said: None,
)
virtual_rig.print_laws(found.record)
for sentence in found.record["statements"]:
    print("-", sentence)

# %%
jbw.plots.laws(found.tree)

# %% [markdown]
# The data do not separate the power law and Iwan: the fitted levels end just below macroslip, where
# the two are the same. They do exclude Bouc-Wen, whose exponent is one, and a single slider.
#
# For the Iwan law, weak motion determines the loss of stiffness and its exponent. The stiffness of
# all sliders and beta would show only beyond macroslip, and are not determined. The table also
# gives the true values:

# %%
truth = measured.truth["joint"]
for name, row in found.record["laws"]["iwan4"]["parameters"].items():
    known = truth.get(name, preset.gain)
    print(f"{name:16s} {row['mean']:9.4g} +- {row['sd']:.2g}   truth {known:.4g}")

# %% [markdown]
# ## A level that no law has seen
#
# All laws predict it together, each by its weight. No test shows that a joint follows its law
# beyond the largest fitted motion, and the prediction states how far beyond it reaches.

# %%
seen = {test.name: test for test in measured.tests}
for name in (plans[-2].name, plans[-1].name):
    one = found.predict(seen[name])
    print(
        f"{name}: error {100 * one.attrs['nrmse']:.2g} %, "
        f"{one.attrs.get('extrapolation', float('nan')):.2g} of the largest fitted motion"
    )

# %% [markdown]
# At the highest level the joint slips as a whole, which no lower level shows. The mixture consists
# mainly of a power law that never slips, and it is wrong by a tenth. It warns beforehand that the
# requested motion is half as large again as all fitted motions. The data determine a law only for
# motions that they contain.
