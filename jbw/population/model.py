r"""The population's distribution of several coordinates at once, sampled by NUTS.

$$\varphi_k \sim N(\mu_k, T), \qquad \mu_k = B x_k, \qquad T = \mathrm{diag}(\tau)\,R\,
  \mathrm{diag}(\tau)$$
$$\tau_j \sim \text{half-normal}(A_j), \qquad R \sim \mathrm{LKJ}(2)$$

The posterior is marginal over the units, which avoids a funnel. A unit that is represented by the
normal summary of its posterior is integrated out in closed form; any other one over its draws, each
with the inverse of the run's prior density as its weight,

$$m_k \sim N(\mu_k,\ T + C_k), \qquad
  p(\text{data}_k) \propto \frac1S \sum_s \frac{N(\varphi_{ks};\ \mu_k, T)}{\pi_0(\varphi_{ks})}$$

B is sampled relative to the mean of all units, in units of A.

Reference:
    Lunn, Barrett, Sweeting and Thompson (2013), J. R. Stat. Soc. C 62, 551, on draws that a second
    stage weights again.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jaxtyping import Array, Bool, Float, Int, Key
from numpyro.infer import MCMC, NUTS

from jbw.population.prior import ALIKE, TORQUE, CovariateDesign, Prior
from jbw.population.trend import SPREAD, expected

FULL = (500, 1000, 2)  # numbers of warm-up steps, draws and chains of NUTS
# numbers of warm-up steps, draws and chains for a first estimate of the variation between units
ROUGH = (300, 200, 1)
# target acceptance rate of NUTS: high, because the density is strongly curved near small tau and
# correlations near 1
ACCEPTED = 0.98
# concentration of the LKJ prior of the correlations; a value above 1 favours zero correlation
EVEN = 2.0


class UnitPosteriors(NamedTuple):
    """The posteriors of all units, expressed in the pooled quantities.

    Attributes:
        mean: Mean of each unit's posterior, without the prior of its run.
        cov: Covariance of each unit's posterior.
        draws: Some of the draws of each unit.
        log_prior: Log density of the run's prior at each draw, up to a constant.
        weighed: Whether a unit is represented by its draws; otherwise by its normal summary.
    """

    mean: Float[np.ndarray, "unit d"]
    cov: Float[np.ndarray, "unit d d"]
    draws: Float[np.ndarray, "unit draw d"]
    log_prior: Float[np.ndarray, "unit draw"]
    weighed: Bool[np.ndarray, " unit"]


def population_model(
    units: UnitPosteriors, design: CovariateDesign, prior: Prior, included: Any
) -> None:
    """Define the NumPyro model of a population, with the units' own parameters integrated out.

    `included` is 1 for each unit that counts, otherwise 0.
    """
    means, factor = population_of_units(design, prior)
    log_density = log_likelihoods(units, means, factor)
    numpyro.factor("units", jnp.sum(jnp.asarray(included) * log_density))


def population_of_units(
    design: CovariateDesign, prior: Prior
) -> tuple[Float[Array, "unit d"], Float[Array, "d d"]]:
    """Sample a population in NumPyro; return unit means and the Cholesky root of their covariance.

    The sites are `line` (d, covariate), `tau`, `root` (the Cholesky root of the correlations) and,
    where a coordinate saturates, `u`.
    """
    middle, scale = jnp.asarray(prior.mean), jnp.asarray(prior.tau)
    spread = jnp.asarray(prior.sd) / scale[:, None]
    offset: Any = numpyro.sample("offset", dist.Normal(0.0, spread).to_event(2))
    line = jnp.asarray(numpyro.deterministic("line", middle + scale[:, None] * offset))
    if TORQUE in design.columns and prior.same_unit:
        slope, pairs = line[:, design.columns.index(TORQUE)], np.array(prior.same_unit)
        apart = slope[pairs[:, 1]] - slope[pairs[:, 0]]
        numpyro.factor("alike", jnp.sum(dist.Normal(0.0, ALIKE).log_prob(apart)))
    tau: Any = numpyro.sample("tau", dist.HalfNormal(scale).to_event(1))
    d = len(scale)
    root: Any = numpyro.sample("root", dist.LKJCholesky(d, EVEN)) if d > 1 else jnp.eye(1)
    bent: Any = numpyro.sample("u", dist.LogNormal(0.0, SPREAD)) if any(design.saturates) else None
    return expected(line, design.x, design, bent), jnp.asarray(tau[:, None] * root)


def log_likelihoods(
    units: UnitPosteriors, means: Float[Array, "unit d"], factor: Float[Array, "d d"]
) -> Float[Array, " unit"]:
    """Return each unit's log likelihood for a given population, up to a constant."""
    normal, weighed = np.flatnonzero(~units.weighed), np.flatnonzero(units.weighed)
    log_density = jnp.zeros(len(units.mean))
    if len(normal):
        marginal = dist.MultivariateNormal(means[normal], factor @ factor.T + units.cov[normal])
        log_density = log_density.at[normal].set(marginal.log_prob(jnp.asarray(units.mean[normal])))
    if len(weighed):
        weights = log_weights(units, weighed, means, factor)
        log_density = log_density.at[weighed].set(jax.nn.logsumexp(weights, axis=1))
    return log_density


def log_weights(
    units: UnitPosteriors,
    which: Int[np.ndarray, " which"],
    means: Float[Array, "unit d"],
    factor: Any,
) -> Float[Array, "which draw"]:
    """Return log weights of the units' draws, given unit means and the root of their covariance."""
    apart = jnp.asarray(units.draws[which]) - means[which][:, None]
    # The inverse root is computed once for all draws, which is thirty times faster than one
    # solution per draw.
    root = jax.scipy.linalg.solve_triangular(factor, jnp.eye(len(factor)), lower=True)
    squares = jnp.sum((apart @ root.T) ** 2, axis=-1)
    log_det = jnp.sum(jnp.log(jnp.abs(jnp.diagonal(root))))
    return log_det - 0.5 * squares - units.log_prior[which]


Sampler = Callable[[Key[Array, ""], Float[np.ndarray, " unit"]], dict[str, np.ndarray]]


def sampler(
    units: UnitPosteriors, design: CovariateDesign, prior: Prior, lengths: tuple[int, int, int]
) -> Sampler:
    """Return a function that draws the parameters of a population by NUTS.

    It draws `line`, `tau`, `scatter` (T), `u` where a coordinate saturates, and divergences, with
    axes (chain, draw). The mask is 1 for an included unit, otherwise 0. The compiled code serves
    any number of calls.
    """
    warmup, samples, chains = lengths
    model = partial(population_model, units, design, prior)
    mcmc = MCMC(
        NUTS(model, target_accept_prob=ACCEPTED, dense_mass=True),
        num_warmup=warmup, num_samples=samples, num_chains=chains, chain_method="sequential",
        progress_bar=False, jit_model_args=True,
    )  # fmt: skip

    return lambda key, included: draws_of(mcmc, key, jnp.asarray(included))


def draws_of(mcmc: MCMC, key: Key[Array, ""], *args: Any) -> dict[str, np.ndarray]:
    """Draw the parameters of a population by MCMC, with divergences, as arrays (chain, draw)."""
    mcmc.run(key, *args, extra_fields=("diverging",))
    sites = {name: np.asarray(v) for name, v in mcmc.get_samples(group_by_chain=True).items()}
    diverging = np.asarray(mcmc.get_extra_fields(group_by_chain=True)["diverging"])
    return named_draws(sites) | {"diverging": diverging}


def named_draws(sites: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the draws of a population's parameters by their public names.

    They are `line`, `tau`, `scatter` and, where a coordinate saturates, `u`.
    """
    root = sites.get("root", np.ones((*sites["tau"].shape, 1)))
    factor = sites["tau"][..., :, None] * root
    named = {name: sites[name] for name in ("line", "tau", "u") if name in sites}
    return named | {"scatter": factor @ np.swapaxes(factor, -1, -2)}
