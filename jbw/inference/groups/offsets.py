r"""Gaussian likelihoods of repeats, with offsets per run and unknown noise.

K repeats d_k enter only through their mean, their within-repeat sum of squares and K:

$$\sum_k |d_k - m|^2 = K |\bar d - m|^2 + S, \qquad S = \sum_k |d_k - \bar d|^2$$

Natural frequencies of structures shift by a part in a thousand between runs. A group (a test, or
one harmonic of it) depends on the shared parameters and, linearly, on a few offsets b of its run,
and has one unknown noise level; both are integrated out. The offsets of all runs have a common
scatter (`jbw.inference.groups.scatter`): with white noise alone, the posterior of a real structure
would be several times too narrow.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

Complexes = Complex[Array, "..."] | Complex[np.ndarray, "..."]
Reals = Float[Array, "..."] | Float[np.ndarray, "..."] | float
ROUNDING = 1e-14  # A pivot smaller than this fraction of its diagonal entry counts as zero.


def complex_gaussian_log_likelihood(
    mean: Complexes, within_ss: Reals, num_repeats: Reals, model: Complexes, noise_std: Reals
) -> Float[Array, "..."]:
    r"""Return the log likelihood [nats] of K complex repeats, one term per point: eqs. (34), (36).

    $$\log L = -K \log(2\pi\sigma^2) - \frac{K |\bar d - m|^2 + S}{2\sigma^2}$$

    The transpose in (34) is the conjugate one; sigma is the deviation of each real component.
    """
    num_repeats, variance = jnp.asarray(num_repeats), jnp.square(noise_std)
    misfit = num_repeats * _squared_modulus(mean - model) + within_ss
    return -num_repeats * (math.log(2 * math.pi) + jnp.log(variance)) - misfit / (2 * variance)


def complex_gaussian_marginal_log_likelihood(
    mean: Complexes, within_ss: Reals, num_repeats: Reals, model: Complexes
) -> Float[Array, ""]:
    r"""Return the log likelihood of complex repeats, with noise integrated out under 1/sigma.

    $$\log p = -N K \log \sum_{i,k} |d_{ik} - m_i|^2 + \mathrm{const}$$
    """
    total = jnp.sum(num_repeats * _squared_modulus(mean - model)) + jnp.sum(within_ss)
    return -mean.size * jnp.asarray(num_repeats) * jnp.log(total)


def _squared_modulus(value: Complexes) -> Float[Array, "..."]:
    return jnp.square(jnp.real(value)) + jnp.square(jnp.imag(value))


class Estimate(NamedTuple):
    """The estimated run offsets of each data group, with log densities [nats] at the optimum.

    The log densities include half the log determinant of the offsets' precision (inverse
    covariance).
    """

    log_density: Float[Array, " group"]
    offset: Float[Array, "group own"]
    precision: Float[Array, "group own own"]


def estimate(
    square: Float[Array, " group"],
    along: Float[Array, "group own"],
    within: Float[Array, " group"],
    num_repeats: Float[Array, " group"],
    num_values: Float[Array, " group"],
    directions: Float[Array, "group own value"],
) -> Estimate:
    r"""Estimate each data group's run offsets by least squares, with its noise integrated out.

    $$A = K J J^T, \quad \hat b = K A^{-1} J r, \quad
      Q = K|r|^2 + S - \hat b^T A \hat b, \quad
      W = A\,\frac{n - q}{Q}, \quad \log p = -\frac{n - q}{2} \log Q + \frac12 \log |W|$$

    With q = 0 offsets this is the likelihood of (37) with sigma inferred. The residual r is the
    mean of K repeats minus the prediction; only its `square` |r|^2 and J r, `along` the directions,
    are needed. n counts the independent values of all repeats, and J contains the prediction's
    derivatives by each offset, the `directions`.
    """
    total = num_repeats * square + within
    num_own = directions.shape[1]
    if num_own == 0:
        none = jnp.zeros((len(within), 0))
        return Estimate(-num_values / 2 * jnp.log(total), none, none[:, :, None])
    normal = num_repeats[:, None, None] * jnp.einsum("gin,gjn->gij", directions, directions)
    slope = num_repeats[:, None] * along
    offset = solve(normal, slope)
    residual_square = total - jnp.sum(offset * slope, axis=-1)
    degrees = num_values - num_own
    # With as many offsets as values, the fit is exact and the data group has no information.
    says = degrees > 0.5
    residual_square = jnp.where(says, residual_square, 1.0)
    precision = normal * jnp.where(says, degrees / residual_square, 0.0)[:, None, None]
    # The determinant of W has a factor Q^-q; its other factors are constant.
    return Estimate(-num_values / 2 * jnp.log(residual_square), offset, precision)


def known_estimate(
    residual: Float[Array, "group value"], directions: Float[Array, "group own value"]
) -> Estimate:
    r"""Estimate the run offsets of data groups with known noise, from normalised residuals.

    $$W = J J^T, \quad \hat b = W^{-1} J r, \quad \log p = -\tfrac12 (|r|^2 - \hat b^T W \hat b)$$
    """
    precision = jnp.einsum("gin,gjn->gij", directions, directions)
    slope = jnp.einsum("gin,gn->gi", directions, residual)
    offset = solve(precision, slope) if directions.shape[1] else slope
    squares = jnp.sum(residual**2, axis=-1) - jnp.sum(offset * slope, axis=-1)
    return Estimate(-0.5 * squares, offset, precision)


def solve(
    matrix: Float[Array, "group own own"], vector: Float[Array, "group own"]
) -> Float[Array, "group own"]:
    """Solve each data group's normal equations; return zero offsets if they are undetermined."""
    lower, pivots = factorised(matrix)
    determined = jnp.all(jnp.stack(pivots) > 0, axis=0)
    inverse = [1 / jnp.where(determined, pivot, 1.0) for pivot in pivots]
    indices = range(len(pivots))
    forward: list[Array] = []
    for i in indices:  # L f = vector
        forward.append(vector[:, i] - sum(lower[i][k] * forward[k] for k in range(i)))
    solved: list[Array] = [vector[:, 0]] * len(pivots)
    for i in reversed(indices):  # L^T x = D^-1 f
        above = sum(lower[k][i] * solved[k] for k in indices if k > i)
        solved[i] = forward[i] * inverse[i] - above
    return jnp.where(determined, jnp.stack(solved), 0.0).T


def log_determinant(matrix: Float[Array, "group own own"]) -> Float[Array, " group"]:
    """Return the logarithm of the determinant of each of several positive definite matrices."""
    return sum(jnp.log(pivot) for pivot in factorised(matrix)[1])  # pyright: ignore


def factorised(
    matrix: Float[Array, "group own own"],
) -> tuple[list[list[Array]], list[Float[Array, " group"]]]:
    """Return the factors of $A = L D L^T$: L below its diagonal of ones, and the pivots D.

    The loops are written out over rows and columns, which are few: a LAPACK call for each of the
    small matrices would cost more. A pivot is zero if a row is a combination of those before it.
    """
    lower: list[list[Array]] = []
    pivots: list[Array] = []
    for i in range(matrix.shape[-1]):
        row: list[Array] = []
        for j in range(i):
            above = sum(row[k] * lower[j][k] * pivots[k] for k in range(j))
            row.append((matrix[:, i, j] - above) / jnp.where(pivots[j] > 0, pivots[j], 1.0))
        diagonal = matrix[:, i, i]
        remainder = diagonal - sum(
            entry**2 * pivot for entry, pivot in zip(row, pivots, strict=True)
        )
        pivots.append(jnp.where(remainder > ROUNDING * diagonal, remainder, 0.0))
        lower.append(row)
    return lower, pivots


def run_numbers(runs: tuple[str, ...]) -> tuple[int, ...]:
    """Return the index of each data group's run, in order of first appearance."""
    order = list(dict.fromkeys(runs))
    return tuple(order.index(name) for name in runs)


def members(numbers: tuple[int, ...]) -> Float[Array, "part whole"]:
    """Return a matrix with a one where an item (row) belongs to a group (column), else zero."""
    return jnp.asarray(np.eye(max(numbers) + 1)[list(numbers)])


def shrunk(
    residuals: list[Float[Array, "_group _value"]],
    directions: list[Float[Array, "_group own _value"]],
    runs: tuple[int, ...],
    scatter: Float[Array, " own"],
) -> tuple[list[Float[Array, "_group _value"]], Float[Array, "run own"]]:
    r"""Return residuals less the effect of optimal run offsets, and the standardised offsets.

    $$\hat b_r = (W_r + S^{-1})^{-1} \sum_{g \in r} J_g r_g, \qquad r_g - J_g^T \hat b_r,
      \qquad S^{-1/2}\,\hat b_r$$

    Residuals and directions J are given for several blocks of groups, in standard errors; `scatter`
    is the standard deviation of each offset's prior.
    """
    member = members(runs)
    slopes = [
        scatter[:, None] * direction for direction in directions
    ]  # derivatives with respect to offsets in units of their standard deviation
    precision = jnp.concatenate([jnp.einsum("gin,gjn->gij", slope, slope) for slope in slopes])
    pull = jnp.concatenate(
        [jnp.einsum("gin,gn->gi", slope, r) for slope, r in zip(slopes, residuals, strict=True)]
    )
    normal = jnp.einsum("gr,gij->rij", member, precision) + jnp.eye(len(scatter))
    offset = solve(normal, jnp.einsum("gr,gi->ri", member, pull))
    ends = np.cumsum([len(r) for r in residuals])[:-1]
    group_offsets = jnp.split(member @ offset, ends)
    corrected = [
        r - jnp.einsum("gin,gi->gn", slope, b)
        for r, slope, b in zip(residuals, slopes, group_offsets, strict=True)
    ]
    return corrected, offset
