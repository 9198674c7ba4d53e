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
# # 5 Real bolted joints: which law, and how sure
#
# *What do measurements of joints that no one has built from an equation ask for?*
#
# Two published measurements, each with its campaign file in `campaigns`: free decays of a double
# beam with three bolts (Cenedese et al., *Phil. Trans. R. Soc. A* 380, 2022), and response curves
# of the Brake-Reuss beam, two half-beams joined by three bolts (Chen et al., *Mech. Syst. Signal
# Process.* 166, 2022). The data are not part of this repository: the campaign files say where they
# are to be had. Set JBW_DATA to the folder that holds them; without it the cells below do nothing.

# %%
# %matplotlib inline
import os
from pathlib import Path

import matplotlib.pyplot as plt
import virtual_rig
from IPython.display import display

import jbw
from jbw.cli.laws import laws_table
from jbw.cli.printing import show
from jbw.report import figures
from jbw.report.laws import laws_figure
from jbw.report.result import read_result

DATA = os.environ.get("JBW_DATA", "")


def campaign_of(name):
    """A campaign of this folder, or None without the data."""
    if not DATA:
        print("Skipped: JBW_DATA is not set, so there are no records.")
        return None
    return jbw.load_campaign(Path("campaigns", f"{name}.toml"), allow_outside=True)


def compared(name, laws):
    """Laws side by side: their table, what it says in words, and the figure."""
    campaign = campaign_of(name)
    if campaign is None:
        return
    found = jbw.compare_laws(campaign, laws, report=lambda said: None)
    show(laws_table(found.record))
    for sentence in found.record["statements"]:
        print("-", sentence)
    laws_figure(found.tree)
    plt.show()


def identified(name, *shown):
    """A campaign's run, made on the first call: its parameters, its verdict, and some figures."""
    campaign = campaign_of(name)
    if campaign is None:
        return
    place = virtual_rig.folder() / name
    if not (place / "summary.json").exists():
        jbw.identify(campaign).save(place)
    summary, tree = read_result(place)
    for row_name, row in summary["steps"]["joint"]["parameters"].items():
        print(
            f"{row_name:14s} {row['mean']:.5g} [{row['q005']:.5g}, {row['q995']:.5g}] {row['unit']}"
        )
    print("verdict:", summary["verdict"]["status"])
    for finding in summary["verdict"]["findings"]:
        if finding["status"] != "ok":
            print("-", finding["reason"], finding["action"])
    for figure in shown:
        display(figures.figure_of(figures.FIGURES[figure](tree)))


# %% [markdown]
# ## Free decays of a double beam
#
# No force was measured: hammer impacts at three positions, three each, velocity of the tip by a
# laser vibrometer. The records are filtered to the first mode near 122 Hz, and the model passes
# through the same filter. The impacts at the third position are held out. Without a force there is
# no gain; a decay tells frequency and damping against amplitude.

# %%
identified("bolted_double_beam", "amplitude", "decay")

# %% [markdown]
# Frequency falls and damping rises with the amplitude, both nearly along straight lines, as (2)
# has it at small $\delta Y$: the slopes are $\alpha\delta$ and $\alpha\gamma$ over $\omega_n^2$.
# These two, $\omega_n$ and $\zeta$ are what decays tell; $\alpha$, $\delta$ and $\gamma$ by
# themselves follow the prior of the joint's share of the stiffness, and the run says so.
#
# Before any law, what the decays say by themselves: the ratio of what damps to what softens is 0.27
# where sliders of that exponent have 0.45. No cloud of sliders does this by itself: 40 % of the
# softening is elastic. Bouc-Wen's law has the freedom, as $\gamma/\delta$; a law of Masing's kind
# needs a softening spring beside it.
#
# ## Response curves of the Brake-Reuss beam
#
# A controller held the acceleration at eight levels while the frequency was stepped through the
# first bending mode near 80 Hz; the force varies along each curve. The beam softens up to 40 m/s²
# and stiffens above, which no joint of one law can do. Laws side by side, alone and with a cubic
# spring, on all levels but one:

# %%
compared(
    "brake_reuss_all",
    ["linear", "cubic", "bouc_wen", "bouc_wen + cubic", "iwan4 + cubic", "masing_power + cubic"],
)

# %% [markdown]
# A power law of sliders with a stiffening spring predicts a level that it has not seen to some 8 %,
# the highest to 9 %; Iwan's four parameters are not told apart from it, for macroslip was not
# reached. Bouc-Wen's exponent of one is behind both by more than twice the standard error, and
# without a spring every law fails at the highest levels. The levels do not agree on one natural
# frequency to some hundredths of a hertz, so each has an offset of its own: without them no law
# could be told from another.
#
# What is left is not noise, and the verdict says so: repeats scatter by less. A second mode, or a
# rigid body whose constant stands beside this one, is not in the model. Neither failure is the end:
# what is known is stated with its interval, and the findings say what to add.
