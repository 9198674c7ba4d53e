r"""All records of a small fleet at once: units and population in one posterior.

$$p(B, T, \theta_1 \dots \theta_K\,|\,\text{data}) \propto p(B, T)
  \prod_k p(\text{data}_k | \theta_k)\,N(\varphi_k;\ B x_k, T)$$

What `population_of` has in two stages, summaries or draws weighed anew, without either's
approximation, at the price of a solve of every record a step: to check it, on a few units.
"""

import logging
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jaxtyping import Float
from numpyro.infer import MCMC, NUTS, init_to_value

from jbw.errors import DataError
from jbw.observables.dataset import Dataset, log_likelihood
from jbw.population.coordinates import GAIN
from jbw.population.model import population_of_units
from jbw.population.population import Population
from jbw.study.study import Study

logger = logging.getLogger("jbw")
NUM_WARMUP, NUM_SAMPLES = 500, 1000


class Whole(NamedTuple):
    """One unit with its records.

    Attributes:
        data: The records as its own posterior was made from them.
        names: What was sampled of it.
        mean: Of the logarithms of these, in its own posterior.
        root: Of their covariance.
        powers: The pooled coordinates' exponents of these.
        gain: Where the source's gain stands among them, whose prior stays uniform.
    """

    data: Dataset
    names: tuple[str, ...]
    mean: Float[np.ndarray, " parameter"]
    root: Float[np.ndarray, "parameter parameter"]
    powers: Float[np.ndarray, "d parameter"]
    gain: tuple[int, ...]


def one_stage(
    studies: Sequence[Study],
    found: Population,
    *,
    seed: int = 0,
    report: Callable[[str], Any] = logger.info,
) -> dict[str, np.ndarray]:
    """Draws of `line`, `tau` and `scatter` from all records at once, axes (chain, draw).

    Args:
        studies: What `jbw.identify` returned of every unit, in the order of the fleet.
        found: The population in two stages, whose coordinates, covariates and priors are taken.
        seed: Of the sampler.
        report: Called with one sentence.

    Raises:
        DataError: A unit without a joint posterior, or with draws that have no logarithm.
    """
    wholes = [_whole(study, found) for study in studies]
    report(f"All records of {len(wholes)} units at once: NUTS, one chain of {NUM_SAMPLES}")
    start = {f"z_{k}": np.zeros(len(one.names)) for k, one in enumerate(wholes)}
    model = partial(_model, wholes, found)
    kernel = NUTS(model, target_accept_prob=0.9, init_strategy=init_to_value(values=start))
    mcmc = MCMC(kernel, num_warmup=NUM_WARMUP, num_samples=NUM_SAMPLES, progress_bar=False)
    mcmc.run(jax.random.key(seed), extra_fields=("diverging",))
    drawn = {name: np.asarray(v) for name, v in mcmc.get_samples(group_by_chain=True).items()}
    root = drawn.get("root", np.ones((*drawn["tau"].shape, 1)))
    factor = drawn["tau"][..., :, None] * root
    return {
        "line": drawn["line"],
        "tau": drawn["tau"],
        "scatter": factor @ np.swapaxes(factor, -1, -2),
        "diverging": np.asarray(mcmc.get_extra_fields(group_by_chain=True)["diverging"]),
    }


def _model(wholes: Sequence[Whole], found: Population) -> None:
    """The NumPyro model: the population's, and `z_k`, each unit in its own posterior's scale."""
    means, factor = population_of_units(found.design, found.prior)
    for k, one in enumerate(wholes):
        flat = dist.ImproperUniform(dist.constraints.real_vector, (), (len(one.names),))
        z: Any = numpyro.sample(f"z_{k}", flat)
        logs = one.mean + one.root @ z
        theta = dict(zip(one.names, jnp.exp(logs), strict=True))
        numpyro.factor(f"data_{k}", jnp.sum(log_likelihood(theta, one.data)))
        numpyro.factor(f"prior_{k}", jnp.sum(logs[np.array(one.gain, int)]))
        own = dist.MultivariateNormal(means[k], scale_tril=factor)
        numpyro.factor(f"unit_{k}", own.log_prob(one.powers @ logs))


def _whole(study: Study, found: Population) -> Whole:
    known = study.identification
    if known is None or known.data is None:
        raise DataError(
            f"{study.record['campaign']} has no joint posterior at hand.",
            why="A run that was saved keeps draws, and not the likelihood of its records.",
            remedy="Give what `jbw.identify` returned.",
        )
    data, main = known.data, known.main
    names = main.box.names
    posterior = main.posterior["posterior"].to_dataset()
    draws: Any = np.stack([np.ravel(posterior[name].values) for name in names], axis=-1)
    if not np.all(draws > 0):
        raise DataError(f"Draws of {study.record['campaign']} are not positive: no logarithm.")
    logs = np.log(draws)
    root = np.linalg.cholesky(np.cov(logs, rowvar=False))
    rows = dict(zip(found.pooled.parameters, found.pooled.powers.T, strict=True))
    none = np.zeros(len(found.pooled.names))
    powers = np.stack([rows.get(name, none) for name in names], axis=-1)
    gain = tuple(i for i, name in enumerate(names) if name == GAIN)
    return Whole(data, names, logs.mean(axis=0), root, powers, gain)
