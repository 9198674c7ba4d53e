r"""The population of several coordinates at once, sampled by NUTS.

$$m_k \sim N(B x_k,\ T + C_k), \qquad T = \mathrm{diag}(\tau)\,R\,\mathrm{diag}(\tau)$$
$$\tau_j \sim \text{half-normal}(A_j), \qquad R \sim \mathrm{LKJ}(2)$$

The units themselves are integrated out in closed form, which leaves no funnel; B is sampled in
units of A about the mean of all units.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jaxtyping import Array, Float, Key
from numpyro.infer import MCMC, NUTS

from jbw.population.prior import Prior

NUM_WARMUP, NUM_SAMPLES, NUM_CHAINS = 1000, 1000, 2
EVEN = 2.0  # of the correlations' prior: above 1 it leans to none


def population_model(
    m: Float[np.ndarray, "unit d"],
    c: Float[np.ndarray, "unit d d"],
    x: Float[np.ndarray, "unit covariate"],
    prior: Prior,
) -> None:
    """The NumPyro model: `line` (d, covariate), `tau` (d,), and `root` of the correlations."""
    middle, scale = jnp.asarray(prior.mean), jnp.asarray(prior.tau)
    spread = jnp.asarray(prior.sd) / scale[:, None]
    offset: Any = numpyro.sample("offset", dist.Normal(0.0, spread).to_event(2))
    line = jnp.asarray(numpyro.deterministic("line", middle + scale[:, None] * offset))
    tau: Any = numpyro.sample("tau", dist.HalfNormal(scale).to_event(1))
    d = m.shape[1]
    root: Any = numpyro.sample("root", dist.LKJCholesky(d, EVEN)) if d > 1 else jnp.eye(1)
    factor = jnp.asarray(tau[:, None] * root)
    total = factor @ factor.T + jnp.asarray(c)
    means = jnp.asarray(x) @ line.T
    numpyro.sample("m", dist.MultivariateNormal(means, total), obs=jnp.asarray(m))


def draws_of(
    key: Key[Array, ""],
    m: Float[np.ndarray, "unit d"],
    c: Float[np.ndarray, "unit d d"],
    x: Float[np.ndarray, "unit covariate"],
    prior: Prior,
    report: Callable[[str], None],
) -> dict[str, np.ndarray]:
    """Draws of `line`, `tau` and `scatter` (T) with axes (chain, draw), and of divergences."""
    report(f"Population of {len(m)} units: NUTS, {NUM_CHAINS} chains of {NUM_SAMPLES} draws")
    mcmc = MCMC(
        NUTS(population_model, target_accept_prob=0.95),
        num_warmup=NUM_WARMUP, num_samples=NUM_SAMPLES, num_chains=NUM_CHAINS,
        chain_method="sequential", progress_bar=False,
    )  # fmt: skip
    mcmc.run(key, m, c, x, prior, extra_fields=("diverging",))
    found = {name: np.asarray(v) for name, v in mcmc.get_samples(group_by_chain=True).items()}
    root = found.get("root", np.ones((*found["tau"].shape, 1)))
    factor = found["tau"][..., :, None] * root
    return {
        "line": found["line"],
        "tau": found["tau"],
        "scatter": factor @ np.swapaxes(factor, -1, -2),
        "diverging": np.asarray(mcmc.get_extra_fields(group_by_chain=True)["diverging"]),
    }
