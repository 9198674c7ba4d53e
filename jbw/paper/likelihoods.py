r"""The posterior, the noise and the likelihoods of Steps 3 and 4, Eqs. (32)-(37).

The K repeats d_k enter by their mean, the sum of squared deviations from it, and K:

$$\sum_k |d_k - m|^2 = K\,|\bar d - m|^2 + S, \qquad S = \sum_k |d_k - \bar d|^2$$
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix
from jaxtyping import Array, ArrayLike, Float, Inexact, Key

from jbw.errors import ConfigError, ModelError
from jbw.inference.groups.offsets import (
    complex_gaussian_log_likelihood,
    complex_gaussian_marginal_log_likelihood,
)
from jbw.inference.space.box import Box, box, from_unit
from jbw.oscillator.checks import is_concrete
from jbw.oscillator.parameters import Scalar

Theta = dict[str, Array]
Prior = Mapping[str, tuple[float, float]]


class Repeats(eqx.Module):
    """The sufficient statistics of repeated measurements, one value per point.

    Attributes:
        mean: Mean over the repeats.
        within: Sum of squared moduli about the mean.
        num_repeats: Number of repeats K [-].
    """

    mean: Inexact[Array, "..."]
    within: Float[Array, "..."]
    num_repeats: Scalar


def repeats(measured: Inexact[ArrayLike, "repeat ..."]) -> Repeats:
    """Return the sufficient statistics of repeated measurements along the first axis.

    Args:
        measured: Kernel of every repeat (complex), or response of every repeat (real).

    Returns:
        Mean, sum of squared deviations from it, and number of repeats.

    Reference:
        Eq. (36), as printed: all that its sum over the repeats needs.
    """
    measured = jnp.asarray(measured)
    mean = jnp.mean(measured, axis=0)
    within = jnp.sum(jnp.abs(measured - mean) ** 2, axis=0)
    return Repeats(mean, within, jnp.asarray(float(measured.shape[0])))


def log_posterior(
    theta: Mapping[str, Scalar], prior: Prior, log_likelihood: Float[ArrayLike, "..."]
) -> Float[Array, ""]:
    r"""Return the unnormalised log posterior density of parameters.

    $$\log p(\theta | D) = \sum \log L(\theta) + \log\pi(\theta) + \mathrm{const}$$

    Args:
        theta: Parameters by name.
        prior: Bounds of each parameter's uniform prior.
        log_likelihood: Terms of the log likelihood at theta [nats].

    Returns:
        Log density [nats]; -inf outside the prior.

    Raises:
        ConfigError: A prior is not a pair of finite numbers, the lower one first.

    Reference:
        Eq. (32), as printed.
    """
    bounds = box(prior)
    values = jnp.stack([jnp.asarray(theta[name]) for name in bounds.names])
    inside = jnp.all((values >= bounds.lower) & (values <= bounds.upper))
    volume = jnp.sum(jnp.log(bounds.upper - bounds.lower))
    return jnp.where(inside, jnp.sum(jnp.asarray(log_likelihood)) - volume, -jnp.inf)


def with_noise(
    key: Key[Array, ""], model: Inexact[ArrayLike, "..."], noise_std: Float[ArrayLike, "..."]
) -> Inexact[Array, "..."]:
    r"""Add Gaussian noise to a model, $d = m(\theta) + \varepsilon$.

    Args:
        key: Random key.
        model: Prediction, real or complex.
        noise_std: Standard deviation of each real component, in the unit of the model.

    Returns:
        One measurement.

    Reference:
        Eq. (33), as printed.
    """
    model = jnp.asarray(model)
    if not jnp.iscomplexobj(model):
        return model + jnp.asarray(noise_std) * jax.random.normal(key, model.shape)
    real, imag = jax.random.normal(key, (2, *model.shape))
    return model + jnp.asarray(noise_std) * (real + 1j * imag)


def gaussian_log_likelihood(
    squares: Float[ArrayLike, "..."],
    num_values: Float[ArrayLike, "..."],
    noise_std: Float[ArrayLike, "..."] | None = None,
) -> Float[Array, "..."]:
    r"""Return the log likelihood of Gaussian noise, from the sum of squared residuals.

    $$\log L = -\frac n2 \log(2\pi\sigma^2) - \frac{Q}{2\sigma^2}, \qquad
      Q = \sum |d - m|^2$$

    Without sigma the likelihood is marginal over sigma with the prior 1/sigma: $-\tfrac n2 \log Q$,
    up to a constant.

    Args:
        squares: Sum Q of squared residuals, conjugated where they are complex.
        num_values: Number n of real values in it: two for each complex one.
        noise_std: Standard deviation sigma of each real component; None when it is unknown.

    Returns:
        Log likelihood [nats].

    Reference:
        Eq. (34), corrected: its transpose is the conjugate one, and its N the number of data.
    """
    squares, num_values = jnp.asarray(squares), jnp.asarray(num_values)
    if noise_std is None:
        return -num_values / 2 * jnp.log(squares)
    variance = jnp.square(jnp.asarray(noise_std))
    return -num_values / 2 * jnp.log(2 * math.pi * variance) - squares / (2 * variance)


def kernel_log_likelihood(
    measured: Repeats,
    model: Inexact[ArrayLike, "..."],
    noise_std: Float[ArrayLike, "..."] | None = None,
) -> Float[Array, "..."]:
    r"""Return the log likelihood of a measured kernel, one term per frequency.

    $$\log L = -K \log(2\pi\sigma^2) - \frac{K\,|\bar H_3 - H_3(\theta)|^2 + S}{2\sigma^2}$$

    Without sigma the likelihood is marginal over sigma at each frequency with the prior 1/sigma:
    $-K \log(K\,|\bar H_3 - H_3(\theta)|^2 + S)$.

    Args:
        measured: Repeats of the kernel at the probing frequencies [m^-2 s^6].
        model: Kernel at the same frequencies [m^-2 s^6].
        noise_std: Standard deviation of one repeat, of each real component; None if unknown.

    Returns:
        Log likelihood of each frequency [nats].

    Reference:
        Eq. (36), corrected: sigma is that of each real component, and taken from a few repeats it
        is too sure of itself; leave it out to have it integrated out.
    """
    model, mean = jnp.asarray(model), jnp.asarray(measured.mean)
    if noise_std is not None:
        return complex_gaussian_log_likelihood(
            mean, measured.within, measured.num_repeats, model, jnp.asarray(noise_std)
        )
    num_repeats = jnp.broadcast_to(jnp.asarray(measured.num_repeats), mean.shape)
    terms = jnp.vectorize(complex_gaussian_marginal_log_likelihood)
    return terms(mean, measured.within, num_repeats, model)


def response_log_likelihood(
    measured: Repeats,
    model: Float[ArrayLike, "... time"],
    noise_std: Float[ArrayLike, "..."] | None = None,
) -> Float[Array, "..."]:
    r"""Return the log likelihood of a measured velocity in time, one term per level.

    $$\log L = -\frac{KN}{2} \log(2\pi\sigma^2)
      - \frac{K\sum_n (\bar v_n - v_n(\theta))^2 + S}{2\sigma^2}$$

    Args:
        measured: Repeats of the velocity, with time on the last axis [m/s].
        model: Velocity at the same instants [m/s].
        noise_std: Standard deviation of one repeat [m/s]; if None, the likelihood is marginal over
            it with the prior 1/sigma.

    Returns:
        Log likelihood [nats].

    Reference:
        Eq. (37), corrected: of the velocity, as in (41); the print has the displacement.
    """
    residual = jnp.asarray(measured.mean) - jnp.asarray(model)
    num_repeats = jnp.asarray(measured.num_repeats)
    squares = num_repeats * jnp.sum(residual**2, axis=-1) + jnp.sum(measured.within, axis=-1)
    return gaussian_log_likelihood(squares, num_repeats * residual.shape[-1], noise_std)


def map_estimate(
    log_density: Callable[[Theta], Float[Array, "..."]],
    prior: Prior,
    start: Mapping[str, float],
    *,
    max_steps: int = 256,
) -> Theta:
    r"""Return the parameters of greatest posterior density, $\arg\max_\theta p(\theta | D)$.

    It is the least-squares estimate only under a uniform prior, with one known noise and away from
    the bounds. BFGS begins at `start`, in the logit of the box, and finds a nearby maximum.

    Args:
        log_density: Log density of theta, terms to be summed [nats].
        prior: Bounds of each parameter.
        start: Starting values of the parameters, inside the prior.
        max_steps: Largest number of steps.

    Returns:
        Parameters by name.

    Raises:
        ConfigError: A prior is not a pair of finite numbers, or `start` lies outside of it.
        ModelError: The search did not converge.

    Reference:
        Eq. (35), as printed.
    """
    bounds = box(prior)
    x = unit_of(start, bounds)

    def cost(z: Array, _: Any) -> Array:
        return -jnp.sum(log_density(from_unit(jax.nn.sigmoid(z), bounds)))

    minimum = optimistix.minimise(
        cost, optimistix.BFGS(rtol=1e-10, atol=1e-10), jnp.log(x) - jnp.log1p(-x),
        max_steps=max_steps, throw=False,
    )  # fmt: skip
    if is_concrete(minimum.value) and minimum.result != optimistix.RESULTS.successful:
        raise ModelError(
            f"The search for the greatest density did not converge in {max_steps} steps.",
            remedy="Give a `start` nearer to the maximum, or raise `max_steps`.",
        )
    return from_unit(jax.nn.sigmoid(minimum.value), bounds)


def unit_of(theta: Mapping[str, float], bounds: Box) -> Float[Array, " parameter"]:
    """Return parameters' positions between their bounds, strictly between 0 and 1."""
    missing = [name for name in bounds.names if name not in theta]
    if missing:
        raise ConfigError(f"`start` must name every parameter, but lacks {', '.join(missing)}.")
    values = jnp.stack([jnp.asarray(theta[name], float) for name in bounds.names])
    x = (values - bounds.lower) / (bounds.upper - bounds.lower)
    if is_concrete(x):
        for name, place in zip(bounds.names, x.tolist(), strict=True):
            if not 0.0 < place < 1.0:
                raise ConfigError(
                    f"`start` must lie inside the prior, but {name} = {theta[name]:g} does not."
                )
    return x
