"""Repeats of groups of data: what a likelihood needs beside their means and the prediction."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.inference.offsets import Estimate, estimate

OFFSETS = ("omega_n", "zeta")  # of a run, where it has its own


class Repeats(eqx.Module):
    """Groups of repeated data, each with a noise of its own.

    A group is a test, or one harmonic of it; its values are real numbers (samples, or real and
    imaginary parts).

    Attributes:
        within: Scatter of the repeats about their mean, summed over repeats and values.
        num_repeats: Repeats K.
        size: Values N of a group.
        num_values: Independent values n of all repeats together; fewer than there are where the
            residual is coloured.
        noise_std: Noise of one repeat, for least squares.
        directions: Change of the prediction by each offset of the run; no offsets, no rows.
        labels: Name of each group; static.
        runs: Name of the run that each group was measured in; static.
    """

    within: Float[Array, " group"]
    num_repeats: Float[Array, " group"]
    size: Float[Array, " group"]
    num_values: Float[Array, " group"]
    noise_std: Float[Array, " group"]
    directions: Float[Array, "group own value"]
    labels: tuple[str, ...] = eqx.field(static=True)
    runs: tuple[str, ...] = eqx.field(static=True)


def repeats(
    within: Float[np.ndarray, " group"],
    num_repeats: Float[np.ndarray, " group"],
    sizes: Float[np.ndarray, " group"],
    longest: int,
    labels: tuple[str, ...],
    runs: tuple[str, ...],
    scale: Float[np.ndarray, " group"],
) -> Repeats:
    r"""Bookkeeping of groups whose values are independent and which share their offsets.

    $$\sigma^2 = \frac{S}{N (K - 1)}$$

    Args:
        within: Scatter S of the repeats about their mean.
        num_repeats: K.
        sizes: Values N of each group.
        longest: Values of the widest group, to which the others are filled up.
        labels: Names of the groups.
        runs: Names of their runs.
        scale: Root mean square of each group, of which a single repeat's noise is guessed as one
            hundredth until a fit tells it.

    Returns:
        The repeats.
    """
    degrees = sizes * (num_repeats - 1)
    known = degrees > 0
    noise = np.sqrt(np.where(known, within / np.where(known, degrees, 1), (0.01 * scale) ** 2))
    return Repeats(
        within=jnp.asarray(within),
        num_repeats=jnp.asarray(num_repeats, float),
        size=jnp.asarray(sizes, float),
        num_values=jnp.asarray(sizes * num_repeats, float),
        noise_std=jnp.asarray(noise),
        directions=jnp.zeros((len(labels), 0, longest)),
        labels=labels,
        runs=runs,
    )


def estimate_of(residual: Float[Array, "group value"], data: Repeats) -> Estimate:
    """What each group says of its offsets, its noise integrated out.

    Args:
        residual: Means less predictions.
        data: The repeats.
    """
    return estimate(residual, data.within, data.num_repeats, data.num_values, data.directions)


def weighted(
    residual: Float[Array, "group value"], data: Repeats
) -> tuple[Float[Array, "group value"], Float[Array, "group own value"]]:
    """Residuals and directions in standard errors of a mean, as few as are independent.

    Args:
        residual: Means less predictions.
        data: The repeats.
    """
    # n / N is K where all values are independent.
    weight = jnp.sqrt(data.num_values / data.size) / data.noise_std
    return weight[:, None] * residual, weight[:, None, None] * data.directions
