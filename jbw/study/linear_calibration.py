"""Calibration of Step 2: line fits of noisy FRF lines, whose posterior is their normal law."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key
from numpy.typing import NDArray

from jbw.errors import DataError
from jbw.identification.linear import line_fit
from jbw.identification.windowed import receptance
from jbw.inference.calibration.record import Calibration, judged
from jbw.inference.calibration.replications import LOG_LIKELIHOOD, ranked
from jbw.inference.space.box import Box, from_unit
from jbw.measurement.spectra import FRF

NAMES = ("omega_n", "zeta", "gain")
DRAWS = (4, 250)


def calibrate_linear(
    key: Key[Array, ""],
    design: FRF,
    prior: Box,
    *,
    num_replications: int = 1000,
    num_ranks: int = 100,
    report: Callable[[int], None] = lambda done: None,
) -> Calibration:
    r"""Rank omega_n, zeta and gain among draws of what line fits say of them.

    $$\theta \mid D \sim N(\hat\theta, C)$$

    with the fit's own covariance C. A fit that finds no resonance is a failure.

    Args:
        key: Random key.
        design: Frequencies and variance of the lines.
        prior: Of omega_n, zeta and gain.
        num_replications: Fits.
        num_ranks: Draws that each truth is ranked among.
        report: Called with the number of fits done, a hundred at a time.

    Reference:
        Eqs. (23), (38), (39).
    """
    truth, of_draws, arrived = [], [], []
    for i, one in enumerate(jax.random.split(key, num_replications)):
        values, draws, found = _replication(one, design, prior)
        truth.append(values)
        of_draws.append(draws)
        arrived.append(found)
        if (i + 1) % 100 == 0 or i + 1 == num_replications:
            report(i + 1)
    keys = jax.random.split(jax.random.fold_in(key, num_replications), num_replications)
    rank = jax.jit(jax.vmap(partial(ranked, num_ranks=num_ranks)))
    found = rank(keys, jnp.array(truth), jnp.array(of_draws), jnp.array(arrived))
    return judged((*NAMES, LOG_LIKELIHOOD), found, num_ranks)


def _replication(
    key: Key[Array, ""], design: FRF, prior: Box
) -> tuple[NDArray[np.float64], NDArray[np.float64], bool]:
    """Quantities at the truth, at the draws, and whether there was a fit."""
    rng = np.random.default_rng(np.asarray(jax.random.key_data(key)))
    point = from_unit(jnp.asarray(rng.uniform(size=3)), prior)
    theta = np.array([float(point[name]) for name in NAMES])
    measured = replace(design, h=_lines(rng, theta, design))
    try:
        fit = line_fit(measured, (measured.freq[0], measured.freq[-1]))
    except DataError:
        return np.append(theta, 0.0), np.full((*DRAWS, 4), np.nan), False
    draws = rng.multivariate_normal(fit.theta, fit.covariance, DRAWS)
    values = np.append(theta, _log_likelihood(theta, measured))
    likelihood = _log_likelihood(draws, measured)
    return values, np.concatenate([draws, likelihood[..., None]], axis=-1), True


def _lines(
    rng: np.random.Generator, theta: Float[np.ndarray, "3"], design: FRF
) -> NDArray[np.complex128]:
    """Lines of the oscillator with noise, half of the variance in each component."""
    omega_n, zeta, gain = theta
    stiffness = omega_n**2 - design.omega**2 + 2j * zeta * omega_n * design.omega
    noise = rng.normal(size=(2, design.freq.size)) * np.sqrt(design.variance / 2)
    return gain / stiffness + noise[0] + 1j * noise[1]


def _log_likelihood(theta: Float[np.ndarray, "... 3"], measured: FRF) -> NDArray[np.float64]:
    """Of all lines, up to a constant [nats]."""
    omega_n, zeta, gain = np.moveaxis(theta[..., None], -2, 0)
    misfit = measured.h - receptance(measured.omega, omega_n, zeta, gain)
    return -np.sum(np.abs(misfit) ** 2 / measured.variance, axis=-1)
