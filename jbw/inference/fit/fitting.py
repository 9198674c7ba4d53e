"""Least squares within bounds from many starts: optimum, covariance, undetermined directions."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Key, PyTree
from numpy.typing import NDArray

from jbw.errors import ConfigError, ModelError
from jbw.inference.fit.identifiability import WeakDirection, weak_direction
from jbw.inference.space.box import Box, from_unit, require_float64

Residual = Callable[[Mapping[str, Array], Any], Float[Array, " residual"]]
BOX_STD = 1 / np.sqrt(12)  # standard deviation of a normalised parameter that is uniform
# relative and absolute tolerance of the sum of squares and of the parameters' logits
TOLERANCE = 1e-9
MOST_STEPS = 256
# If an optimum is closer to a bound than this fraction of the prior's width, it may lie beyond.
NEAR_BOUND = 0.01
THINNEST = 1e-14  # smallest eigenvalue of a correlation matrix
START_MARGIN = 1e-3  # smallest distance of starts from a bound, because the logit is infinite there


@dataclass(frozen=True)
class Fit:
    """The best of several least-squares fits, with covariance and undetermined directions.

    Attributes:
        theta: Optimum by name, in the parameters' units; x is the optimum in the unit coordinate of
            the box.
        cost: Half the sum of squared residuals.
        covariance: Gauss-Newton covariance in the parameters' units; in no direction wider than the
            box.
        at_bound: Parameters whose optimum lies on or beyond a bound: "lower" or "upper".
        weak: Directions that the data do not determine, or None.
        waterfall: Costs reached from all starts, lowest first; infinite where a start failed.
        residual: Residual at the optimum, in standard deviations.
        jacobian: Derivatives of the residual by the parameters, in the order of the box.
        num_refused: Number of points of the search whose residual or Jacobian was not finite.
    """

    theta: dict[str, float]
    x: NDArray[np.float64]
    cost: float
    covariance: NDArray[np.float64]
    at_bound: dict[str, str]
    weak: WeakDirection | None
    waterfall: NDArray[np.float64]
    residual: Float[np.ndarray, " residual"]
    jacobian: Float[np.ndarray, "residual parameter"]
    num_refused: int = 0

    @property
    def chi_square(self) -> tuple[float, int]:
        """The sum of squared residuals, and its degrees of freedom."""
        return 2 * self.cost, len(self.residual) - len(self.x)


def to_first_order(
    quantities: Callable[[Mapping[str, Array]], Mapping[str, Array]], best: Fit
) -> tuple[dict[str, float], dict[str, float]]:
    r"""Return functions of a fit's parameters, with standard deviations by linearisation.

    $$\sigma_q = \sqrt{g^T C g}, \qquad g = \partial q / \partial\theta$$
    """

    def at(x: Float[Array, " parameter"]) -> dict[str, Array]:
        return dict(quantities(dict(zip(best.theta, x, strict=True))))

    x = jnp.asarray(list(best.theta.values()))
    values, gradients = at(x), jax.device_get(jax.jacfwd(at)(x))

    def std(g: Float[np.ndarray, " parameter"]) -> float:
        return float(np.sqrt(g @ best.covariance @ g))

    by_name = {name: float(value) for name, value in values.items()}
    return by_name, {name: std(gradients[name]) for name in by_name}


def fit(
    residual: Residual,
    box: Box,
    data: PyTree = None,
    *,
    starts: int | Mapping[str, Any] = 8,
    key: Key[Array, ""] | None = None,
) -> Fit:
    r"""Minimise a sum of squares within bounds by Levenberg-Marquardt, from many starts.

    $$\min_u \tfrac12 |r(\theta_{min} + (\theta_{max} - \theta_{min})\,\mathrm{sigmoid}(u))|^2$$

    The residual is a function of (theta, data) that returns real numbers in standard deviations. It
    is compiled once for given names and shapes. Starts are given by name, or as a number of points
    that the key draws uniformly in the box.

    Reference:
        Section 3.1, in place of its sequential quadratic programming.
    """
    require_float64()
    ends, end_costs = _solve(residual, box, data, _starts(starts, box, key))
    costs = np.where(np.isfinite(end_costs), end_costs, np.inf)
    num_refused = 0
    for best in np.argsort(costs, kind="stable"):
        if not np.isfinite(costs[best]):
            break
        jacobian, r = map(np.asarray, linearise(residual, ends[best], box, data))
        if np.all(np.isfinite(jacobian)):
            optimum = describe_optimum(np.asarray(ends[best]), r, jacobian, box, costs)
            return replace(optimum, num_refused=num_refused)
        num_refused += 1
        costs[best] = np.inf
    raise ModelError(
        f"The residual and its derivatives are not finite at the end of any of the {len(costs)} "
        "fits.",
        remedy="Check the data for NaN. Check whether the prior bounds contain parameters for "
        "which the model has no solution.",
    )


def describe_optimum(
    x: NDArray[np.float64],
    residual: Float[np.ndarray, " residual"],
    jacobian: Float[np.ndarray, "residual parameter"],
    box: Box,
    costs: NDArray[np.float64],
) -> Fit:
    """Return a `Fit` from its optimum, residual and Jacobian."""
    values, rows = svd_of_all(jacobian)
    # In no direction is the Gaussian allowed to be wider than the prior.
    root = rows.T / np.maximum(values, 1 / BOX_STD)
    width = np.asarray(box.upper) - np.asarray(box.lower)
    covariance = _definite(root @ root.T * np.outer(width, width))
    theta = {name: float(value) for name, value in from_unit(np.asarray(x), box).items()}
    return Fit(
        theta, x, float(np.min(costs)), covariance,
        at_bound=_at_bound(x, jacobian, residual, box.names),
        weak=weak_direction(theta, covariance, box),
        waterfall=np.sort(costs), residual=residual, jacobian=jacobian / width,
    )  # fmt: skip


def _definite(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a covariance, made positive definite if rounding has made it indefinite.

    If a sum is determined far better than its terms, rounding may make an eigenvalue of the
    correlations negative.
    """
    std = np.sqrt(np.diagonal(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(std, std))
    if values[0] >= THINNEST:
        return covariance
    return (vectors * np.maximum(values, THINNEST)) @ vectors.T * np.outer(std, std)


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
        x = named_starts(starts, box)
    return jnp.clip(x, START_MARGIN, 1 - START_MARGIN)


def named_starts(starts: Mapping[str, Any], box: Box) -> Float[np.ndarray, "start parameter"]:
    """Return normalised coordinates of starts given by name, as one value or one per start."""
    columns = np.broadcast_arrays(*(np.atleast_1d(starts[name]) for name in box.names))
    lower, upper = np.asarray(box.lower), np.asarray(box.upper)
    return (np.stack(columns, axis=-1) - lower) / (upper - lower)


@eqx.filter_jit
def _solve(
    residual: Residual, box: Box, data: PyTree, x_starts: Float[Array, "start parameter"]
) -> tuple[Float[Array, "start parameter"], Float[Array, " start"]]:
    """Minimise from each start; return the end points and their costs."""
    solver = optx.LevenbergMarquardt(rtol=TOLERANCE, atol=TOLERANCE)

    def of_logit(u: Array, data: PyTree) -> Array:
        return real(residual(from_unit(jax.nn.sigmoid(u), box), data))

    def from_start(x: Array) -> tuple[Array, Array]:
        u = jax.scipy.special.logit(x)
        end = optx.least_squares(of_logit, solver, u, data, max_steps=MOST_STEPS, throw=False).value
        return jax.nn.sigmoid(end), 0.5 * jnp.sum(of_logit(end, data) ** 2)

    # Starts run one after another, because each takes a different number of steps.
    return jax.lax.map(from_start, x_starts)


@eqx.filter_jit
def linearise(
    residual: Residual, x: Float[Array, " parameter"], box: Box, data: PyTree
) -> tuple[Float[Array, "residual parameter"], Float[Array, " residual"]]:
    """Return the Jacobian with respect to normalised coordinates x, and the residual."""

    def both(x: Array) -> tuple[Array, Array]:
        residuals = real(residual(from_unit(x, box), data))
        return residuals, residuals

    return jax.jacfwd(both, has_aux=True)(x)


def real(residual: Array) -> Float[Array, " residual"]:
    """Return the residual as a vector; raise a ConfigError if it is complex."""
    if jnp.iscomplexobj(residual):
        raise ConfigError(
            "The residual must be real, but it is complex.",
            remedy="Return jnp.concatenate([r.real, r.imag]).",
        )
    return residual.ravel()


def svd_of_all(
    jacobian: Float[np.ndarray, "residual parameter"],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a Jacobian's singular values, one per parameter, and right singular vectors (rows)."""
    # With added rows of zeros, a direction that the data do not constrain has the singular value 0.
    missing = max(0, jacobian.shape[1] - len(jacobian))
    padded = np.vstack([jacobian, np.zeros((missing, jacobian.shape[1]))])
    return np.linalg.svd(padded, full_matrices=False)[1:]


def _at_bound(
    x: NDArray[np.float64],
    jacobian: Float[np.ndarray, "residual parameter"],
    residual: Float[np.ndarray, " residual"],
    names: tuple[str, ...],
) -> dict[str, str]:
    """Return the parameters close to a bound that the next Newton step would reach or cross."""
    curvature = np.sum(jacobian**2, axis=0)
    newton_end = x - (jacobian.T @ residual) / np.where(curvature > 0, curvature, np.inf)
    lower = (x < NEAR_BOUND) & (newton_end <= 0)
    upper = (x > 1 - NEAR_BOUND) & (newton_end >= 1)
    sides = np.where(lower, "lower", np.where(upper, "upper", "")).tolist()
    return {name: side for name, side in zip(names, sides, strict=True) if side}
