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
# *Which law fits measurements of real joints, which nobody built from an equation?*
#
# The notebook uses two published measurements, each with its campaign file in `campaigns`. The
# first are free decays of a double beam with three bolts (Cenedese et al., *Phil. Trans. R. Soc. A*
# 380, 2022). The second are response curves of the Brake-Reuss beam, two half-beams joined by three
# bolts (Chen et al., *Mech. Syst. Signal Process.* 166, 2022). The data are not part of this
# repository; the campaign files state where to get them. Set JBW_DATA to their folder. Without it
# the cells below do nothing.

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
# No force was measured. There are three hammer impacts at each of three positions, with the
# velocity of the tip from a laser vibrometer. The records are filtered to the first mode near 122
# Hz, and the model passes through the same filter. The impacts at the third position are held out.
# Without a force there is no gain; a decay determines frequency and damping against amplitude.
#
# The table has one line per record: the errors of the best linear oscillator, the best cubic one
# and the joint, over the rms of the record, and the share of its values inside the 99 % bands. For
# a held-out record the bands include the model discrepancy, from impacts that are left out of the
# fit in turn. Without it, the 99 % bands of the parameters and the noise contain only a quarter of
# the stronger impacts.

# %%
identified("bolted_double_beam", "amplitude", "decay")

# %% [markdown]
# Frequency falls and damping rises with the amplitude, both nearly along straight lines, as (2)
# predicts at small $\delta Y$. The slopes are $\alpha\delta$ and $\alpha\gamma$ over $\omega_n^2$.
# Decays determine these two, $\omega_n$ and $\zeta$. Separately, $\alpha$, $\delta$ and $\gamma$
# follow the prior of the joint's share of the stiffness, and the run says so.
#
# Before it fits any law, `jbw laws` reads the ratio of damping to softening from the decays and
# compares it with that of sliders. A Masing law fixes this ratio. Bouc-Wen leaves it free, as
# $\gamma/\delta$. A Masing law with a parallel spring also leaves it free.

# %%
compared(
    "bolted_double_beam", ["linear", "cubic", "bouc_wen", "masing_power", "masing_power + cubic"]
)

# %% [markdown]
# ## Response curves of the Brake-Reuss beam
#
# A controller held the acceleration at eight levels while the frequency was stepped through the
# first bending mode near 80 Hz; the force varies along each curve. The laws are compared alone and
# with a parallel cubic spring. The conclusions are printed below the table:
#
# * how well each law predicts a level that was left out, and which laws this separates;
# * whether macroslip was reached;
# * the residual compared with that of a separate line fit for each level;
# * the effect of the offsets of the levels on the best law.

# %%
compared(
    "brake_reuss_all",
    ["linear", "cubic", "bouc_wen", "bouc_wen + cubic", "bouc_wen_nu", "bouc_wen_nu + cubic",
     "iwan4 + cubic", "masing_power + cubic"],
)  # fmt: skip

# %% [markdown]
# A law may be good in one use and not in another. *Left out* is within the fitted levels, each
# predicted from the others. *Highest* is the highest level, predicted from those below. *Kinds* is
# one kind of test, predicted from the others, if there are several. `jbw predict` takes the weights
# for the requested use. The *log score* is the sum over levels of the log probability of each
# left-out level, with the standard error of its difference to the best. Laws within two of these
# are **not told apart**, whatever their rank. *Weight* belongs to the mixture that would have
# predicted best; it is not a probability of truth. The log evidence depends on the priors, and is
# printed for two prior widths.
#
# The best law is not necessarily a good one. Its residual may exceed the variation of the mean of
# the repeats. Another mode or a rigid body may then be present, and no law of the joint can remove
# that. The verdict of a run shows which.
