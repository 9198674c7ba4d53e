"""A coordinate in which a posterior is nearly a round Gaussian, its ridges straightened."""

from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

DEGREE = 5  # of the bends
BOUNDED = 3.0  # standard deviations beyond which a bend levels off
RIDGE = 1e-6  # weight of a coefficient's square beside the variance that it explains


class Straight(NamedTuple):
    r"""Triangular map from the coordinate y to the logit z of the unit box.

    $$z_k = a_k + b_k^T y_{<k} + P_k(\tanh(y_{<k} / 3)) + s_k y_k$$

    P_k has the degrees two to five. Its Jacobian is constant, the product of all s_k, and it is
    analytic: a trapezoidal rule in y keeps its exponential convergence.

    Attributes:
        order: The parameter that each coordinate moves, as its place in the box.
        coefficients: a_k, b_k and those of P_k, by coordinate.
        scales: s_k.
    """

    order: tuple[int, ...]
    coefficients: tuple[NDArray[np.float64], ...]
    scales: tuple[float, ...]

    @property
    def log_slope(self) -> float:
        """Logarithm of |dz / dy|."""
        return float(np.sum(np.log(self.scales)))

    def logit(self, y: Float[np.ndarray, "point parameter"]) -> Float[np.ndarray, "point place"]:
        """Z of points y, in the order of the box."""
        z = np.empty_like(y)
        for k, place in enumerate(self.order):
            known = self.coefficients[k]
            middle = basis(y[:, :k], bends=len(known) > 1 + k) @ known
            z[:, place] = middle + self.scales[k] * y[:, k]
        return z


def round_about(mean: NDArray[np.float64], sd: NDArray[np.float64]) -> Straight:
    """The map without correlation or bend.

    Args:
        mean: Of z.
        sd: Of z.
    """
    d = len(mean)
    coefficients = tuple(np.append(mean[k], np.zeros(k)) for k in range(d))
    return Straight(tuple(range(d)), coefficients, tuple(float(s) for s in sd))


def straightened(
    z: Float[np.ndarray, "point parameter"],
    weights: Float[np.ndarray, " point"],
    order: tuple[int, ...],
    least: NDArray[np.float64],
    *,
    bends: bool,
) -> Straight:
    """The map that makes weighted points round: each coordinate regressed on those before it.

    Args:
        z: Logits.
        weights: Their weights, which sum to one.
        order: The parameter that each coordinate is to move.
        least: Least scale of each parameter that the points can tell.
        bends: Whether the map has the part P_k.
    """
    root = np.sqrt(weights)[:, None]
    y = np.empty_like(z)
    coefficients, scales = [], []
    for k, place in enumerate(order):
        columns = basis(y[:, :k], bends=bends)
        size = columns.shape[1]
        # About the mean, and with a little shrinking: far fewer points count than there are.
        middle = float(weights @ z[:, place])
        spread = float(np.sqrt(weights @ (z[:, place] - middle) ** 2)) or 1.0
        shrunk = np.vstack([root * columns, np.sqrt(RIDGE) * np.eye(size)])
        target = np.append(root[:, 0] * (z[:, place] - middle) / spread, np.zeros(size))
        found = np.linalg.lstsq(shrunk, target)[0] * spread
        found[0] += middle
        left = z[:, place] - columns @ found
        scale = max(float(np.sqrt(weights @ left**2)), float(least[place]))
        y[:, k] = left / scale
        coefficients.append(found)
        scales.append(scale)
    return Straight(order, tuple(coefficients), tuple(scales))


def basis(y: Float[np.ndarray, "point before"], *, bends: bool) -> Float[np.ndarray, "point term"]:
    """One, y, and all products of two to five of the bounded tanh(y / 3).

    Args:
        y: Coordinates before the one that is placed.
        bends: Whether the products are wanted.
    """
    before = y.shape[1]
    if not bends:
        return np.column_stack([np.ones(len(y)), y])
    bounded = np.tanh(y / BOUNDED)
    columns = [np.ones(len(y)), *y.T]
    for degree in range(2, DEGREE + 1):
        for chosen in combinations_with_replacement(range(before), degree):
            columns.append(np.prod(bounded[:, chosen], axis=1))
    return np.stack(columns, axis=1)
