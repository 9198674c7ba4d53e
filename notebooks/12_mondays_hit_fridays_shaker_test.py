# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # 12 Monday's hit, Friday's shaker test
#
# *On Monday somebody taps a bolted bracket with a hammer. Where will its resonance be on Friday's
# shaker, how high, and what will a random profile do to it?*
#
# The bracket is simulated here, so that Friday can be looked at: one mode at 118 Hz whose joint is
# an Iwan joint of four parameters, 0.8 kg of modal mass. The identification sees one record and the
# mass.

# %%
# %matplotlib inline
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import jbw

jbw.enable_x64()
MASS, FS = 0.8, 2048.0  # [kg], [Hz]
joint = jbw.laws.Iwan4.of_segalman(k_t=1.2e5, f_s=60.0, chi=-0.4, beta=0.3)
bracket = jbw.Oscillator(2 * np.pi * 118.0, 0.002, (joint,))
folder = Path(tempfile.mkdtemp())

# %% [markdown]
# ## Monday: one hit
#
# A half-sine blow of 2 ms, and two seconds of the acceleration with 0.3 % of noise, as a recorder
# writes it.

# %%
t = np.arange(int(2.0 * FS)) / FS
blow = 60.0 * np.where(t < 0.002, np.sin(np.pi * t / 0.002), 0.0)  # [N]
motion = jbw.simulate(bracket, blow / MASS, FS, hold="zero", substeps=8)
acceleration = np.asarray(motion.a) - blow / MASS * 0
rng = np.random.default_rng(0)
acceleration = acceleration + 0.003 * np.std(acceleration) * rng.standard_normal(len(t))
np.savetxt(
    folder / "hit.csv",
    np.column_stack([t, acceleration / 9.80665]),
    delimiter=",",
    header="time [s],acceleration [g]",
    comments="",
)

# %% [markdown]
# One command reads the record, chooses the law by its readings and fits it.

# %%
command = ["identify", "hit.csv", "--quick", "--mass", str(MASS), "--out", "hit-run"]
answer = subprocess.run(
    [sys.executable, "-m", "jbw", *command], cwd=folder, capture_output=True, text=True, check=False
)
print(answer.stdout)
