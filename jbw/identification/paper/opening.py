"""Step 4's observable: the misfit of sweeps as a function of gamma alone, a Chebyshev series.

With one parameter left, the misfit of each level is a smooth function of gamma: a few dozen solves
at Chebyshev nodes give it everywhere, and every sampler then runs on the series.
"""

from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.inference.space.box import Box
from jbw.observables.records import Records

NODES = 48


class OpeningCurve(eqx.Module):
    r"""Misfit of each level as a Chebyshev series in gamma.

    $$K\,|\bar v - m(\gamma)|^2 = \sum_k c_k\,T_k(s), \qquad s \in [-1, 1]$$

    Attributes:
        coefficients: c_k of each level.
        within: S of each level.
        num_values: Measured values of each level, over repeats and time.
        noise_std: Noise of one repeat, from the scatter of the repeats.
        lower: Least gamma of the series [1/m].
        upper: Greatest gamma [1/m].
    """

    coefficients: Float[Array, "level node"]
    within: Float[Array, " level"]
    num_values: Float[Array, " level"]
    noise_std: Float[Array, " level"]
    lower: Float[Array, ""]
    upper: Float[Array, ""]


def opening_curve(records: Records, held: Mapping[str, float], prior: Box) -> OpeningCurve:
    """Solve at the Chebyshev nodes of gamma's prior and make the series; usable under vmap.

    Args:
        records: The reduced sweeps.
        held: omega_n, zeta, alpha, delta and gain.
        prior: Box of gamma.

    Returns:
        The series of every level.
    """
    s = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
    gamma = prior.lower[0] + (s + 1) / 2 * (prior.upper[0] - prior.lower[0])
    values = misfits(gamma, as_arrays(held), records)
    # Discrete orthogonality of the polynomials at these nodes; the mean comes with half the weight.
    series = 2 / NODES * np.polynomial.chebyshev.chebvander(s, NODES - 1).T
    series[0] /= 2
    return OpeningCurve(
        coefficients=(series @ values).T,
        within=records.repeats.within,
        num_values=records.repeats.num_values,
        noise_std=records.repeats.noise_std,
        lower=prior.lower[0],
        upper=prior.upper[0],
    )


@jax.jit
def misfits(
    gamma: Float[Array, " node"], held: Mapping[str, Array], records: Records
) -> Float[Array, "node level"]:
    """Misfit of every level by solves, gamma after gamma.

    Args:
        gamma: Values of gamma [1/m].
        held: The other parameters.
        records: The reduced sweeps.
    """

    def one(value: Float[Array, ""]) -> Float[Array, " level"]:
        return records.squares({**held, "gamma": value}) - records.repeats.within

    return jax.lax.map(one, gamma)


def misfit(gamma: Float[Array, ""], curve: OpeningCurve) -> Float[Array, " level"]:
    """Value of the series, by Clenshaw's recurrence."""
    s = 2 * (gamma - curve.lower) / (curve.upper - curve.lower) - 1

    def step(carry: tuple, c: Float[Array, " level"]) -> tuple:
        b_1, b_2 = carry
        return (c + 2 * s * b_1 - b_2, b_1), None

    zero = jnp.zeros(curve.coefficients.shape[0])
    (b_1, b_2), _ = jax.lax.scan(step, (zero, zero), curve.coefficients.T[:0:-1])
    return curve.coefficients[:, 0] + s * b_1 - b_2


def log_likelihood(theta: Mapping[str, Array], curve: OpeningCurve) -> Float[Array, " level"]:
    """Log likelihood of each level, its noise integrated out under Jeffreys' prior.

    Reference:
        Eq. (37), on the velocity as in (41).
    """
    squares = jnp.maximum(misfit(theta["gamma"], curve), 0.0) + curve.within
    return -curve.num_values / 2 * jnp.log(squares)


def residual(theta: Mapping[str, Array], curve: OpeningCurve) -> Float[Array, " level"]:
    """Root of each level's misfit in units of its noise: half its square is the cost.

    Reference:
        Eqs. (41), (42).
    """
    return jnp.sqrt(jnp.maximum(misfit(theta["gamma"], curve), 1e-300)) / curve.noise_std


def as_arrays(held: Mapping[str, float]) -> dict[str, Array]:
    """Held parameters as arrays, which are not compiled in."""
    return {name: jnp.asarray(float(value)) for name, value in held.items()}
