r"""Residual terms: the contribution of modes outside the band, or of a neighbour, to the response.

$$y(\omega) = y_{joint}(\omega) + \left(U + \frac{L}{\omega^2} +
  \sum_k \frac{s_k}{\omega_k^2 - \omega^2 + 2j\zeta_k\omega_k\omega}\right) g\,u(\omega)$$

with U for the modes above and L for those below, rigid-body modes included; both are real. In a
narrow band the two are one number. A neighbour within the band is linear and does not move the
joint. The terms belong to the point where the response is measured, so that all tests share them.
They are parameters like omega_n: terms that are absent from theta add nothing.

A test may have its own U and L, for example because a sensor was moved. Both act along columns that
contain no parameter: a flat prior integrates them out, and misfit along these columns does not
count.

Reference:
    Ewins (2000), Modal Testing, section 4.4.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Inexact

from jbw.oscillator.hold import line_frequencies
from jbw.quantities import CONSTANT_TERMS, NEIGHBOURS, derivative_order

UPPER, LOWER = (quantity.name for quantity in CONSTANT_TERMS)
MODES = tuple(tuple(quantity.name for quantity in mode) for mode in NEIGHBOURS)
OF_MODES = tuple(name for mode in MODES for name in mode)
# Residual terms that a test may include, by the setting in the campaign.
TAKEN: Mapping[str, tuple[str, ...]] = {
    "none": (), "own": OF_MODES, "upper": (UPPER, *OF_MODES),
    "both": (UPPER, LOWER, *OF_MODES), "auto": (UPPER, LOWER, *OF_MODES),
}  # fmt: skip
# smallest driven spectral line, relative to the largest; for smaller ones, 1 / omega^2 would
# amplify noise
DRIVEN = 0.05
# bound of any residual term, relative to the mode's static response (at its peak 1 / (2 zeta))
LARGEST = 30.0
# Relative range of a neighbouring mode's frequency. In a larger range, the neighbour would
# compensate errors of the law.
NEAR = 0.07
DAMPED = (1e-4, 0.2)  # range of a neighbouring mode's damping ratio


def has_own(residuals: str, *, several_modes: bool) -> bool:
    """Return whether a test has its own residual constants: if stated, or for several modes.

    The contribution of a mode above the band differs from band to band and from point to point. One
    constant for all would be a compromise that gains and shapes compensate, and no residual would
    show it.
    """
    return residuals == "own" or (residuals == "auto" and several_modes)


def taken(theta: Mapping[str, Any], residuals: str) -> dict[str, Any]:
    """Return, by name, those parameters that are residual terms of a test."""
    return {name: theta[name] for name in TAKEN[residuals] if name in theta}


def receptance(
    terms: Mapping[str, Array], omega: Float[Array, "*batch"]
) -> Inexact[Array, "*batch"]:
    r"""Return the receptance of the residual terms [m per N/kg]; without term L at omega = 0."""
    squared = jnp.where(omega > 0, omega, jnp.inf) ** 2
    total = terms.get(UPPER, 0.0) + terms.get(LOWER, 0.0) / squared
    for omega_k, zeta, share in ([terms[n] for n in mode] for mode in MODES if mode[0] in terms):
        total = total + share / (omega_k**2 - omega**2 + 2j * zeta * omega_k * omega)
    return total


def added_response(
    terms: Mapping[str, Array],
    force: Float[Array, " time"],
    fs: float,
    *,
    response: str,
    periodic: bool,
) -> Float[Array, " time"]:
    """Return the response of the residual terms to a force, at the driven frequencies.

    The record is one period, or at rest before and after. A constant force is ignored: it is an
    amplifier's offset, which 1 / omega^2 would turn into a drift.
    """
    length = force.shape[-1]
    padded = length if periodic else 2 * length
    spectrum = jnp.fft.rfft(force - jnp.mean(force), padded)
    spectrum = jnp.where(driven(jnp.abs(spectrum)), spectrum, 0.0)
    omega = 2 * np.pi * line_frequencies(padded, 1 / fs)
    factor = (1j * omega) ** derivative_order(response)
    return jnp.fft.irfft(factor * receptance(terms, omega) * spectrum, padded)[:length]


def own_columns(
    force: Float[np.ndarray, "level time"], fs: float, response: str, lines: tuple[int, int] | None
) -> Float[np.ndarray, "level 2 value"]:
    r"""Return a test's responses to unit U and L: $f_k = F_k (j\omega_k)^o$, $f_k / \omega_k^2$.

    For lines these are the real parts, then the imaginary parts; for samples, the signal of the
    driven lines in time.
    """
    length = force.shape[1]
    omega = 2 * np.pi * np.fft.rfftfreq(length, 1 / fs)
    spectrum = np.fft.rfft(force - force.mean(axis=1, keepdims=True))
    if lines is None:
        spectrum *= np.stack([np.asarray(driven(jnp.asarray(np.abs(level)))) for level in spectrum])
    first = spectrum * (1j * omega) ** derivative_order(response)
    both = np.stack([first, first / np.where(omega > 0, omega, np.inf) ** 2], axis=1)
    if lines is None:
        return np.fft.irfft(both, length)
    both = both[..., slice(*lines)]
    return np.concatenate([np.real(both), np.imag(both)], axis=-1)


def driven(size: Float[Array, " line"]) -> Bool[Array, " line"]:
    """Return which lines of a spectrum lie between the first and the last driven line.

    All lines between them are included: a shaker's force drops off where the structure resonates.
    """
    loud = size > DRIVEN * jnp.max(size)
    return (jnp.cumsum(loud) > 0) & (jnp.cumsum(loud[::-1])[::-1] > 0)


def neighbours_of(theta: Mapping[str, float]) -> tuple[float, ...]:
    """Return the natural frequencies [rad/s] of those neighbouring modes that are parameters."""
    return tuple(float(theta[mode[0]]) for mode in MODES if mode[0] in theta)


def bounds(omega_n: float, neighbours: Sequence[float] = ()) -> dict[str, tuple[float, float]]:
    """Return prior bounds of the residual terms: wide for constants, narrow for frequencies.

    A constant is bounded by thirty times the mode's own static response, a neighbour's gain by
    thirty times the mode's. A neighbour stays within 7 % of its observed frequency, and nearer to
    that than to any other mode.
    """
    limits = {UPPER: (-LARGEST / omega_n**2, LARGEST / omega_n**2), LOWER: (-LARGEST, LARGEST)}
    for (name, zeta, share), neighbour in zip(MODES, neighbours, strict=False):
        middles = [
            0.5 * (neighbour + other) for other in (omega_n, *neighbours) if other != neighbour
        ]
        low = max([(1 - NEAR) * neighbour, *(x for x in middles if x < neighbour)])
        high = min([(1 + NEAR) * neighbour, *(x for x in middles if x > neighbour)])
        limits |= {name: (low, high), zeta: DAMPED, share: (-LARGEST, LARGEST)}
    return limits
