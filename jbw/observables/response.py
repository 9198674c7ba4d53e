"""Response records under a measured input (sweeps, noise): reduction, prediction, likelihood."""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.errors import DataError
from jbw.inference.likelihood import gaussian_marginal_log_likelihood
from jbw.measurement.records import Test
from jbw.oscillator.parameters import BoucWen
from jbw.oscillator.response import simulate

JOINT = ("omega_n", "zeta", "alpha", "delta", "gamma")
_LETTER = {"displacement": "y", "velocity": "v", "acceleration": "a"}


class Records(eqx.Module):
    """Repeats of several levels, each reduced to its sufficient statistics.

    Attributes:
        source: Mean measured input of each level [V, N or N/kg].
        mean: Mean measured response of each level [m, m/s or m/s^2].
        within: Scatter of the repeats about their mean, summed over repeats and time.
        num_repeats: Repeats of each level.
        fs: Sampling frequency [Hz]; static.
        response: displacement, velocity or acceleration; static.
        substeps: Steps of the solver between samples; static.
    """

    source: Float[Array, "level time"]
    mean: Float[Array, "level time"]
    within: Float[Array, " level"]
    num_repeats: Float[Array, " level"]
    fs: float = eqx.field(static=True)
    response: str = eqx.field(static=True, default="velocity")
    substeps: int = eqx.field(static=True, default=2)


def reduce(tests: Sequence[Test], *, substeps: int = 2) -> Records:
    """Sufficient statistics of the repeats of each test.

    Args:
        tests: One test a level, all of one length, sampling frequency and response.
        substeps: Steps of the solver between samples.

    Returns:
        The reduced records.

    Raises:
        DataError: If lengths, sampling frequencies or responses differ, or a test has one repeat.
    """
    kinds = {(t.records[0].fs, t.records[0].response, t.records[0].num_samples) for t in tests}
    if len(kinds) != 1:
        raise DataError(
            f"Tests fitted together must share sampling frequency, response and length, but found "
            f"{sorted(kinds)}.",
            remedy="Fit them in separate campaigns, or cut the records to one length.",
        )
    for test in tests:
        if len(test.records) < 2:
            raise DataError(
                f"Test `{test.name}` needs at least 2 repeats to estimate its noise, "
                f"but has {len(test.records)}.",
                remedy="Measure repeats, or leave the test out of `fit_levels`.",
            )
    fs, response, _ = kinds.pop()
    sources = [np.stack([r.channels[r.source] for r in t.records]) for t in tests]
    responses = [
        np.stack([advance(r.channels[response], t.delay, fs) for r in t.records]) for t in tests
    ]
    means = [r.mean(axis=0) for r in responses]
    return Records(
        source=jnp.asarray(np.stack([s.mean(axis=0) for s in sources])),
        mean=jnp.asarray(np.stack(means)),
        within=jnp.asarray([np.sum((r - m) ** 2) for r, m in zip(responses, means, strict=True)]),
        num_repeats=jnp.asarray([float(len(r)) for r in responses]),
        fs=fs,
        response=response,
        substeps=substeps,
    )


def advance(samples: np.ndarray, delay: float, fs: float) -> np.ndarray:
    r"""Undo a channel's delay by the phase of its spectrum.

    $$x(t + \tau) \leftrightarrow X(\omega)\,e^{+j\omega\tau}$$

    Args:
        samples: Samples of one channel, at rest at both ends.
        delay: Lag tau behind the input channel [s].
        fs: Sampling frequency [Hz].

    Returns:
        The samples, `delay` seconds earlier.
    """
    if delay == 0.0:
        return samples
    omega = 2 * np.pi * np.fft.rfftfreq(len(samples), 1 / fs)
    return np.fft.irfft(np.fft.rfft(samples) * np.exp(1j * omega * delay), len(samples))


def joint_of(theta: Mapping[str, Array]) -> BoucWen:
    """The joint among the parameters of a likelihood."""
    omega_n, zeta, alpha, delta, gamma = (theta[name] for name in JOINT)
    return BoucWen(omega_n, zeta, alpha, delta, gamma)


def response_to(
    theta: Mapping[str, Array],
    source: Float[Array, " time"],
    fs: float,
    *,
    response: str = "velocity",
    substeps: int = 2,
) -> Float[Array, " time"]:
    """Response of the joint to a measured input, from rest.

    The input between its samples is the band-limited one that the sampling saw.

    Args:
        theta: The joint's five parameters and `gain` [N/kg per unit of the input].
        source: Measured input [unit of the input].
        fs: Sampling frequency [Hz].
        response: displacement, velocity or acceleration.
        substeps: Steps of the solver between samples.

    Returns:
        Displacement [m], velocity [m/s] or acceleration [m/s^2].

    Reference:
        Eqs. (1), (2).
    """
    result = simulate(
        joint_of(theta), theta["gain"] * source, fs, hold="band_limited", substeps=substeps
    )
    return getattr(result, _LETTER[response])


def predict(theta: Mapping[str, Array], data: Records) -> Float[Array, "level time"]:
    """Response of every level to its mean measured input, from rest.

    Args:
        theta: The joint's five parameters and `gain`.
        data: The reduced records.

    Returns:
        Predicted response, in the unit of the measured one.
    """
    # One level after another, not as lanes: alone, the solver skips the work of rare events.
    return jax.lax.map(
        lambda source: response_to(
            theta, source, data.fs, response=data.response, substeps=data.substeps
        ),
        data.source,
    )


def squares(theta: Mapping[str, Array], data: Records) -> Float[Array, " level"]:
    r"""Sum of squared residuals of all repeats, level by level.

    $$Q = \sum_k |d_k - m|^2 = K\,|\bar d - m|^2 + S$$
    """
    misfit = jnp.sum((data.mean - predict(theta, data)) ** 2, axis=-1)
    return data.num_repeats * misfit + data.within


def log_likelihood(theta: Mapping[str, Array], data: Records) -> Float[Array, " level"]:
    """Log likelihood of each level with its own noise level integrated out.

    Reference:
        Eq. (37), with velocity in place of displacement and the noise inferred.
    """
    return jax.vmap(gaussian_marginal_log_likelihood)(
        data.mean, data.within, data.num_repeats, predict(theta, data)
    )


def residual(theta: Mapping[str, Array], data: Records) -> Float[Array, " values"]:
    """Residuals of the means in units of their standard error, for least squares.

    Reference:
        Eq. (41), weighted by the noise of each level instead of the response's power.
    """
    weight = jnp.sqrt(data.num_repeats) / noise_std(data)
    return (weight[:, None] * (data.mean - predict(theta, data))).ravel()


def noise_std(data: Records) -> Float[Array, " level"]:
    r"""Noise of one repeat of each level, from the scatter of the repeats.

    $$\sigma^2 = \frac{S}{N (K - 1)}$$
    """
    return jnp.sqrt(data.within / (data.mean.shape[-1] * (data.num_repeats - 1)))
