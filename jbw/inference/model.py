"""The bridge to NumPyro: a log likelihood and a prior box become a plain model."""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpyro
import numpyro.distributions as dist
from jaxtyping import Array, Float, Key
from numpyro import handlers
from numpyro.distributions import constraints

from jbw.errors import ConfigError
from jbw.inference.box import Box

Theta = Mapping[str, Float[Array, "..."]]
Unit = dict[str, Float[Array, "..."]]
LogLikelihood = Callable[[Theta, Any], Float[Array, "..."]]
LogPrior = Callable[[Theta], Float[Array, "..."]]


def finite_or_forbidden(log_probability: Float[Array, ""]) -> Float[Array, ""]:
    """Minus infinity where a log probability is not a number or plus infinity.

    A failed solve is data for the sampler: such parameters are impossible, not an error.

    Args:
        log_probability: Log probability [nats].

    Returns:
        The same where it is finite, otherwise minus infinity.
    """
    return jnp.where(jnp.isfinite(log_probability), log_probability, -jnp.inf)


def box_model(
    log_likelihood: LogLikelihood, box: Box, log_prior: LogPrior | None = None
) -> Callable[..., None]:
    r"""NumPyro model of the posterior in a box.

    $$\log p(\theta | D) = \sum_i \log L_i(\theta; D) + \log\pi(\theta) + \mathrm{const},
    \qquad \theta \in [\theta_{min}, \theta_{max}]$$

    Args:
        log_likelihood: (theta, data) to independent terms [nats]; non-finite where a solve failed.
        box: Bounds; each name becomes a uniform site.
        log_prior: theta to a further log prior density [nats], such as an earlier step's result.

    Returns:
        A model with the one argument `data`, for any NumPyro kernel.

    Reference:
        Eqs. (32), (33), (35), (36), (37).
    """

    def model(data: Any = None) -> None:
        theta: dict[str, Any] = {
            name: numpyro.sample(name, dist.Uniform(box.lower[i], box.upper[i]))
            for i, name in enumerate(box.names)
        }
        total = jnp.sum(log_likelihood(theta, data))
        numpyro.factor("log_likelihood", finite_or_forbidden(total))
        if log_prior is not None:
            numpyro.factor("log_prior", log_prior(theta))

    return model


def in_unit_box(model: Callable[..., None], x: Unit) -> Callable[..., Any]:
    r"""The model with every site of x put at its place in the box.

    $$\theta = \theta_{min} + x\,(\theta_{max} - \theta_{min})$$

    Args:
        model: NumPyro model whose latent sites have bounded intervals.
        x: Unit coordinate [-], by site.

    Returns:
        A model with the same arguments; its log density is that of x up to a constant.
    """

    def value(site: dict[str, Any]) -> Array | None:
        if site["type"] != "sample" or site["name"] not in x:
            return None
        support = site["fn"].support
        return support.lower_bound + x[site["name"]] * (support.upper_bound - support.lower_bound)

    return handlers.substitute(model, substitute_fn=value)


def uniform_start(
    key: Key[Array, ""],
    model: Callable[..., None],
    model_args: tuple[Any, ...],
    model_kwargs: dict[str, Any] | None,
) -> Unit:
    """A point drawn uniformly in the unit box of a model.

    Args:
        key: Random key.
        model: NumPyro model.
        model_args: Arguments of the model.
        model_kwargs: Keyword arguments of the model.

    Returns:
        Unit coordinate [-], by site.

    Raises:
        ConfigError: A site has no bounded interval as its support.
    """

    def latent() -> dict[str, Array]:
        seeded = handlers.trace(handlers.seed(model, key))
        trace = seeded.get_trace(*model_args, **(model_kwargs or {}))
        sites = {n: s for n, s in trace.items() if s["type"] == "sample" and not s["is_observed"]}
        for name, site in sites.items():
            if not isinstance(site["fn"].support, type(constraints.interval(0.0, 1.0))):
                raise ConfigError(
                    f"Site `{name}` must have a bounded interval as its support, but it is "
                    f"{site['fn'].support}.",
                    remedy="Use a uniform prior, or another kernel.",
                )
        return {name: site["value"] for name, site in sites.items()}

    shapes = jax.eval_shape(latent)  # traced, not run: the likelihood may be an ODE
    keys = jax.random.split(key, len(shapes))
    return {
        name: jax.random.uniform(k, site.shape, site.dtype)
        for k, (name, site) in zip(keys, shapes.items(), strict=True)
    }
