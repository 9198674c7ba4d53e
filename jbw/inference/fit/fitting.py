"""Least squares in the box, from many starts: the optimum, its covariance, what is weak."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Key, PyTree
from numpy.typing import NDArray

from jbw.errors import ConfigError, ModelError
from jbw.inference.fit.identifiability import WeakDirection, weak_direction
from jbw.inference.space.box import Box, from_unit, require_float64, to_unit

Residual = Callable[[Mapping[str, Array], Any], Float[Array, " residual"]]
BOX_STD = 1 / np.sqrt(12)  # of a uniform x
NEAR_BOUND = 0.01  # of the box, where the optimum may lie beyond the bound
START_MARGIN = 1e-3  # of the box: on a bound itself the logit is infinite and its slope zero


@dataclass(frozen=True)
class Fit:
    """The best of many least-squares fits.

    Attributes:
        theta: Optimum by name, in the parameters' units.
        x: Optimum in the unit coordinate, in the order of the box.
        cost: Half the sum of squared residuals.
        num_residuals: Length of the residual.
        covariance: Gauss-Newton covariance in the parameters' units, for residuals in units of
            their standard deviation; directions known worse than the box have the box's.
        singular_values: Of the Jacobian with respect to x, largest first.
        converged: Whether the best fit met its tolerance.
        at_bound: Parameters whose optimum lies on or beyond a bound: "lower" or "upper".
        weak: What the data do not determine, or None.
        waterfall: Costs reached from all starts, lowest first; infinite where a start failed.
        residual: Residuals at the optimum, in units of their standard deviation.
        jacobian: Their derivatives by the parameters, in the order of the box.
    """

    theta: dict[str, float]
    x: NDArray[np.float64]
    cost: float
    num_residuals: int
    covariance: NDArray[np.float64]
    singular_values: NDArray[np.float64]
    converged: bool
    at_bound: dict[str, str]
    weak: WeakDirection | None
    waterfall: NDArray[np.float64]
    residual: Float[np.ndarray, " residual"]
    jacobian: Float[np.ndarray, "residual parameter"]

    @property
    def condition(self) -> float:
        """Largest over smallest singular value of the Jacobian with respect to x."""
        smallest = self.singular_values[-1]
        return float(self.singular_values[0] / smallest) if smallest > 0 else float("inf")

    @property
    def chi_square(self) -> tuple[float, int]:
        """Sum of squared residuals and its degrees of freedom."""
        return 2 * self.cost, self.num_residuals - len(self.x)


class _Solution(NamedTuple):
    x: Float[Array, "start parameter"]
    cost: Float[Array, " start"]
    converged: Bool[Array, " start"]


def fit(
    residual: Residual,
    box: Box,
    data: PyTree = None,
    *,
    starts: int | Mapping[str, Any] = 8,
    key: Key[Array, ""] | None = None,
    max_steps: int = 256,
    rtol: float = 1e-9,
    atol: float = 1e-9,
) -> Fit:
    r"""Minimise a sum of squares in the box by Levenberg-Marquardt from many starts.

    $$\min_u \tfrac12 |r(\theta_{min} + (\theta_{max} - \theta_{min})\,\mathrm{sigmoid}(u))|^2$$

    Compiled once for a `residual`, names and shapes.

    Args:
        residual: (theta, data) to real residuals in units of their standard deviation; stack the
            real and imaginary parts of complex ones.
        box: Bounds.
        data: Whatever `residual` takes.
        starts: How many starts to draw uniformly in the box, or the starts by name.
        key: Random key of drawn starts.
        max_steps: Steps from each start at most.
        rtol: Relative tolerance on the cost and the logit u.
        atol: Absolute tolerance on the same.

    Returns:
        The best fit.

    Raises:
        ConfigError: No usable starts, complex residuals, or a float32 session.
        ModelError: The residual is finite at no start.

    Reference:
        Section 3.1, in place of its sequential quadratic programming.
    """
    require_float64()
    x_starts = _starts(starts, box, key)
    solution = _solve(residual, box, data, x_starts, rtol, atol, max_steps)
    costs = np.where(np.isfinite(solution.cost), solution.cost, np.inf)
    best = int(np.argmin(costs))
    if not np.isfinite(costs[best]):
        raise ModelError(
            f"The residual is finite at none of the {len(costs)} fits' ends.",
            remedy="Check the data for NaN, and the bounds for parameters that cannot be solved.",
        )
    jacobian, r = map(np.asarray, linearise(residual, solution.x[best], box, data))
    x = np.asarray(solution.x[best])
    return describe_optimum(x, r, jacobian, box, costs, bool(solution.converged[best]))


def describe_optimum(
    x: NDArray[np.float64],
    residual: Float[np.ndarray, " residual"],
    jacobian: Float[np.ndarray, "residual parameter"],
    box: Box,
    costs: NDArray[np.float64],
    converged: bool,
) -> Fit:
    """The record of an optimum x, however it was found."""
    covariance_x, singular_values = _covariance(jacobian)
    width = np.asarray(box.upper - box.lower)
    covariance = covariance_x * np.outer(width, width)
    theta = {name: float(value) for name, value in from_unit(jnp.asarray(x), box).items()}
    return Fit(
        theta, x, float(np.min(costs)), len(residual), covariance, singular_values, converged,
        at_bound=_at_bound(x, jacobian, residual, box.names),
        weak=weak_direction(theta, covariance, box),
        waterfall=np.sort(costs), residual=residual, jacobian=jacobian / width,
    )  # fmt: skip


def _starts(
    starts: int | Mapping[str, Any], box: Box, key: Key[Array, ""] | None
) -> Float[Array, "start parameter"]:
    if not isinstance(starts, Mapping):
        if starts < 1 or key is None:
            raise ConfigError(
                f"Argument `starts` must be positive and come with a `key`, but is {starts}.",
                remedy="Pass key=jax.random.key(0), or the starts by name.",
            )
        x = jax.random.uniform(key, (starts, len(box.names)))
    else:
        if set(starts) != set(box.names):
            raise ConfigError(
                f"Argument `starts` must name {', '.join(box.names)}, "
                f"but it names {', '.join(map(str, starts))}."
            )
        values = np.broadcast_arrays(*(np.atleast_1d(starts[name]) for name in box.names))
        x = to_unit(dict(zip(box.names, map(jnp.asarray, values), strict=True)), box)
    return jnp.clip(x, START_MARGIN, 1 - START_MARGIN)


@eqx.filter_jit
def _solve(
    residual: Residual,
    box: Box,
    data: PyTree,
    x_starts: Float[Array, "start parameter"],
    rtol: float,
    atol: float,
    max_steps: int,
) -> _Solution:
    solver = optx.LevenbergMarquardt(rtol=rtol, atol=atol)

    def of_logit(u: Array, data: PyTree) -> Array:
        return _real(residual(from_unit(jax.nn.sigmoid(u), box), data))

    def one(x: Array) -> _Solution:
        u = jax.scipy.special.logit(x)
        found = optx.least_squares(of_logit, solver, u, data, max_steps=max_steps, throw=False)
        r = of_logit(found.value, data)
        success = found.result == optx.RESULTS.successful
        return _Solution(jax.nn.sigmoid(found.value), 0.5 * jnp.sum(r**2), success)

    # One after another: each start takes its own number of steps, and a solver runs unbatched.
    return jax.lax.map(one, x_starts)


@eqx.filter_jit
def linearise(
    residual: Residual, x: Float[Array, " parameter"], box: Box, data: PyTree
) -> tuple[Float[Array, "residual parameter"], Float[Array, " residual"]]:
    """Jacobian with respect to the unit coordinate x, and residual, in one pass."""

    def both(x: Array) -> tuple[Array, Array]:
        left = _real(residual(from_unit(x, box), data))
        return left, left

    return jax.jacfwd(both, has_aux=True)(x)


def _real(residual: Array) -> Float[Array, " residual"]:
    if jnp.iscomplexobj(residual):
        raise ConfigError(
            "The residual must be real, but it is complex.",
            remedy="Return jnp.concatenate([r.real, r.imag]).",
        )
    return residual.ravel()


def _covariance(
    jacobian: Float[np.ndarray, "residual parameter"],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Inverse of J^T J, with no direction wider than the box, and the singular values of J."""
    num_parameters = jacobian.shape[1]
    # Rows of zeros make a wide Jacobian square: a direction without data has the singular value 0.
    padding = np.zeros((max(0, num_parameters - len(jacobian)), num_parameters))
    _, values, rows = np.linalg.svd(np.vstack([jacobian, padding]), full_matrices=False)
    root = rows.T / np.maximum(values, 1 / BOX_STD)
    return root @ root.T, values


def _at_bound(
    x: NDArray[np.float64],
    jacobian: Float[np.ndarray, "residual parameter"],
    residual: Float[np.ndarray, " residual"],
    names: tuple[str, ...],
) -> dict[str, str]:
    """Parameters near a bound whose own Newton step leads onto it or beyond."""
    curvature = np.sum(jacobian**2, axis=0)
    step = -(jacobian.T @ residual) / np.where(curvature > 0, curvature, np.inf)
    found = {}
    for i, name in enumerate(names):
        if x[i] < NEAR_BOUND and x[i] + step[i] <= 0:
            found[name] = "lower"
        if x[i] > 1 - NEAR_BOUND and x[i] + step[i] >= 1:
            found[name] = "upper"
    return found
