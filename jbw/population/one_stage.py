r"""The joint posterior of a small fleet's records: units and population in one stage.

$$p(B, T, \theta_1 \dots \theta_K\,|\,\text{data}) \propto p(B, T)
  \prod_k p(\text{data}_k | \theta_k)\,N(\varphi_k;\ B x_k, T)$$

`population_of` computes the same in two stages, from summaries or from weighted draws. One stage
avoids both approximations, at the price of a solution of every record in each step; it serves to
check the two stages on a few units. A unit's sampled quantities that are not pooled are flat in
their logarithms between the bounds of the run's prior.
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
from scipy.special import logit

from jbw.errors import ConfigError, DataError
from jbw.inference.posterior.summary import posterior_draws
from jbw.inference.space.box import bounds_by_name
from jbw.observables.dataset import Dataset, log_likelihood
from jbw.population.coordinates import rows_of
from jbw.population.model import draws_of, population_of_units
from jbw.population.population import Population
from jbw.population.unit import GAIN
from jbw.report.messages import population as messages
from jbw.study.study import Study

logger = logging.getLogger("jbw")
NUM_WARMUP, NUM_SAMPLES = 500, 1000
# smallest lower bound relative to the upper one, if the prior's lower bound is zero
LEAST = 1e-6


class MeasuredUnit(NamedTuple):
    """One unit with its records, and with the scale of its posterior.

    Attributes:
        data: Records, as prepared for the unit's own posterior.
        names: Names of the sampled parameters.
        lower: Logarithms of the lower bounds of their prior.
        upper: Logarithms of the upper bounds of their prior.
        mean: Posterior mean of logit(p), where p is the relative position of a logarithm between
            its bounds.
        root: Cholesky root of the posterior covariance of logit(p).
        powers: Exponents of the sampled parameters in the pooled coordinates.
        gain: Index of the source's gain among the parameters; its prior stays uniform.
    """

    data: Dataset
    names: tuple[str, ...]
    lower: Float[np.ndarray, " parameter"]
    upper: Float[np.ndarray, " parameter"]
    mean: Float[np.ndarray, " parameter"]
    root: Float[np.ndarray, "parameter parameter"]
    powers: Float[np.ndarray, "d parameter"]
    gain: tuple[int, ...]


def one_stage(
    studies: Sequence[Study],
    population: Population,
    *,
    seed: int = 0,
    report: Callable[[str], Any] = logger.info,
) -> dict[str, np.ndarray]:
    """Draw the population of a small fleet from all records at once, in a single stage.

    The draws are `line`, `tau` and `scatter`, with axes (chain, draw).

    Args:
        studies: Results of `jbw.identify` for every unit, in the order of the fleet.
        population: The population from two stages, whose coordinates, covariates and priors are
            used.
        seed: Seed of the sampler.
        report: A function that is called with one sentence.

    Raises:
        ConfigError: The numbers of studies and of the population's units differ.
        DataError: A unit has no joint posterior, or draws without a logarithm.

    Examples:
        A thousand draws of the standard deviation between units come from all records at once:

        >>> import jbw; jbw.enable_x64()
        >>> from dataclasses import replace
        >>> asked = {"tests": ["noise_0p005V"], "repeats": 2, "fs": 128.0}
        >>> units = jbw.rig.measure_fleet("laboratory", torques=[8.0], assemblies=3, **asked)
        >>> studies = [jbw.identify(replace(unit, laws=()), quick=True) for unit in units]
        >>> population = jbw.population_of(jbw.fleet_of(studies))
        >>> draws = jbw.one_stage(studies, population)
        >>> print(population.pooled.names, draws["tau"].shape)
        ('omega_n', 'zeta') (1, 1000, 2)
    """
    units = measured_units(studies, population)
    report(messages.one_stage(len(units), NUM_SAMPLES))
    start = {f"z_{k}": np.zeros(len(unit.names)) for k, unit in enumerate(units)}
    model = partial(joint_model, units, population)
    kernel = NUTS(model, target_accept_prob=0.9, init_strategy=init_to_value(values=start))
    mcmc = MCMC(kernel, num_warmup=NUM_WARMUP, num_samples=NUM_SAMPLES, progress_bar=False)
    return draws_of(mcmc, jax.random.key(seed))


def measured_units(studies: Sequence[Study], population: Population) -> list[MeasuredUnit]:
    """Return every unit of a fleet with its records and the scale of the unit's posterior."""
    if len(studies) != (num_units := len(population.result.units)):
        raise ConfigError(
            f"Argument `studies` must contain the {num_units} units of the "
            f"population, but contains {len(studies)}.",
            remedy="Give the result of `jbw.identify` for each unit, in the order of the fleet.",
        )
    return [_measured_unit(study, population) for study in studies]


def joint_model(units: Sequence[MeasuredUnit], population: Population) -> None:
    """Define the NumPyro model of a population together with all records of its units.

    `z_k` is a unit's parameters in the scale of its own posterior.
    """
    means, factor = population_of_units(population.design, population.prior)
    for k, unit in enumerate(units):
        flat = dist.ImproperUniform(dist.constraints.real_vector, (), (len(unit.names),))
        z: Any = numpyro.sample(f"z_{k}", flat)
        place = unit.mean + unit.root @ z
        logs = unit.lower + (unit.upper - unit.lower) * jax.nn.sigmoid(place)
        flat_in_logs = jax.nn.log_sigmoid(place) + jax.nn.log_sigmoid(-place)
        numpyro.factor(f"flat_{k}", jnp.sum(flat_in_logs))
        theta = dict(zip(unit.names, jnp.exp(logs), strict=True))
        numpyro.factor(f"data_{k}", jnp.sum(log_likelihood(theta, unit.data)))
        numpyro.factor(f"prior_{k}", jnp.sum(logs[np.array(unit.gain, int)]))
        unit_prior = dist.MultivariateNormal(means[k], scale_tril=factor)
        numpyro.factor(f"unit_{k}", unit_prior.log_prob(unit.powers @ logs))


def _measured_unit(study: Study, population: Population) -> MeasuredUnit:
    identification = study.identification
    if identification is None or identification.data is None:
        raise DataError(
            f"The result of {study.result.campaign} contains no likelihood of its records.",
            why="A result that is read from a saved run contains draws, but no likelihood.",
            remedy="Give the result that `jbw.identify` returned in this process.",
        )
    data, main = identification.data, identification.main
    bounds, names = bounds_by_name(main.box), main.box.names
    posterior = posterior_draws(main.posterior)
    draws: Any = np.stack([np.ravel(posterior[name].values) for name in names], axis=-1)
    if not np.all(draws > 0):
        raise DataError(
            f"Some draws of {study.result.campaign} are not positive and have no logarithm.",
            remedy="Leave the unit out, or check the two-stage population with other units.",
        )
    upper = np.array([bounds[name][1] for name in names])
    lower = np.maximum([bounds[name][0] for name in names], LEAST * upper)
    place = np.log(draws / lower) / np.log(upper / lower)
    logits = logit(np.clip(place, 1e-12, 1.0 - 1e-12))
    root = np.linalg.cholesky(np.atleast_2d(np.cov(logits, rowvar=False)))
    gain = tuple(i for i, name in enumerate(names) if name == GAIN)
    powers = _powers(population, data.laws, names)
    return MeasuredUnit(
        data, names, np.log(lower), np.log(upper), logits.mean(axis=0), root, powers, gain
    )


def _powers(
    population: Population, laws: Sequence[str], names: Sequence[str]
) -> Float[np.ndarray, "d parameter"]:
    """Return the exponents of the sampled parameters in each pooled quantity."""
    pooled = population.pooled
    sampled = rows_of(laws, names, pooled.parameters)
    powers = pooled.powers @ np.linalg.pinv(sampled)
    if not np.allclose(powers @ sampled, pooled.powers, atol=1e-9):
        raise DataError(
            f"The sampled parameters, {', '.join(names)}, do not determine all of "
            f"{', '.join(pooled.names)}.",
            remedy="Pool quantities that follow from the sampled parameters of every unit.",
        )
    return powers
