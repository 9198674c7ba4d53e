r"""Simulation-based calibration: simulate data, sample their posterior, rank the true values.

Parameters drawn from the prior, data simulated from them, and draws of their posterior have one
joint distribution, so the rank of the truth among the draws is uniform,

$$\theta^* \sim \pi, \quad D \sim p(D \mid \theta^*), \quad \theta_{1..L} \sim p(\theta \mid D)
\;\Rightarrow\; \#\{l : f(\theta_l, D) < f(\theta^*, D)\} \sim U\{0, \dots, L\}$$

for every f, including the log likelihood: a posterior that ignores the data keeps all ranks uniform
except that of the log likelihood.

A user's posterior may have any scalar prior for each parameter. The samplers need a uniform prior
in a box, so any other prior is expressed by its quantiles,

$$\theta_i = F_i^{-1}(u_i), \qquad u_i \sim U(0, 1)$$

and the ranks are those of u.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpyro.distributions as dist
from blackjax.diagnostics import potential_scale_reduction
from jax.lax import stop_gradient
from jax.tree_util import Partial
from jaxtyping import Array, Bool, Float, Int, Key, PyTree
from numpyro.distributions.transforms import biject_to

from jbw.errors import ConfigError
from jbw.inference.calibration.record import Calibration, Ranked, judged
from jbw.inference.fit.locate import Search, locate
from jbw.inference.posterior.verdict import ESS, GOOD_KHAT
from jbw.inference.samplers.chains import draws_of, in_batches
from jbw.inference.samplers.register import Sampler, module_of
from jbw.inference.space.box import Box, box, from_unit, require_float64
from jbw.inference.space.problem import LogLikelihood, Problem, Theta, problem_of
from jbw.inference.space.reparametrisation import in_box
from jbw.parts import Parts, unkept
from jbw.results.attributes import DrawnPosterior

LOG_LIKELIHOOD = "log_likelihood"
NUM_RANKS = 100  # number of draws among which a true value is ranked
TAIL = 0.005  # probability in each tail outside a 99 % interval
Quantity = Callable[[Theta, PyTree], Float[Array, ""]]
Report = Callable[[int], None]
HALVINGS = 100
FARTHEST = 500.0  # bound of the sampler's coordinate, where the exponential overflows
EDGE = 1e-15  # smallest distance of a prior's quantile from probability 0 or 1
# errors that NumPyro raises if a quantile function or a library is missing
WITHOUT = NotImplementedError, ImportError
Prior = Mapping[str, dist.Distribution]
Simulate = Callable[[Key[Array, ""], Theta], PyTree]


class Model(NamedTuple):
    """A posterior to calibrate: simulator of its data, likelihood and prior bounds.

    `simulate` returns data for (key, theta), without using the likelihood's code. `quantities` are
    additional ones by name, each a function of (theta, data) that returns a number. Without a
    `search` the posterior is sampled from the whole box.
    """

    simulate: Callable[[Key[Array, ""], Theta], PyTree]
    log_likelihood: LogLikelihood
    box: Box
    quantities: Mapping[str, Quantity] = {}
    search: Search | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all ranked quantities: parameters, log likelihood, and user-defined ones."""
        return (*self.box.names, LOG_LIKELIHOOD, *self.quantities)


def calibrate(
    key: Key[Array, ""],
    model: Model,
    sampler: Sampler,
    options: Any,
    *,
    num_replications: int = 1000,
    batch: int = 100,
    report: Report = lambda done: None,
    parts: Parts = unkept,
) -> Calibration:
    """Rank true values among draws of their posterior, for many true values drawn from the prior.

    Replications run in parallel in one compiled function, `batch` at a time; those of a sampler
    that works in rounds run one after the other. A replication fails if a draw is not finite, the
    chains disagree, or the sampler did not finish. Its ranks are still used; draws that are not
    numbers count as lowest. `report` is called with the number of finished replications; `parts`
    stores each batch.

    Reference:
        Talts et al. (2018), arXiv:1804.06788; Modrak et al. (2023), Bayesian Analysis 20, 461.
    """
    require_float64()
    _check(model, num_replications, batch)
    keys = jax.random.split(key, num_replications)
    if sampler.in_rounds:
        size, one_lot = 1, _in_rounds
    else:
        size, one_lot = min(batch, num_replications), _batch
    padded = jnp.concatenate([keys, keys[: -num_replications % size]])
    rows = []
    for first in range(0, num_replications, size):
        lot = partial(one_lot, padded[first : first + size], model, sampler, options)
        rows.append(jax.tree.map(np.asarray, parts(f"replications from {first}", lot, Ranked)))
        report(min(first + size, num_replications))
    replications = jax.tree.map(lambda *parts: np.concatenate(parts)[:num_replications], *rows)
    return judged(model.names, replications, NUM_RANKS)


@eqx.filter_jit
def _batch(
    keys: Key[Array, " replication"], model: Model, sampler: Sampler, options: Any
) -> Ranked:
    """Run a batch of replications together by `vmap` and return their ranks."""

    def replicate(key: Key[Array, ""]) -> Ranked:
        truth, problem, to_draw, to_rank = _posed(key, model)
        drawn = draws_of(sampler, to_draw, problem, options)
        arrived = jnp.asarray(drawn.possible) & drawn.arrived
        return _ranks(to_rank, truth, problem.data, drawn.theta, arrived, model)

    return jax.vmap(replicate)(keys)


def _in_rounds(
    keys: Key[Array, " replication"], model: Model, sampler: Sampler, options: Any
) -> Ranked:
    """Run one replication on all cores, with a sampler that works in rounds."""
    truth, problem, to_draw, to_rank = _posed_alone(keys[0], model)
    drawn, *_ = module_of(sampler).gather(to_draw, problem, options)
    facts = DrawnPosterior.of_mapping(drawn.facts)
    is_good = facts.khat is not None and facts.khat < GOOD_KHAT
    arrived = np.bool_(is_good and (facts.ess_weights or 0.0) >= ESS)
    theta = {name: jnp.asarray(values) for name, values in drawn.theta.items()}
    ranks = _ranks_alone(to_rank, truth, problem.data, theta, jnp.asarray(arrived), model)
    return jax.tree.map(lambda value: value[None], ranks)


def _posed(
    key: Key[Array, ""], model: Model
) -> tuple[dict[str, Array], Problem, Key[Array, ""], Key[Array, ""]]:
    """Draw true values and simulate data; return them with their posterior and random keys."""
    key_truth, key_data, key_place, key_draws, key_rank = jax.random.split(key, 5)
    truth = from_unit(jax.random.uniform(key_truth, (len(model.box.names),)), model.box)
    data = model.simulate(key_data, truth)
    posterior = model.log_likelihood, model.box, data
    if model.search is None:
        problem = problem_of(*posterior, in_box(model.box, None, None, 1))
    else:
        problem = locate(key_place, model.search, *posterior)
    return truth, problem, key_draws, key_rank


def _ranks(
    key: Key[Array, ""], truth: Theta, data: PyTree, draws: Theta, arrived: Bool[Array, ""],
    model: Model,
) -> Ranked:  # fmt: skip
    """Return the rank of the true value of each quantity among its posterior draws."""

    def values(theta: Theta) -> Float[Array, " quantity"]:
        parameters = [theta[name] for name in model.box.names]
        likelihood = jnp.sum(model.log_likelihood(theta, data))
        derived = [f(theta, data) for f in model.quantities.values()]
        return jnp.stack([*parameters, likelihood, *derived])

    shape = draws[model.box.names[0]].shape
    # Append the true values to the draws, because each quantity is then compiled only once.
    rows = {name: jnp.append(jnp.ravel(v), truth[name]) for name, v in draws.items()}
    quantities = in_batches(values, rows)
    of_draws = quantities[:-1].reshape(*shape, -1)
    return ranked(key, quantities[-1], of_draws, arrived)


# Both functions are compiled once for all replications that do not run in parallel.
_posed_alone, _ranks_alone = eqx.filter_jit(_posed), eqx.filter_jit(_ranks)


def ranked(
    key: Key[Array, ""],
    truth: Float[Array, " quantity"],
    draws: Float[Array, "chain draw quantity"],
    arrived: Bool[Array, ""],
) -> Ranked:
    """Rank a true value among evenly thinned posterior draws, with random ranks for ties."""
    flat = draws.reshape(-1, draws.shape[-1])
    thinned = flat[np.linspace(0, len(flat) - 1, NUM_RANKS).round().astype(int)]
    tail = round(TAIL * len(flat))
    below, ties = _place(truth, flat)
    inside = (below + ties >= max(tail, 1)) & (below <= len(flat) - max(tail, 1))
    below, ties = _place(truth, thinned)
    extra = jax.random.randint(key, below.shape, 0, ties + 1)
    finite = jnp.all(jnp.isfinite(flat)) & jnp.all(jnp.isfinite(truth))
    return Ranked(below + extra, inside, finite, arrived, jnp.max(split_r_hat(draws)))


def _place(
    truth: Float[Array, " quantity"], draws: Float[Array, "draw quantity"]
) -> tuple[Int[Array, " quantity"], Int[Array, " quantity"]]:
    return jnp.sum(draws < truth, axis=0), jnp.sum(draws == truth, axis=0)


def split_r_hat(draws: Float[Array, "chain draw quantity"]) -> Float[Array, " quantity"]:
    """Return R-hat of half chains (Gelman et al. (2013), Bayesian Data Analysis, section 11.4)."""
    half = draws.shape[1] // 2
    chains = jnp.concatenate([draws[:, :half], draws[:, draws.shape[1] - half :]])
    still = jnp.all(chains == chains[0, 0], axis=(0, 1))
    return jnp.where(still, 1.0, potential_scale_reduction(chains))


def _check(model: Model, num_replications: int, batch: int) -> None:
    counts = {"num_replications": num_replications, "batch": batch}
    for name, value in counts.items():
        if value < 1:
            raise ConfigError(f"Argument `{name}` must be at least 1, but is {value}.")
    twice = {*model.quantities} & {*model.box.names, LOG_LIKELIHOOD}
    if twice:
        raise ConfigError(
            f"Quantity {sorted(twice)[0]!r} has a reserved name, that of a parameter or of the "
            "log likelihood.",
            remedy="Rename the quantity.",
        )


def own_model(simulate: Simulate, log_likelihood: LogLikelihood, prior: Prior) -> Model:
    """Return the calibration model of a user's simulator, log likelihood and prior.

    Raises:
        ConfigError: A prior is no distribution of one real number, or has neither quantiles nor a
            cumulative distribution.
    """
    if not isinstance(prior, Mapping):
        raise ConfigError(
            "Argument `prior` must give a distribution for the name of every parameter, not "
            f"{prior!r}."
        )
    for name, distribution in prior.items():
        _require_quantiles(name, distribution)
    theta = Partial(
        theta_of,
        quantiles={name: _quantile_of(distribution) for name, distribution in prior.items()},
    )

    def simulated(key: Key[Array, ""], u: Theta) -> PyTree:
        return simulate(key, theta(u))

    def terms(u: Theta, data: Any) -> Float[Array, "..."]:
        return jnp.asarray(log_likelihood(theta(u), data))

    return Model(simulated, terms, box(dict.fromkeys(prior, (0.0, 1.0))))


def theta_of(u: Theta, quantiles: Mapping[str, Callable[[Array], Array]]) -> dict[str, Array]:
    """Return the parameters at the quantiles u of their priors."""
    return {name: of(jnp.clip(u[name], EDGE, 1.0 - EDGE)) for name, of in quantiles.items()}


def _quantile_of(prior: dist.Distribution) -> Callable[[Array], Array]:
    """Return a prior's quantile function; if it has none, invert the cumulative distribution."""
    try:
        jax.eval_shape(prior.icdf, jnp.asarray(0.5))
    except WITHOUT:
        return partial(_inverted, prior)
    return prior.icdf


def _inverted(prior: dist.Distribution, u: Array) -> Array:
    """Return a prior's quantile by bisection, with its derivative (the inverse of the density)."""
    onto = biject_to(prior.support)

    def halved(_: int, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = ends
        middle = 0.5 * (low + high)
        below = prior.cdf(onto(middle)) < u
        return jnp.where(below, middle, low), jnp.where(below, high, middle)

    ends = jnp.full_like(u, -FARTHEST), jnp.full_like(u, FARTHEST)
    low, high = jax.lax.fori_loop(0, HALVINGS, halved, stop_gradient(ends))
    quantile = stop_gradient(onto(0.5 * (low + high)))
    return quantile + (u - stop_gradient(u)) / jnp.exp(stop_gradient(prior.log_prob(quantile)))


def _require_quantiles(name: str, prior: Any) -> None:
    kind = type(prior).__name__
    if not isinstance(prior, dist.Distribution) or prior.batch_shape or prior.event_shape:
        raise ConfigError(
            f"The prior of `{name}` must be a NumPyro distribution of one number, but it is a "
            f"{kind}.",
            remedy=f"Write {name} = numpyro.distributions.Normal(0.0, 1.0); a vector needs one "
            "prior for each of its numbers.",
        )
    if prior.is_discrete:
        raise ConfigError(
            f"The prior of `{name}` must be of a real number, but {kind} is discrete."
        )
    middle = jnp.asarray(0.5)
    for function, at in ((prior.icdf, middle), (prior.cdf, biject_to(prior.support)(0.0 * middle))):
        try:
            jax.eval_shape(function, at)
        except WITHOUT:
            continue
        return
    raise ConfigError(
        f"The prior of `{name}` must have quantiles, but NumPyro's {kind} has neither `icdf` nor "
        "`cdf`.",
        remedy="Take a distribution with quantiles, such as Normal, LogNormal, Gamma, Beta or "
        "StudentT.",
    )
