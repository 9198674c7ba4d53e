r"""Coordinates along the direction that the data do not determine, between prior bounds.

If only a combination is determined, such as a product from one kernel, the posterior is a thin
ridge that ends at the walls of the box. Along the weakest direction v of a fit, and across it,

$$s = s_0 + B\,w + \bigl[\tau_- + r\,(\tau_+ - \tau_-)\bigr]\,v, \qquad 0 < r < 1$$

where s are the members, the parameters that contribute to it, by their logarithms if positive, in
units of the box, and tau_-, tau_+ is where the line through s_0 + B w meets the walls. In (w, r)
the ridge is straight, and the wall is a bound of r alone. With orthonormal columns B and v,

$$\left|\det \frac{\partial s}{\partial (w, r)}\right| = \tau_+ - \tau_-$$
"""

from collections.abc import Mapping
from itertools import product

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jbw.inference.space.box import Box
from jbw.inference.space.coordinates import Composed, Coordinate, Vector
from jbw.inference.space.reparametrisation import (
    WIDER,
    Covariance,
    Reparametrisation,
    in_logarithms,
    never_zero,
)

# A parameter belongs to the posterior's ridge if its component exceeds this fraction of the largest
# one.
PART = 0.3
# A bound counts as parallel to the posterior's ridge if the component of the ridge's direction
# across the bound is below this value.
NARROW = 1e-9
# range of the coordinate r along the ridge in which chains start, even if the optimum lies at a
# bound
MIDDLE = (0.05, 0.95)

Member = Float[Array, " member"]


class Ridge(Coordinate):
    """Coordinates near a ridge of the posterior: w across it, r along it, and other parameters.

    Its `members` have bounds `lower` and `width`; s_0 is the `origin`, B is `across`, v is `along`.
    """

    members: tuple[int, ...] = eqx.field(static=True)
    others: tuple[int, ...] = eqx.field(static=True)
    lower: Member
    width: Member
    origin: Member
    across: Float[Array, "member across"]
    along: Member

    def forward(self, x: Vector) -> Vector:
        """Return the parameters at given coordinates along and across the posterior's ridge."""
        foot = self._foot(x)
        low, high = walls(foot, self.along)
        s = foot + (low + x[-1] * (high - low)) * self.along
        return self._joined(x[: len(self.others)], self.lower + s * self.width)

    def inverse(self, y: Vector) -> Vector:
        """Return coordinates along and across the posterior's ridge for given parameters."""
        s = (y[np.array(self.members)] - self.lower) / self.width
        w, tau = self.across.T @ (s - self.origin), self.along @ (s - self.origin)
        low, high = walls(self.origin + self.across @ w, self.along)
        r = (tau - low) / (high - low)
        others = y[np.array(self.others, dtype=int)]
        return jnp.concatenate([others, w, r[None]])

    def log_abs_det_jacobian(self, x: Vector) -> Float[Array, ""]:
        """Return the log determinant: the log of the ridge's length between the prior bounds."""
        low, high = walls(self._foot(x), self.along)
        length = jnp.where(high > low, high - low, 1.0)
        log_length = jnp.log(length) + jnp.sum(jnp.log(self.width))
        return jnp.where(high > low, log_length, -jnp.inf)

    def _foot(self, x: Vector) -> Member:
        """Return the point s_0 + B w where a line along the ridge meets the plane across it."""
        return self.origin + self.across @ x[len(self.others) : -1]

    def _joined(self, others: Float[Array, " other"], members: Member) -> Vector:
        order = np.argsort([*self.others, *self.members])
        return jnp.concatenate([others, members])[order]


def walls(foot: Member, along: Member) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return where a line enters and leaves the unit cube; equal values if it misses the cube."""
    parallel = jnp.abs(along) < NARROW
    slope = jnp.where(parallel, 1.0, along)
    ends = jnp.stack([(0 - foot) / slope, (1 - foot) / slope])
    low = jnp.max(jnp.where(parallel, -jnp.inf, ends.min(axis=0)))
    high = jnp.min(jnp.where(parallel, jnp.inf, ends.max(axis=0)))
    inside = jnp.all(~parallel | ((foot > 0) & (foot < 1)))
    return low, jnp.where(inside, high, low)


def along_ridge(theta: Mapping[str, float], covariance: Covariance, box: Box) -> Reparametrisation:
    """Return sampling coordinates near a fit, one of them along the least determined direction."""
    logarithms = never_zero(theta, covariance, box)
    in_logs = in_logarithms(theta, covariance, box, logarithms)
    # If a prior's lower bound is zero, its logarithm is bounded at a negligible value.
    floored = np.isin(box.names, logarithms) & (np.asarray(box.lower) <= 0)
    ridge = _ridge_of(in_logs, floored)
    # Project the corners of the prior range, because lines outside of the projection do not meet
    # the range.
    corners = np.array(list(product((0.0, 1.0), repeat=len(ridge.members))))
    ends = (corners - np.asarray(ridge.origin)) @ np.asarray(ridge.across)
    others = np.array(ridge.others, dtype=int)
    # Bound the logarithms of the other parameters as in `along_logarithms`.
    reach = floored[others] * WIDER * (in_logs.upper - in_logs.lower)[others]
    return Reparametrisation(
        Composed((ridge, in_logs.outer)),
        jnp.concatenate(
            [in_logs.lower[others] - reach, jnp.asarray(ends.min(axis=0)), jnp.zeros(1)]
        ),
        jnp.concatenate(
            [in_logs.upper[others] + reach, jnp.asarray(ends.max(axis=0)), jnp.ones(1)]
        ),
        *_laplace_along(in_logs, ridge),
    )


def _ridge_of(in_logs: Reparametrisation, floored: NDArray[np.bool_]) -> Ridge:
    """Return the coordinates of a ridge in the least determined direction, scaled by prior ranges.

    Its members contribute to that direction. Logarithms with a lower limit in place of a bound of
    zero are not divided by their width here, because this large width would make them look small.
    """
    lower, width = np.asarray(in_logs.lower), np.asarray(in_logs.upper - in_logs.lower)
    covariance = np.asarray(in_logs.covariance)
    unit, floored_unit = (
        covariance / np.outer(by, by) for by in (width, np.where(floored, 1.0, width))
    )
    weakest = np.abs(np.linalg.eigh(floored_unit)[1][:, -1])
    is_member = weakest > PART * weakest.max()
    members, others = np.flatnonzero(is_member), np.flatnonzero(~is_member)
    directions = np.linalg.eigh(unit[np.ix_(members, members)])[1]
    origin = (np.asarray(in_logs.start)[members] - lower[members]) / width[members]
    return Ridge(
        tuple(members.tolist()),
        tuple(others.tolist()),
        jnp.asarray(lower[members]),
        jnp.asarray(width[members]),
        jnp.asarray(origin),
        jnp.asarray(directions[:, :-1]),
        jnp.asarray(directions[:, -1]),
    )


def _laplace_along(
    in_logs: Reparametrisation, ridge: Ridge
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return optimum and covariance in ridge coordinates, linearised at the optimum.

    Chains start away from the walls, with at most the width of a uniform r.
    """
    low, high = (float(wall) for wall in walls(ridge.origin, ridge.along))
    length = max(high - low, NARROW)  # `high - low` is zero if the optimum is in a corner
    others, members = np.array(ridge.others, dtype=int), np.array(ridge.members)
    across, size = np.zeros(len(members) - 1), len(in_logs.lower)
    start = [*np.asarray(in_logs.start)[others], *across, np.clip(-low / length, *MIDDLE)]
    turn = np.zeros((size, size))
    turn[range(len(others)), others] = 1.0
    directions = np.column_stack([ridge.across, ridge.along]).T / np.asarray(ridge.width)
    turn[np.ix_(range(len(others), size), members)] = directions
    turn[-1] /= length
    covariance = turn @ np.asarray(in_logs.covariance) @ turn.T
    # The variance of r is at most that of a uniform r; the regression of the other parameters on r
    # stays as it is.
    with_r, excess = covariance[:, -1], max(covariance[-1, -1] - 1 / 12, 0.0)
    limited = covariance - excess * np.outer(with_r, with_r) / covariance[-1, -1] ** 2
    return np.array(start), limited
