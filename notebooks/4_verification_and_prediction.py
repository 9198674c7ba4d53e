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
# # 4 Verification, validation, prediction
#
# *Does the identified model reproduce the fitted tests, the held-out tests, and tests of another
# kind? And what should be measured next?*
#
# This notebook distinguishes three words. *Verification* compares responses (FRFs, sweeps) of the
# model with the measured ones. *Validation* compares the hysteresis loop, to which nothing was
# fitted directly. *Prediction* concerns tests that the run has not seen. Bands are at 99 %. A
# *parameter band* contains only the uncertainty of the parameters; a *predictive band* also
# contains the noise. Only a predictive band can contain 99 % of the measured samples.

# %%
# %matplotlib inline
import numpy as np
import virtual_rig

import jbw

study = virtual_rig.run()
tree = study.tree

# %% [markdown]
# ## Frequency response functions
#
# Every draw is simulated under the measured input and passed through the same estimator with the
# same window. The window therefore affects model and measurement equally.

# %%
jbw.plots.draw(tree, "figure_11")

# %% [markdown]
# The resonance moves down and broadens with the level, in the model as in the measurement.
# Differences would show in the lowest row, magnitude over the model's median; only noise remains
# there.
#
# ## Sweeps, one level of which was held out
#
# The joint was fitted to half of the repeats at 0.05 V and 0.20 V. The other half, and the level of
# 0.10 V as a whole, are predictions.

# %%
jbw.plots.draw(tree, "figure_12")

# %%
print("test          fitted  coverage of the 99 % band   error    error of the best linear model")
for name, node in tree["verification/sweep"].children.items():
    facts = node.attrs
    print(
        f"{name:13s} {'yes' if facts['fitted'] else 'no':7s} {facts['coverage']:.2%} {'':18s}"
        f"{facts['nrmse']:.3%}   {facts['nrmse_linear']:.1%}"
    )

# %% [markdown]
# The error is that of the median against the mean of the repeats, over the rms of the response; it
# includes the noise of that mean. About 99 % of the samples lie in the band, for the held-out level
# as for the others. The error of the best linear oscillator is at least ten times as large. The
# residual of the median looks alike at all levels: it is the laser's noise.
#
# ## The hysteresis loop
#
# Under a tone near resonance the restoring force follows from the balance (1),
# $F = u - \ddot y - 2\zeta\omega_n\dot y = k y + Z$. That of the model follows from its own $Z$.

# %%
jbw.plots.draw(tree, "figure_13")

# %%
for name, node in tree["validation/loops"].children.items():
    areas = jbw.plots.enclosed_areas(node.to_dataset())
    for label, (low, middle, high) in areas._asdict().items():
        print(f"{name} {label:8s} {1e3 * middle:.4g} [{1e3 * low:.4g}, {1e3 * high:.4g}] mJ/kg")

# %% [markdown]
# The area is the energy lost in the joint per cycle and unit mass. At first it grows with the cube
# of the amplitude, as $\frac{4}{3}\alpha\gamma Y^3$, which makes it a sharp test of $\gamma$.
# Nothing like it was fitted. The ripple on the measured loops at the lower level is noise; the
# lower row is magnified a hundredfold.
#
# ## A test that the run has not seen
#
# The test is a stepped sine at 0.05 V, measured now. `study.predict` takes any test. On the command
# line it is `jbw predict RUN --campaign OTHER.toml`.

# %%
(stepped,) = virtual_rig.measure(["stepped_0p05V"], repeats=2).tests
seen = study.predict(stepped)
print(f"coverage {seen.attrs['coverage']:.1%} of {seen.attrs['num_values']:.0f} values, ", end="")
print(f"error {seen.attrs['nrmse']:.2%}, noise: {seen.attrs['noise']}")
jbw.plots.prediction("stepped sine, 0.05 V", seen)

# %% [markdown]
# Harmonic balance predicts the steady motion of every step. At $\omega$ the measured points lie on
# the curve within a few hundredths of a percent of its peak. At $3\omega$ they show the laser's
# noise except around the resonance.
#
# ## A test that nobody has measured, and how far a prediction reaches

# %%
for level in (0.05, 0.5):
    planned = study.planned_sweep((15.0, 22.0), level, duration=30.0, fs=512.0)
    bands = study.predict(planned)
    low, middle, high = 1e3 * np.asarray(bands.attrs["y_peak"])
    print(f"{level} V: peak {middle:.3f} mm [{low:.3f}, {high:.3f}]", end=", ")
    print(f"{bands.attrs['extrapolation']:.2f} of the largest displacement fitted")
    print(*jbw.warnings_of(bands))
jbw.plots.prediction(planned.name, bands)

# %% [markdown]
# The band at 0.5 V is wider, though still a fraction of a percent, and it means less. No record
# shows that the joint follows (2) beyond the fitted motion. The width of a band concerns the
# parameters and not the validity of the law, so the reach is stated with it.
#
# ## What to measure next
#
# `jbw.plan_tests` selects tests by the information that each would add. Here it starts from this
# run, with a stricter requirement than the run meets and a limit of displacement.

# %%
wish = virtual_rig.folder() / "wish.toml"
wish.write_text(
    """
[plan]
wanted = ["gamma"]
cv = 0.002
max_repeats = 100
max_displacement = 3e-3
joints = 4

[sweep]

[tones]
""",
    encoding="utf-8",
)
plan = jbw.plan_tests(wish, tree)
print(f"known before: CV of gamma {plan.before['gamma'].median:.2%}")
for row in plan.rows[:6]:
    spread = row.cv["gamma"].worst_decile
    print(f"{row.test}, {row.level:.3g} V, peak {1e3 * row.y_peak:.2g} mm: ", end="")
    print(f"repeats {row.repeats or 'beyond 100'}, CV {spread:.2%}, {row.status}")
chosen = plan.combination
print("recommended:", ", ".join(f"{t.repeats} x {t.test}, {t.level:.3g} V" for t in chosen.tests))
print(f"in {chosen.seconds:.0f} s, wish met: {chosen.met}")

# %% [markdown]
# Each row is a candidate with the number of repeats that the requirement needs. The plan counts
# only noise. A joint that changes from day to day is known less well, and only new measurements
# help.
