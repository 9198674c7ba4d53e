r"""A Laplace approximation under vmap: where the posterior of one data set of many lies.

The search and the sampling go along the logarithms of chosen parameters: what is known only of a
product is a straight valley there. The uniform prior stands in for a normal one of its variance,

$$\hat u = \arg\min_u \tfrac12 |r(u)|^2 + 6\,|u - \tfrac12|^2, \qquad
\Sigma_u = (J^T J + 12\,I)^{-1}$$

in the unit coordinate u of the box, so that a direction that the data do not know has the width of
the box and its middle for a start. Nothing of this decides what is drawn, only how fast.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key, PyTree

from jbw.inference.box import Box, from_unit, to_unit
from jbw.inference.laplace import Whitening
from jbw.inference.logarithms import LOG, Inside, far_beyond
from jbw.inference.model import LogLikelihood, Theta

Residual = Callable[[Theta, PyTree], Float[Array, " values"]]
PRIOR_PRECISION = 12.0  # of a uniform distribution of width one
RISE, FALL = 8.0, 4.0  # of the damping after a step that was refused, or taken


class About(NamedTuple):
    """How to look for a posterior.

    Attributes:
        residual: (theta, data) to residuals in standard deviations.
        logs: Parameters to take the logarithm of; their lower bounds are positive.
        num_looks: Points of the prior that are looked at; the best is where the search starts.
        num_steps: Steps of the search.
    """

    residual: Residual
    logs: tuple[str, ...] = ()
    num_looks: int = 32
    num_steps: int = 15


class Located(NamedTuple):
    """A posterior in the coordinate that it is drawn in.

    Attributes:
        log_likelihood: Of that coordinate.
        log_prior: Of that coordinate, minus infinity outside the prior box.
        box: Far beyond the prior box, so that its logit is a straight line there.
        whitening: In the logit of `box`.
        theta: From that coordinate to the parameters.
    """

    log_likelihood: LogLikelihood
    log_prior: Callable[[Theta], Float[Array, ""]]
    box: Box
    whitening: Whitening
    theta: Callable[[Theta], dict[str, Array]]


def locate(
    key: Key[Array, ""], about: About, log_likelihood: LogLikelihood, box: Box, data: PyTree
) -> Located:
    """Find a posterior and the coordinate to draw it in.

    Args:
        key: Random key.
        about: How to look for it.
        log_likelihood: (theta, data) to terms [nats].
        box: Prior bounds.
        data: Whatever both functions take.

    Returns:
        The posterior.
    """
    inner = _in_logs(box, about.logs)
    outer = far_beyond(inner)

    def theta(s: Theta) -> dict[str, Array]:
        names = zip(box.names, inner.names, strict=True)
        return {name: jnp.exp(s[own]) if own != name else s[own] for name, own in names}

    def residual(u: Float[Array, " parameter"]) -> Float[Array, " values"]:
        own = about.residual(theta(from_unit(u, inner)), data)
        return jnp.concatenate([own, jnp.sqrt(PRIOR_PRECISION) * (u - 0.5)])

    u = _best_of(key, residual, len(box.names), about.num_looks)
    u = _descend(residual, u, about.num_steps)
    return Located(
        lambda s, data: log_likelihood(theta(s), data),
        Inside(inner),
        outer,
        _whitened(residual, u, inner, outer),
        theta,
    )


def _in_logs(box: Box, logs: tuple[str, ...]) -> Box:
    chosen = jnp.array([name in logs for name in box.names])

    def bound(value: Float[Array, " parameter"]) -> Float[Array, " parameter"]:
        return jnp.where(chosen, jnp.log(jnp.where(chosen, value, 1.0)), value)

    names = tuple(LOG + name if name in logs else name for name in box.names)
    return Box(names, bound(box.lower), bound(box.upper))


def _best_of(
    key: Key[Array, ""], residual: Callable[[Array], Array], size: int, num_looks: int
) -> Float[Array, " parameter"]:
    """The point of least cost among draws of the prior."""
    u = jax.random.uniform(key, (num_looks, size))
    return u[jnp.argmin(jax.lax.map(lambda one: _cost(residual(one)), u, batch_size=num_looks))]


def _cost(left: Float[Array, " values"]) -> Float[Array, ""]:
    return jnp.nan_to_num(jnp.sum(left**2), nan=jnp.inf)


def _descend(
    residual: Callable[[Array], Array], u: Float[Array, " parameter"], num_steps: int
) -> Float[Array, " parameter"]:
    """Levenberg and Marquardt's descent, inside the box."""

    def step(carry: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], None]:
        u, damping = carry
        left, jacobian = _linear(residual, u)
        normal = jacobian.T @ jacobian
        shaped = normal + damping * jnp.diag(jnp.diagonal(normal))
        there = jnp.clip(u - jnp.linalg.solve(shaped, jacobian.T @ left), 0.0, 1.0)
        better = _cost(residual(there)) < _cost(left)
        damping = jnp.where(better, damping / FALL, damping * RISE)
        return (jnp.where(better, there, u), damping), None

    return jax.lax.scan(step, (u, jnp.asarray(1e-2)), None, num_steps)[0][0]


def _linear(
    residual: Callable[[Array], Array], u: Float[Array, " parameter"]
) -> tuple[Float[Array, " values"], Float[Array, "values parameter"]]:
    """Residual and Jacobian in one pass."""

    def both(u: Array) -> tuple[Array, Array]:
        left = residual(u)
        return left, left

    jacobian, left = jax.jacfwd(both, has_aux=True)(u)
    return left, jacobian


def _whitened(
    residual: Callable[[Array], Array], u: Float[Array, " parameter"], inner: Box, outer: Box
) -> Whitening:
    _, jacobian = _linear(residual, u)
    root = jnp.linalg.cholesky(jacobian.T @ jacobian)
    factor = jax.scipy.linalg.solve_triangular(root, jnp.eye(u.size), lower=True).T
    x = to_unit(from_unit(u, inner), outer)
    share = (inner.upper - inner.lower) / (outer.upper - outer.lower)
    slope = share / (x * (1 - x))  # of the logit of the outer box over u
    return Whitening(jnp.log(x) - jnp.log1p(-x), slope[:, None] * factor)
