"""From a density that can be drawn from to the posterior: what gives the evidence starts here."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaln
from jaxtyping import Array, Float, Key
from numpyro.infer.util import log_density

from jbw.errors import ModelError
from jbw.inference.box import Box, from_unit
from jbw.inference.kernels import Problem, potential_of
from jbw.inference.laplace import HEAVY, from_logit
from jbw.inference.model import in_unit_box

FORBIDDEN = -1e30
"""Log density where the posterior is impossible: tempered by zero it is zero, not NaN."""


class Drawn(NamedTuple):
    """What a sampler without a chain leaves.

    Attributes:
        theta: Draws of equal weight by name, each (chain, draw), in the parameters' units.
        stats: Statistics of the draws, each (chain, draw).
        facts: Numbers of the whole run: log_evidence [nats] and its standard error, evaluations.
        groups: Further groups of the tree: group to variable to (dimensions, values).
    """

    theta: dict[str, Any]
    stats: dict[str, Any]
    facts: dict[str, Any]
    groups: dict[str, dict[str, Any]] = {}  # noqa: RUF012


class Bridge(NamedTuple):
    r"""A reference density r(y) and the posterior over it, in one coordinate y.

    $$Z = \int L(\theta)\,\pi(\theta)\,\mathrm{d}\theta = E_r\!\left[e^{\ell(y)}\right]$$

    Attributes:
        draw: (key, count) to draws of the reference, (count, parameter).
        log_reference: log r(y) [nats]; minus infinity outside.
        log_ratio: ell(y), log of posterior density over reference [nats]; never NaN.
        theta: y, with any leading axes, to the parameters by name.
    """

    draw: Callable[[Key[Array, ""], int], Float[Array, "count parameter"]]
    log_reference: Callable[[Float[Array, " parameter"]], Float[Array, ""]]
    log_ratio: Callable[[Float[Array, " parameter"]], Float[Array, ""]]
    theta: Callable[[Float[Array, "... parameter"]], dict[str, Array]]


def bridge(problem: Problem, whitened: bool) -> Bridge:
    """The bridge from the whole box, or from heavy tails about a Laplace approximation.

    Args:
        problem: The posterior.
        whitened: Whether its whitening comes from a covariance.

    Returns:
        From a t distribution of 5 degrees of freedom in the whitened coordinate, which has no
        bounds; or, where nothing is known, from the uniform prior in the unit box.
    """
    return _from_laplace(problem) if whitened else _from_box(problem)


def _from_box(problem: Problem) -> Bridge:
    box, d = problem.box, len(problem.box.names)

    def log_reference(x: Float[Array, " parameter"]) -> Float[Array, ""]:
        return jnp.where(jnp.all((x >= 0) & (x <= 1)), 0.0, -jnp.inf)

    def log_ratio(x: Float[Array, " parameter"]) -> Float[Array, ""]:
        sites = dict(zip(box.names, jnp.clip(x, 0.0, 1.0), strict=True))
        value = log_density(in_unit_box(problem.model, sites), (problem.data,), {}, {})[0]
        return _possible(value + log_volume(box), jnp.isfinite(log_reference(x)))

    return Bridge(
        lambda key, count: jax.random.uniform(key, (count, d)),
        log_reference,
        log_ratio,
        lambda x: from_unit(x, box),
    )


def _from_laplace(problem: Problem) -> Bridge:
    d, whitening = len(problem.box.names), problem.whitening
    potential = potential_of(problem)
    # |dz / dw|: the potential is a density of z, taken at z(w).
    log_slope = jnp.linalg.slogdet(whitening.factor)[1]

    def log_ratio(w: Float[Array, " parameter"]) -> Float[Array, ""]:
        return _possible(log_slope - potential(w) - log_heavy(w), jnp.array(True))

    def draw(key: Key[Array, ""], count: int) -> Float[Array, "count parameter"]:
        key_normal, key_scale = jax.random.split(key)
        chi_square = 2 * jax.random.gamma(key_scale, HEAVY / 2, (count, 1))
        return jax.random.normal(key_normal, (count, d)) * jnp.sqrt(HEAVY / chi_square)

    def theta(w: Float[Array, "... parameter"]) -> dict[str, Array]:
        return from_logit(whitening.centre + w @ whitening.factor.T, problem.box)

    return Bridge(draw, log_heavy, log_ratio, theta)


def log_heavy(w: Float[Array, " parameter"]) -> Float[Array, ""]:
    r"""Log density of the t distribution of kappa = 5 degrees of freedom.

    $$\log\Gamma\tfrac{\kappa + d}{2} - \log\Gamma\tfrac{\kappa}{2} - \tfrac d2 \log \pi\kappa
    - \tfrac{\kappa + d}{2} \log(1 + w^T w / \kappa)$$

    Args:
        w: Whitened coordinate.
    """
    half = (HEAVY + w.size) / 2
    constant = gammaln(half) - gammaln(HEAVY / 2) - w.size / 2 * np.log(np.pi * HEAVY)
    return constant - half * jnp.log1p(w @ w / HEAVY)


def log_volume(box: Box) -> Float[Array, ""]:
    """Logarithm of the box's volume, in the parameters' units."""
    return jnp.sum(jnp.log(box.upper - box.lower))


def _possible(value: Any, inside: Array) -> Float[Array, ""]:
    return jnp.where(inside & jnp.isfinite(value), value, FORBIDDEN)


def require_possible(possible: bool) -> None:
    """Refuse a posterior that is impossible wherever a sampler looked.

    Args:
        possible: Whether it is possible anywhere.

    Raises:
        ModelError: If it is not.
    """
    if not possible:
        raise ModelError(
            "The log likelihood is finite at no point that was looked at.",
            remedy="Check the data for NaN, the noise for zero, and the prior for parameters that "
            "the model cannot solve.",
        )
