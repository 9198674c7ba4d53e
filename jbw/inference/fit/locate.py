r"""Gaussian approximations of many posteriors at once, one per data set, under `vmap`.

The uniform prior of parameters, some by their logarithms, is replaced by a normal one of the same
variance,

$$\hat u = \arg\min_u \tfrac12 |r(u)|^2 + 6\,|u - \tfrac12|^2, \qquad
\Sigma_u = (J^T J + 12\,I)^{-1}$$

in the unit coordinate u of the box. A direction that the data do not determine then has the width
of the box and starts at its middle. The approximation affects only the speed of sampling, not the
result.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key, PyTree

from jbw.inference.space.box import Box, named
from jbw.inference.space.coordinates import Affine, Composed, Logarithms, interval, unit
from jbw.inference.space.problem import LogLikelihood, Problem, Theta
from jbw.inference.space.reparametrisation import WIDER

Residual = Callable[[Theta, PyTree], Float[Array, " values"]]
PRIOR_PRECISION = 12.0  # inverse variance of a uniform distribution of width one
BEYOND = 0.25  # distance by which the search may leave the prior range, relative to its width
# Levenberg-Marquardt: first damping, and its factors after failed and good steps.
FIRST, RISE, FALL = 1e-2, 8.0, 4.0


class Search(NamedTuple):
    """The settings of a search for a posterior's optimum by least squares.

    `logs` names the parameters that are searched by their logarithm (positive lower bounds). The
    search starts at the best of `num_looks` points of the prior.
    """

    residual: Residual
    logs: tuple[str, ...] = ()
    num_looks: int = 32
    num_steps: int = 15


def locate(
    key: Key[Array, ""], search: Search, log_likelihood: LogLikelihood, box: Box, data: PyTree
) -> Problem:
    """Find the optimum of a posterior, and return the posterior in coordinates around it."""
    outer = Logarithms(tuple(name in search.logs for name in box.names))
    lower, upper = outer.inverse(box.lower), outer.inverse(box.upper)
    inner = unit(lower, upper)
    theta = Composed((inner, outer))

    def residual(u: Float[Array, " parameter"]) -> Float[Array, " values"]:
        scaled = search.residual(named(theta.forward(u), box), data)
        return jnp.concatenate([scaled, jnp.sqrt(PRIOR_PRECISION) * (u - 0.5)])

    u = jax.random.uniform(key, (search.num_looks, len(box.names)))
    costs = jax.lax.map(lambda point: _cost(residual(point)), u, batch_size=search.num_looks)
    optimum = _descend(residual, u[jnp.argmin(costs)], search.num_steps)
    # These bounds are so wide that the sampler's logit transform is nearly linear over the prior
    # range.
    reach = WIDER * (upper - lower)
    bounds = lower - reach, upper + reach
    logit = interval(*bounds).inverse(inner.forward(optimum.u))
    x = jax.nn.sigmoid(logit)
    slope = (upper - lower) / ((bounds[1] - bounds[0]) * x * (1 - x))
    # This is the Gaussian approximation at the optimum.
    root = jnp.linalg.cholesky(optimum.jacobian.T @ optimum.jacobian)
    factor = jax.scipy.linalg.solve_triangular(root, jnp.eye(x.size), lower=True).T
    whitening = Affine(logit, slope[:, None] * factor)
    return Problem(log_likelihood, box, data, outer, *bounds, whitening, True)


def _cost(residuals: Float[Array, " values"]) -> Float[Array, ""]:
    return jnp.nan_to_num(jnp.sum(residuals**2), nan=jnp.inf)


class _Place(NamedTuple):
    """The state of a search: point, residual, Jacobian and damping."""

    u: Float[Array, " parameter"]
    residuals: Float[Array, " values"]
    jacobian: Float[Array, "values parameter"]
    damping: Float[Array, ""]


def _descend(
    residual: Callable[[Array], Array], u: Float[Array, " parameter"], num_steps: int
) -> _Place:
    """Minimise by Levenberg-Marquardt; points may lie slightly outside the prior range.

    A library's solver would contain the Jacobian in several places of its program, each compiled
    separately, which takes too long.
    """

    def both(u: Array) -> tuple[Array, Array]:
        residuals = residual(u)
        return residuals, residuals

    def step(at: _Place, i: Array) -> tuple[_Place, None]:
        normal = at.jacobian.T @ at.jacobian
        shaped = normal + at.damping * jnp.diag(jnp.diagonal(normal))
        move = jnp.linalg.solve(shaped, at.jacobian.T @ at.residuals)
        # The first step does not move the point: in this way the program contains the Jacobian only
        # once.
        u = jnp.where(i == 0, at.u, jnp.clip(at.u - move, -BEYOND, 1 + BEYOND))
        jacobian, residuals = jax.jacfwd(both, has_aux=True)(u)
        better = (_cost(residuals) < _cost(at.residuals)) | (i == 0)
        moved = _Place(u, residuals, jacobian, jnp.where(i == 0, at.damping, at.damping / FALL))
        retried = at._replace(damping=at.damping * RISE)
        return jax.tree.map(lambda a, b: jnp.where(better, a, b), moved, retried), None

    size = jax.eval_shape(residual, u).size
    first = _Place(u, jnp.ones(size), jnp.eye(size, u.size), jnp.asarray(FIRST))
    return jax.lax.scan(step, first, jnp.arange(num_steps + 1))[0]
