r"""Sampling along the logarithms of positive parameters, where what is known is their product.

A product known far better than its factors is a straight valley of the logarithms and a bent one
of the parameters themselves, which nothing whitened by one covariance follows. The density is
carried over with its Jacobian, so that the posterior stays the same:

$$p(\log\theta) = p(\theta)\,\theta$$
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float

from jbw.inference.box import Box, box, to_unit
from jbw.inference.fitting import Fit
from jbw.inference.model import LogLikelihood
from jbw.inference.posterior import in_parameters

LOG = "log "  # before the name of a parameter
CERTAIN = 3.0  # conditional standard deviations from zero: then zero is out of the question
WIDER = 10.0  # times the box's width to either side
FLOOR = 1e-6  # of the optimum: where a lower bound of zero is put


def in_logarithms(best: Fit, prior: Box) -> tuple[str, ...]:
    """Parameters to sample along their logarithms: those that cannot be zero.

    Args:
        best: The fit.
        prior: Its box.
    """
    conditional = 1 / np.sqrt(np.diag(np.linalg.inv(best.covariance)))
    return tuple(
        name
        for name, low, std in zip(prior.names, prior.lower, conditional, strict=True)
        if low > 0 or (low == 0 and best.theta[name] > CERTAIN * std)
    )


class Inside(eqx.Module):
    r"""Log prior density of the logarithms, minus infinity outside the box.

    $$\log p = \sum_i \log\theta_i, \qquad \theta_{min} < \theta < \theta_{max}$$

    over the parameters that are given by their logarithms.

    Attributes:
        box: The box, those parameters by their logarithms.
    """

    box: Box

    def __call__(self, theta: Mapping[str, Array]) -> Float[Array, ""]:
        """Log density at a point [nats]."""
        x = to_unit(theta, self.box)
        jacobian = sum(v for name, v in theta.items() if name.startswith(LOG))
        return jnp.where(jnp.all((x > 0) & (x < 1)), jacobian, -jnp.inf)


def log_box(prior: Box, logs: tuple[str, ...], start: Mapping[str, float]) -> Box:
    """The box with some parameters by their logarithms.

    Args:
        prior: The box.
        logs: The parameters.
        start: The optimum, which says how near to zero a bound of zero may be put.
    """
    bounds = {}
    for name, low, high in zip(prior.names, prior.lower, prior.upper, strict=True):
        if name in logs:
            least = max(float(low), FLOOR * start[name])
            bounds[LOG + name] = (float(np.log(least)), float(np.log(high)))
        else:
            bounds[name] = (float(low), float(high))
    return box(bounds)


def far_beyond(inner: Box) -> Box:
    """A box so wide that the sampler's logit of it is a straight line over the inner one.

    A logit that bends bends the ridges with it.
    """
    reach = WIDER * (inner.upper - inner.lower)
    return Box(inner.names, inner.lower - reach, inner.upper + reach)


def log_start(
    best: Fit, prior: Box, logs: tuple[str, ...]
) -> tuple[dict[str, float], Float[np.ndarray, "parameter parameter"]]:
    r"""The optimum and its covariance by the logarithms, $\Sigma_{ij} / (\theta_i \theta_j)$."""
    value = np.array([best.theta[name] for name in prior.names])
    chosen = np.array([name in logs for name in prior.names])
    scale = np.where(chosen, 1 / np.where(chosen, value, 1.0), 1.0)
    start = {
        LOG + name if name in logs else name: float(np.log(v) if name in logs else v)
        for name, v in zip(prior.names, value, strict=True)
    }
    return start, best.covariance * np.outer(scale, scale)


def from_logs(theta: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters of which some are given by their logarithms."""
    return {
        name.removeprefix(LOG): jnp.exp(v) if name.startswith(LOG) else v
        for name, v in theta.items()
    }


@lru_cache
def of_logs(log_likelihood: LogLikelihood) -> LogLikelihood:
    """The log likelihood as a function of parameters by their logarithms; one for each."""

    def carried(theta: Mapping[str, Array], data: Any) -> Float[Array, " term"]:
        return log_likelihood(from_logs(theta), data)

    return carried


def back_from_logs(
    tree: xr.DataTree, prior: Box, attrs: Mapping[str, Mapping[str, str]]
) -> xr.DataTree:
    """A posterior sampled along logarithms, in the parameters themselves.

    Args:
        tree: What the sampler left.
        prior: The box of the parameters.
        attrs: `units` and `long_name` by parameter.
    """
    drawn = tree["posterior"].to_dataset()
    values = {
        name: np.exp(drawn[LOG + name].values) if LOG + name in drawn else drawn[name].values
        for name in prior.names
    }
    return in_parameters(tree, values, prior, attrs)
