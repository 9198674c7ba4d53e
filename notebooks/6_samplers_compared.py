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
# # 6 Samplers compared
#
# *Which sampler can you trust with the posterior of Step 3, and what does each one cost?*
#
# The ridge of notebook 2 is a hard target: two of its three parameters are tied to each other along
# a curve that crosses the box. The paper walked over it with 850 random steps. Here seven samplers
# of `jbw.sampling.sample` draw from the same likelihood (36) in the same box. Two of them,
# tempering and nested sampling, explore the whole box by entirely different methods, so each checks
# the other.

# %%
# %matplotlib inline
import warnings

import jax
import matplotlib.pyplot as plt
import virtual_rig

import jbw
from jbw import sampling

campaign = virtual_rig.campaign()
tests = {test.name: test for test in campaign.tests}
linear = jbw.steps.linear_step(tests["noise_0p005V"]).pooled
probing = [test for test in campaign.tests if test.name.startswith("tone")]
step = jbw.steps.fit_kernel(jax.random.key(0), probing, linear, campaign.settings)
print(f"prior: {dict(campaign.settings['prior'])}")

# %% [markdown]
# A likelihood is a function of the parameters and the data which returns one term per record; you
# can replace it by any other. Two samplers use the Gaussian approximation at the optimum, which is
# passed as `start` and `covariance`. The published walk keeps its 850 steps of fixed size. The last
# sampler is NUTS in other coordinates: from wall to wall of the box along the direction that the
# fit determines least, and across it.

# %%
gaussian = {"start": step.fit.theta, "covariance": step.fit.covariance}
samplers = {
    "nuts": {},
    "elliptical_slice": gaussian,
    "random_walk": {"num_warmup": 2000, "num_samples": 20_000},
    "random_walk_paper": {},
    "importance": gaussian,
    "tempered_smc": {},
    "nested": {},
}
trees = {}
for name, options in samplers.items():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the table says it in numbers
        trees[name] = sampling.sample(
            jax.random.key(1), jbw.steps.kernel_log_likelihood, step.box, step.data,
            sampler=name, chain_method="vectorized", **options,
        )  # fmt: skip
trees["nuts along the ridge"] = sampling.sample(
    jax.random.key(1), jbw.steps.kernel_log_likelihood, step.box, step.data,
    coordinates=sampling.along_ridge(step.fit.theta, step.fit.covariance, step.box),
    chain_method="vectorized", options={"adapt_mass": True},
)  # fmt: skip

# %%
print(
    "sampler                evaluations   time     ESS  R-hat           alpha      alpha*delta",
    end="",
)
print("      log evidence")
for name, tree in trees.items():
    draws, facts = tree["posterior"].to_dataset(), tree.attrs
    alpha, product = draws["alpha"].values, (draws["alpha"] * draws["delta"]).values
    looked = sampling.diagnose(alpha)
    print(
        f"{name:22s} {facts['num_evaluations']:>11} {tree['timing'].attrs['wall_s']:>4.0f} s "
        f"{looked['ess_bulk']:>7.0f} {looked['r_hat']:>6.3f} {alpha.mean():>7.1f} +- "
        f"{alpha.std():<4.1f} {product.mean():>7.0f} +- {product.std():<5.0f}",
        f"{facts['log_evidence']:>8.1f} +- {facts['log_evidence_error']:.1f}"
        if "log_evidence" in facts
        else "",
    )

# %%
for name, tree in trees.items():
    judged = sampling.verdict(tree, step.box)
    codes = [finding.code for finding in judged.findings if finding.status != "ok"]
    print(f"{name:22s} {judged.status}: {', '.join(codes)}")

# %%
whole = trees["nested"]["posterior"].to_dataset()
fig, axes = plt.subplots(2, 4, figsize=(10, 5), sharex=True, sharey=True, layout="constrained")
for ax, (name, tree) in zip(axes.flat, trees.items(), strict=False):
    draws = tree["posterior"].to_dataset()
    ax.plot(whole["delta"].values.ravel(), whole["alpha"].values.ravel(), ",", color="0.7")
    for chain in range(draws.sizes["chain"]):
        one = draws.isel(chain=chain)[
            {"draw": slice(None, None, max(1, draws.sizes["draw"] // 500))}
        ]
        ax.plot(one["delta"], one["alpha"], ".", alpha=0.15, ms=1.5)
    ax.set_title(name, fontsize=9)
for ax in axes[1]:
    ax.set_xlabel(r"$\delta$ [1/m]")
for ax in axes[:, 0]:
    ax.set_ylabel(r"$\alpha$ [1/s²]")

# %% [markdown]
# Each colour is a chain or a run; grey are the draws of nested sampling.
#
# *Chains.* The noise of every tone is integrated out. With few repeats the error of (31) therefore
# counts as noise, and the ridge is thick enough for chains in the box. NUTS and the tuned walk have
# hundreds of effective draws. Slices about the Gaussian of the fit have nearly as many, but an
# R-hat that is still too high. The published walk has five effective draws, near its four starting
# points.
#
# *About a Gaussian.* Importance sampling puts most of the weight on few draws and reports it
# (`khat`, `ess_weights`). Its evidence is wrong by nats. It is the right tool for the joint
# posterior of notebook 3, which is nearly Gaussian, and the wrong one here.
#
# *From the whole box.* Tempering and nested sampling move a cloud of points and do not depend on
# its shape. They give thousands of effective draws in seconds, the same means, and the same
# evidence within a few tenths. They need many evaluations, which are cheap here, but not if each is
# an integration in time.
#
# *Along the ridge.* This is the same NUTS, in coordinates in which the ridge is straight and ends
# at walls. It gains nothing on a thick ridge. If the laser is good and the ridge thin, chains in
# the box get stuck and these do not. `jbw.identify` therefore draws Step 3 in this way. The slices
# of the joint posterior do the same if a fit leaves a direction open.
#
# Samplers that converge agree, and none passes the verdict: the posterior accumulates at the bound
# of the box, and only a product is determined. No sampler can change that. What is missing is a
# test that separates $\alpha$ from $\delta$.
#
# `jbw compare RUN --step third_order` makes the same comparison for the records of a run, for every
# parameter and in Monte Carlo standard errors. `--step joint` makes it for the posterior of
# notebook 3.
