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

import virtual_rig
from IPython.display import display

import jbw

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
    virtual_rig.print_laws(found.record)
    for sentence in found.record["statements"]:
        print("-", sentence)
    display(jbw.plots.laws(found.tree))


def identified(name, *shown):
    """A campaign's run, made on the first call: parameters, errors and bands, verdict, figures."""
    campaign = campaign_of(name)
    if campaign is None:
        return
    place = virtual_rig.folder() / name
    if not (place / "summary.json").exists():
        jbw.identify(campaign).save(place)
    study = jbw.load_study(place, campaign)
    summary = study.record
    for row_name, row in summary["steps"]["joint"]["parameters"].items():
        print(
            f"{row_name:14s} {row['mean']:.5g} [{row['q005']:.5g}, {row['q995']:.5g}] {row['unit']}"
        )
    virtual_rig.print_tests(summary)
    virtual_rig.print_answers(summary)
    for finding in summary["verdict"]["findings"]:
        if finding["status"] != "ok":
            print("-", finding["reason"], finding["action"])
    for figure in shown:
        display(jbw.plots.draw(study.tree, figure))


# %% [markdown]
# ## Free decays of a double beam
#
# No force was measured: hammer impacts at three positions, three each, velocity of the tip by a
# laser vibrometer. The records are filtered to the first mode near 122 Hz, and the model passes
# through the same filter. The impacts at the third position are held out. Without a force there is
# no gain; a decay tells frequency and damping against amplitude.
#
# A line a record: the errors of the best linear oscillator, the best cubic one and the joint, over
# the rms of the record, and the share of its values inside the 99 % bands. Of a record that was
# held out the bands include what the law misses of impacts that are left out of the fit in turn:
# of the stronger ones, the 99 % bands of the parameters and the noise alone hold a quarter.

# %%
identified("bolted_double_beam", "amplitude", "decay")

# %% [markdown]
# Frequency falls and damping rises with the amplitude, both nearly along straight lines, as (2)
# has it at small $\delta Y$: the slopes are $\alpha\delta$ and $\alpha\gamma$ over $\omega_n^2$.
# These two, $\omega_n$ and $\zeta$ are what decays tell; $\alpha$, $\delta$ and $\gamma$ by
# themselves follow the prior of the joint's share of the stiffness, and the run says so.
#
# Before any law, `jbw laws` reads the ratio of what damps to what softens off the decays
# themselves, beside that of sliders: a Masing law has no freedom between the two, Bouc-Wen's has
# it, as $\gamma/\delta$, and a Masing law with a spring beside it gains it.

# %%
compared(
    "bolted_double_beam", ["linear", "cubic", "bouc_wen", "masing_power", "masing_power + cubic"]
)

# %% [markdown]
# ## Response curves of the Brake-Reuss beam
#
# A controller held the acceleration at eight levels while the frequency was stepped through the
# first bending mode near 80 Hz; the force varies along each curve. Laws side by side, alone and
# with a cubic spring beside them. What the comparison says is printed below its table: how well
# each law predicts a level that it has not seen, which are told apart by that and which are not,
# whether macroslip was reached, what is left beside a line of each level's own, and what the
# offsets of the levels do to the best law.

# %%
compared(
    "brake_reuss_all",
    ["linear", "cubic", "bouc_wen", "bouc_wen + cubic", "bouc_wen_nu", "bouc_wen_nu + cubic",
     "iwan4 + cubic", "masing_power + cubic"],
)  # fmt: skip

# %% [markdown]
# How to read it: a law may be good in one use and not in another. *Left out* is within the fitted
# levels, each predicted from the others; *highest* is the highest level, predicted from those
# below; *kinds* is one kind of test, predicted from the others, where there are several.
# `jbw predict` takes the weights of the use that it is asked for. The *log score* is the sum over
# levels of what each predicts of one left out, with the standard error of its difference to the
# best; laws within two of these are **not told apart**, whatever their rank. *Weight* is that of a
# mixture that would have predicted best, no probability of truth. The log evidence rests on the
# priors, and is printed under two widths.
#
# A best law is not yet a good one. Where what it leaves is more than the mean of the repeats
# scatters by, another mode or a rigid body may stand beside it, and no law of the joint mends that:
# the verdict of a run says which.
