"""Least squares for costly residuals such as simulations, evaluated in parallel."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float, PyTree
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares

from jbw.errors import ModelError
from jbw.inference.fit.fitting import (
    START_MARGIN,
    Fit,
    Residual,
    describe_optimum,
    named_starts,
    real,
)
from jbw.inference.lanes import (
    FIT_LANES,
    Evaluate,
    Solved,
    at_points,
    seeing,
    seen_by,
    side_by_side,
    solved_first,
)
from jbw.inference.space.box import Box, named, require_float64
from jbw.inference.space.coordinates import Composed, Logarithms, Sinh, unit

Part = Callable[[NDArray[np.float64], int], NDArray[np.float64]]
TOLERANCE = 1e-10  # relative tolerance of the sum of squares and of the step
# step of a difference in the search coordinate (0 to 1): truncation error 1e-10, rounding error
# 1e-11
STEP = 1e-5
# Widest finite difference at an optimum, in the search coordinate. Over wider differences,
# residuals are not linear.
WIDEST = 0.02
# If wider differences change no standard error by more than the factor SAME, they are not needed.
# Otherwise, differences are widened until errors change by less than the factor SETTLED.
# MOST_WIDENINGS is the largest number of widenings.
SAME, SETTLED, MOST_WIDENINGS = 1.2, 1.02, 12
TINY = 1e-40  # imaginary step of a derivative
UNIFORM = 12.0  # inverse variance of a uniform prior on the unit cube
# A residual of this size or more is rejected, because its square may overflow.
OUT_OF_REACH = 1e100
# A hyperbolic sine serves as search coordinate for a parameter whose lower bound is zero or less.
# Above this fraction of the upper bound, the coordinate is nearly a logarithm.
NEAR_ZERO = 0.01
# This coordinate is used only if the lower bound's magnitude is below this fraction of the upper
# bound.
LOPSIDED = 0.5


def costly_fit(
    residual: Residual,
    box: Box,
    data: PyTree = None,
    *,
    starts: Mapping[str, Any],
    max_evaluations: int = 60,
    tolerance: float = TOLERANCE,
) -> Fit:
    """Minimise a sum of squares within bounds by scipy's trust region, from one or more starts.

    Residual and Jacobian come from one program, compiled once for a `residual`, names and shapes.
    Starts are given by name, as one value or one value per start. `max_evaluations` applies to each
    start. The tolerance is relative, on the cost and on the step.

    Reference:
        Section 3.1, in place of its sequential quadratic programming; Branch, Coleman and Li
        (1999), SIAM J. Sci. Comput. 21, 1.
    """
    fits = costly_fits(
        residual, box, data, starts=starts, max_evaluations=max_evaluations, tolerance=tolerance
    )
    best = min(fits, key=lambda end: end.cost)
    costs = np.sort(np.concatenate([end.waterfall for end in fits]))
    return replace(best, waterfall=costs, num_refused=sum(end.num_refused for end in fits))


def costly_fits(
    residual: Residual,
    box: Box,
    data: PyTree,
    *,
    starts: Mapping[str, Any],
    max_evaluations: int,
    tolerance: float,
) -> list[Fit]:
    """Fit from each start separately; skip starts that are rejected.

    If all starts are rejected, a ModelError is raised. All starts are solved in parallel.
    """
    require_float64()
    evaluate = rows_of(residual, box, data)
    return fits_of(
        evaluate, box, starts=starts, max_evaluations=max_evaluations, tolerance=tolerance
    )


def fits_of(
    evaluate: Evaluate,
    box: Box,
    *,
    starts: Mapping[str, Any],
    max_evaluations: int,
    tolerance: float,
) -> list[Fit]:
    """Fit from each start separately; the residual is a function of search coordinates."""
    inside = np.stack([to_search(start, box) for start in named_starts(starts, box)])

    def from_start(start: NDArray[np.float64], evaluate: Evaluate) -> Fit | None:
        return _fitted(start, evaluate, box, max_evaluations, tolerance)

    starting = [*np.clip(inside, START_MARGIN, 1 - START_MARGIN)]
    ends = side_by_side(from_start, starting, evaluate)
    fits = [end for end in ends if end is not None]
    if not fits:
        raise ModelError(
            f"The residual is not finite at any of the {len(ends)} starts.",
            remedy="Check the data with `jbw check` for swapped channels, wrong units and NaN. "
            "Check whether the prior bounds contain parameters for which the model has no "
            "solution.",
        )
    first, num_refused = fits[0], len(ends) - len(fits)
    return [
        replace(
            first,
            num_refused=first.num_refused + num_refused,
            waterfall=np.append(first.waterfall, np.full(num_refused, np.inf)),
        ),
        *fits[1:],
    ]


def _fitted(
    start: NDArray[np.float64],
    evaluate: Evaluate,
    box: Box,
    max_evaluations: int,
    tolerance: float,
) -> Fit | None:
    """Fit from one start in normalised coordinates; return None if the start is rejected."""
    part = part_of(evaluate)
    end = trust_region(part, start, max_evaluations, tolerance)
    if not np.isfinite(end.cost):
        return None
    x, slope = from_search(end.x, box)
    jacobian = part(end.x, 1)
    if tolerance <= TOLERANCE:
        jacobian = wide_enough(
            jacobian, lambda steps: _with_differences(evaluate, end.x, steps)[1], end.x
        )
    optimum = describe_optimum(x, part(end.x, 0), jacobian / slope, box, np.array([end.cost]))
    return replace(optimum, num_refused=end.num_refused)


def wide_enough(
    jacobian: Float[np.ndarray, "residual parameter"],
    differences: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    s: NDArray[np.float64],
) -> Float[np.ndarray, "residual parameter"]:
    r"""Return the Jacobian by differences; widen steps to a standard deviation if 1e-5 is unsafe.

    $$h_i = 1 / \lVert J_i \rVert$$

    Turning points of a motion may appear or vanish within a solver step, and its residual then
    jumps slightly. Over a difference of 1e-5 such a jump looks like a steep slope, with a far too
    small standard error.
    """
    before, h = jacobian, np.full(len(s), STEP)
    most = np.maximum(np.minimum(np.minimum(s, 1 - s), WIDEST), STEP)
    for _ in range(MOST_WIDENINGS):
        size = np.maximum(np.linalg.norm(before, axis=0), np.finfo(float).tiny)
        h = np.clip(1 / size, h, most)
        now = differences(h)
        if not np.all(np.isfinite(now)):
            break
        new, old = (np.diag(np.linalg.inv(precision(derivatives))) for derivatives in (now, before))
        off = np.sqrt(np.maximum(new / old, old / new))
        if before is jacobian and np.all(off < SAME):
            break
        before = now
        if np.all(off < SETTLED):
            break
    return before


def precision(
    jacobian: Float[np.ndarray, "residual parameter"],
) -> Float[np.ndarray, "parameter parameter"]:
    """Return the inverse covariance in normalised coordinates, from data and a uniform prior."""
    return jacobian.T @ jacobian + UNIFORM * np.eye(jacobian.shape[1])


def trust_region(
    part: Part, start: NDArray[np.float64], max_evaluations: int, tolerance: float
) -> OptimizeResult:
    r"""Minimise by scipy's trust region in search coordinates; reject points without a solution.

    $$[J \; r] = Q R: \qquad J^T J, \; J^T r \; \text{and} \; r^T r \; \text{are those of} \; R$$

    The optimiser therefore gets R, with one row more than there are parameters, in place of all
    residuals.

    A point is rejected if its residual or its Jacobian is not finite, as `evaluator` returns them
    for a diverging motion: the trust region shrinks, and `num_refused` counts the point. If the
    start itself is rejected, the search ends there with an infinite `cost`.
    """
    refused: set[bytes] = set()

    @lru_cache(maxsize=1)  # scipy asks for the residual and then for the Jacobian at one point
    def triangle(point: tuple[float, ...]) -> NDArray[np.float64]:
        s = np.array(point)
        rows = np.column_stack([part(s, 1), part(s, 0)])
        if np.all(np.isfinite(rows)):
            return np.linalg.qr(rows, mode="r")
        refused.add(s.tobytes())
        return np.full((min(rows.shape), rows.shape[1]), OUT_OF_REACH)

    def residual(s: NDArray[np.float64]) -> NDArray[np.float64]:
        return triangle(tuple(s.tolist()))[:, -1]

    residual(start)
    if refused:
        return OptimizeResult(x=start, cost=np.inf, num_refused=1)
    end = least_squares(
        residual,
        start,
        lambda s: triangle(tuple(s.tolist()))[:, :-1],  # pyright: ignore[reportArgumentType]
        bounds=(0.0, 1.0),
        x_scale="jac",
        max_nfev=max_evaluations,
        ftol=tolerance,
        xtol=tolerance,
        gtol=1e-15,
    )
    end.num_refused = len(refused)
    return end


def residual_at(
    residual: Residual, x: NDArray[np.float64], box: Box, data: PyTree
) -> NDArray[np.float64]:
    """Compute the residual at normalised coordinates x with the compiled program of the fit."""
    return evaluator(residual, box, data)(to_search(x, box), 0)


def evaluator(residual: Residual, box: Box, data: PyTree) -> Part:
    r"""Return a function (point, flag) that returns the residual (flag 0) or its Jacobian (1).

    $$\frac{\partial r}{\partial s_i} \approx \frac{r(s + h e_i) - r(s - h e_i)}{2h}$$

    All points of the differences are solved in parallel by the function of the residual.
    Derivatives through a solver in time would make a program that takes several times as long to
    compile.
    """
    return part_of(rows_of(residual, box, data))


def part_of(evaluate: Evaluate) -> Part:
    """Return a function (point, flag) that returns the residual (flag 0) or its Jacobian (1)."""

    @lru_cache(maxsize=1)  # scipy asks for the residual and then for the Jacobian at one point
    def at(s: tuple[float, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return _with_differences(evaluate, np.array(s), np.full(len(s), STEP))

    def part(s: NDArray[np.float64], which: int) -> NDArray[np.float64]:
        return at(tuple(s.tolist()))[which]

    return part


def rows_of(residual: Residual, box: Box, data: PyTree) -> Evaluate:
    """Return a function that maps points to residuals, which are NaN if too large or unsolvable."""

    def evaluate(points: Float[np.ndarray, "point parameter"]) -> Float[np.ndarray, "point value"]:
        rows = at_points(_real_of, parameters_at(points, box), (residual, data), lanes=FIT_LANES)
        return np.where(np.abs(rows) < OUT_OF_REACH, rows, np.nan)

    return evaluate


def _with_differences(
    evaluate: Evaluate, s: NDArray[np.float64], steps: Float[np.ndarray, " parameter"]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the residual, and its Jacobian by central differences with given steps."""
    apart = np.diag(steps)
    rows = evaluate(s + np.concatenate([np.zeros((1, len(s))), apart, -apart]))
    ahead, behind = np.split(rows[1:], 2)
    return rows[0], _slope(rows[0], ahead, behind, steps[:, None])


def _slope(
    here: Float[np.ndarray, " residual"],
    ahead: Float[np.ndarray, "parameter residual"],
    behind: Float[np.ndarray, "parameter residual"],
    steps: Float[np.ndarray, "parameter 1"],
) -> Float[np.ndarray, "residual parameter"]:
    """Return the Jacobian by central differences; one-sided where the model fails on one side."""
    sides = [np.all(np.isfinite(side), axis=1, keepdims=True) for side in (ahead, behind)]
    ahead, behind = (
        np.where(ok, side, here) for ok, side in zip(sides, (ahead, behind), strict=True)
    )
    steps = steps * np.maximum(np.sum(sides, axis=0), 1)
    # If the residual of the point itself is not finite, the differences are not either.
    with np.errstate(invalid="ignore", over="ignore"):
        return ((ahead - behind) / steps).T


def _solved(theta: Mapping[str, np.ndarray], residual_and_data: Any, threads: int) -> Solved | None:
    """Return data with costly predictions computed in advance; None without a solver for them."""
    residual, data = residual_and_data
    solver = getattr(residual, "solver", None)
    if solver is None or (solved := solver(theta, data, threads)) is None:
        return None
    return (residual, solved[0]), (None, solved[1])


def _seen(residual_and_data: tuple[Residual, Any]) -> tuple[Residual, Any]:
    """Return the residual function, and only those data that the function uses."""
    residual, data = residual_and_data
    return residual, seen_by(residual, data)


@seeing(_seen)
@solved_first(_solved)
def _real_of(theta: Mapping[str, Array], residual_and_data: Any) -> Float[Array, " residual"]:
    residual, data = residual_and_data
    return real(residual(theta, data))


def parameters_at(s: Float[np.ndarray, "point parameter"], box: Box) -> dict[str, np.ndarray]:
    """Return the parameters by name at points of the search coordinates."""
    return named(search_coordinate(box).forward(s), box)


def search_coordinate(box: Box) -> Composed:
    r"""Return the map from search coordinates (0 to 1) to parameters, logarithmic if possible.

    For positive bounds, $\theta = \theta_{min} (\theta_{max} / \theta_{min})^s$. For others that
    reach much further above zero than below, it is a hyperbolic sine, which is a logarithm of
    either sign from a hundredth of the bound on.
    """
    lower, upper = np.asarray(box.lower), np.asarray(box.upper)
    logs = Logarithms(tuple((lower > 0).tolist()))
    lopsided = (lower <= 0) & (np.abs(lower) < LOPSIDED * upper)
    signed = Sinh(jax.device_put(np.where(lopsided, NEAR_ZERO * upper, 0.0)))
    ends = (logs.inverse(signed.inverse(bound)) for bound in (lower, upper))
    return Composed((unit(*ends), logs, signed))


def to_search(x: Float[np.ndarray, " parameter"], box: Box) -> Float[np.ndarray, " parameter"]:
    """Return the search coordinates of normalised coordinates x."""
    lower, upper = np.asarray(box.lower), np.asarray(box.upper)
    return search_coordinate(box).inverse(lower + np.asarray(x) * (upper - lower))


def from_search(
    s: Float[np.ndarray, " parameter"], box: Box
) -> tuple[Float[np.ndarray, " parameter"], Float[np.ndarray, " parameter"]]:
    r"""Return normalised coordinates x at search coordinates s, with dx / ds.

    $$\frac{d\theta}{ds} = \frac{\mathrm{Im}\,\theta(s + j\epsilon)}{\epsilon}$$

    This derivative has no truncation error, as the step is far below the rounding error.
    """
    theta = search_coordinate(box).forward(s + 1j * TINY)
    lower, upper = np.asarray(box.lower), np.asarray(box.upper)
    x = np.where(s <= 0, 0.0, np.where(s >= 1, 1.0, (theta.real - lower) / (upper - lower)))
    return np.clip(x, 0.0, 1.0), theta.imag / TINY / (upper - lower)
