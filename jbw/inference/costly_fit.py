"""Least squares for residuals that cost a simulation: one compiled Jacobian, few evaluations.

`jbw.inference.fitting.fit` compiles the whole iteration, which pays where a residual is cheap and
starts are many. Compiling a solver's derivatives several times over would cost more than the fit.
"""

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares

from jbw.errors import ModelError
from jbw.inference.box import Box, from_unit, to_unit
from jbw.inference.fitting import START_MARGIN, Fit, Residual, describe_optimum
from jbw.inference.precision import require_float64

TOLERANCE = 1e-10  # of the cost and of the step, relative


def costly_fit(
    residual: Residual,
    box: Box,
    data: PyTree = None,
    *,
    starts: Mapping[str, Any],
    max_evaluations: int = 60,
    tolerance: float = TOLERANCE,
) -> Fit:
    """Minimise a sum of squares in the box by scipy's trust region, one start after the other.

    Residual and Jacobian come from one function, compiled once for a `residual`, names and shapes.
    The search goes along the logarithms of parameters with positive bounds: what is known only of a
    product is a straight valley there, and a curved one in the parameters themselves.

    Args:
        residual: (theta, data) to real residuals in units of their standard deviation.
        box: Bounds.
        data: Whatever `residual` takes.
        starts: The starts by name, one value or one a start.
        max_evaluations: Evaluations from each start at most.
        tolerance: Relative tolerance on the cost and on the step.

    Returns:
        The best fit.

    Raises:
        ConfigError: A float32 session.
        ModelError: The residual is finite at no start.

    Reference:
        Section 3.1, in place of its sequential quadratic programming; Branch, Coleman and Li
        (1999), SIAM J. Sci. Comput. 21, 1.
    """
    require_float64()
    values = np.broadcast_arrays(*(np.atleast_1d(starts[name]) for name in box.names))
    x_starts = to_unit(dict(zip(box.names, map(jnp.asarray, values), strict=True)), box)
    linear, along = coordinates(box)
    part = evaluator(residual, box, data)

    def one(s: NDArray[np.float64]) -> OptimizeResult | None:
        if not np.all(np.isfinite(part(s, 0))):
            return None
        return least_squares(
            lambda s: np.nan_to_num(part(s, 0), nan=1e100, posinf=1e100, neginf=-1e100),
            s,
            lambda s: part(s, 1),  # pyright: ignore[reportArgumentType]
            bounds=(0.0, 1.0),
            x_scale="jac",
            max_nfev=max_evaluations,
            ftol=tolerance,
            xtol=tolerance,
            gtol=1e-15,
        )

    inside = np.clip(along(np.asarray(x_starts)), START_MARGIN, 1 - START_MARGIN)
    found = [one(s) for s in inside]
    costs = np.array([np.inf if each is None else each.cost for each in found])
    best = found[int(np.argmin(costs))]
    if best is None:
        raise ModelError(
            f"The residual is finite at none of the {len(costs)} starts.",
            remedy="Check the data for NaN, and the bounds for parameters that cannot be solved.",
        )
    x, slope = linear(np.asarray(best.x))
    jacobian = part(best.x, 1) / slope
    return describe_optimum(x, part(best.x, 0), jacobian, box, costs, bool(best.success))


def evaluator(
    residual: Residual, box: Box, data: PyTree
) -> Callable[[NDArray[np.float64], int], NDArray[np.float64]]:
    """Residual (0) or Jacobian with respect to s (1), as a function of s and which of the two.

    Args:
        residual: (theta, data) to residuals.
        box: Bounds.
        data: Whatever `residual` takes.
    """
    linear, _ = coordinates(box)

    @lru_cache(maxsize=1)  # scipy asks for the residual and then for the Jacobian at one point
    def at(s: tuple[float, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        x, slope = linear(np.array(s))
        jacobian, left = linearise(residual, jnp.asarray(x), box, data)
        return np.asarray(left), np.asarray(jacobian) * slope

    def part(s: NDArray[np.float64], which: int) -> NDArray[np.float64]:
        return at(tuple(s.tolist()))[which]

    return part


def coordinates(box: Box) -> tuple[Callable, Callable]:
    r"""Between the unit coordinate x and that of the search, s.

    $$\theta = \theta_{min} (\theta_{max} / \theta_{min})^s$$

    where the bounds are positive, and s = x otherwise.

    Args:
        box: Bounds.

    Returns:
        From s to x with dx / ds, and from x to s.
    """
    lower, upper = np.asarray(box.lower), np.asarray(box.upper)
    positive = lower > 0
    start = np.where(positive, lower, 1.0)
    log_ratio = np.log(np.where(positive, upper, 2.0) / start)
    share = start / np.where(positive, upper - lower, 1.0)

    def linear(s: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        x = np.where(positive, share * np.expm1(log_ratio * s), s)
        slope = np.where(positive, share * log_ratio * np.exp(log_ratio * s), 1.0)
        return np.clip(x, 0.0, 1.0), slope

    def along(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(positive, np.log1p(np.where(positive, x / share, 0.0)) / log_ratio, x)

    return linear, along


@eqx.filter_jit
def linearise(
    residual: Residual, x: Float[Array, " parameter"], box: Box, data: PyTree
) -> tuple[Float[Array, "residual parameter"], Float[Array, " residual"]]:
    """Jacobian with respect to x and residual, in one pass."""

    def both(x: Array) -> tuple[Array, Array]:
        left = residual(from_unit(x, box), data)
        return left, left

    return jax.jacfwd(both, has_aux=True)(x)
