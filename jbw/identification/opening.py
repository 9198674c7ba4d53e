"""Step 4: the opening of the loop from sweeps, for gamma alone or for all parameters at once."""

from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from jbw.observables import response
from jbw.observables.response import Records


class OpeningData(eqx.Module):
    """Sweeps, the parameters that are not updated, and what Step 2 knows of the gain.

    The paper holds all but gamma; with nothing held, all parameters are set to update.

    Attributes:
        records: The reduced sweeps.
        held: Parameters held at their earlier values, by name; any others are being inferred.
        gain_mean: Gain of Step 2 [N/kg per unit of the input].
        gain_std: Its standard deviation; infinite when Step 2 gave none.
    """

    records: Records
    held: dict[str, Float[Array, ""]]
    gain_mean: Float[Array, ""]
    gain_std: Float[Array, ""]


def opening_data(
    records: Records, held: Mapping[str, float], gain: tuple[float, float]
) -> OpeningData:
    """Gather the data of Step 4.

    Args:
        records: The reduced sweeps.
        held: Parameters that are not updated.
        gain: Gain of Step 2 and its standard deviation; infinite when there is none.

    Returns:
        The data, every number a float64 array.
    """
    return OpeningData(
        records=records,
        held={name: jnp.asarray(float(value)) for name, value in held.items()},
        gain_mean=jnp.asarray(float(gain[0])),
        gain_std=jnp.asarray(float(gain[1])),
    )


def log_likelihood(theta: Mapping[str, Array], data: OpeningData) -> Float[Array, " term"]:
    """Terms of the log likelihood: each level of the sweeps, then Step 2's estimate of the gain.

    The noise of each level is integrated out.

    Reference:
        Eq. (37), on the velocity as in (41).
    """
    everything = {**data.held, **theta}
    levels = response.log_likelihood(everything, data.records)
    return jnp.append(levels, -0.5 * _gain_residual(everything, data) ** 2)


def residual(theta: Mapping[str, Array], data: OpeningData) -> Float[Array, " values"]:
    """Residuals of the sweeps and of the gain in standard errors, for the initial fit.

    Reference:
        Eqs. (41), (42).
    """
    everything = {**data.held, **theta}
    sweeps = response.residual(everything, data.records)
    return jnp.append(sweeps, _gain_residual(everything, data))


def _gain_residual(theta: Mapping[str, Array], data: OpeningData) -> Float[Array, ""]:
    return (theta["gain"] - data.gain_mean) / data.gain_std


def draw_noise_std(
    key: Key[Array, ""], terms: Float[np.ndarray, "chain draw term"], data: OpeningData
) -> Float[np.ndarray, "chain draw level"]:
    r"""One exact draw of each level's noise for every draw of the parameters.

    $$\sigma^2 \mid \theta \sim Q(\theta) / \chi^2_{NK}, \qquad
      \log p = -\tfrac{NK}{2} \log Q$$

    so that Q is read off the stored terms of the log likelihood, without another solve.

    Args:
        key: Random key.
        terms: Terms of the log likelihood of every draw; a level each, then the gain's.
        data: The data of Step 4.

    Returns:
        Standard deviation of the noise of one repeat [unit of the response].
    """
    count = np.asarray(data.records.num_repeats) * data.records.mean.shape[-1]
    levels = terms[..., : len(count)]
    chi_square = np.asarray(jax.random.chisquare(key, count, shape=levels.shape))
    return np.sqrt(np.exp(-2 * levels / count) / chi_square)
