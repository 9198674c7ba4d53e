"""Integration and differentiation of records in a band, without drift and without edges."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from jbw.errors import ConfigError, DataError
from jbw.measurement.channels import channel, passband, sampling

ROLL_OFF = 0.2  # of each edge of the band, outside of it
ORDER = 64  # poles: thirty tones or so
RECENT = 2048  # samples next to an end from which it is predicted


def integrate(
    x: ArrayLike, fs: float, band: tuple[float, float], *, periodic: bool = False
) -> NDArray[np.float64]:
    r"""Integral over time without drift: X(omega) / (j omega) inside a stated band.

    Exact inside the band; outside, the gain falls to zero over a fifth of each edge.

    Args:
        x: Samples, shape (time,) or (repeat, time).
        fs: Sampling frequency [Hz].
        band: Lowest and highest frequency to keep [Hz]; the lowest must exceed zero.
        periodic: Whether the record holds whole periods (then exact to rounding). Otherwise it is
            continued by linear prediction: steady or decaying tones come out to about 1e-3, worst
            at the ends.

    Returns:
        The integral with zero mean.

    Raises:
        DataError: NaN, or a record shorter than one period of the lowest frequency.
        ConfigError: An empty band, or one that starts at zero.
    """
    if not band[0] > 0:
        raise ConfigError(
            f"Argument `band` must start above zero to integrate, but it starts at {band[0]:g} Hz.",
            why="Division by j omega turns the offset of a sensor into a drift.",
        )
    return _in_band(x, fs, band, periodic, lambda omega: 1 / (1j * omega))


def differentiate(
    x: ArrayLike, fs: float, band: tuple[float, float], *, periodic: bool = False
) -> NDArray[np.float64]:
    r"""Derivative by time inside a stated band: j omega X(omega).

    The upper edge bounds the noise, which grows with frequency. Edges as in `integrate`.

    Args:
        x: Samples, shape (time,) or (repeat, time).
        fs: Sampling frequency [Hz].
        band: Lowest and highest frequency to keep [Hz].
        periodic: Whether the record holds whole periods.

    Returns:
        The derivative.

    Raises:
        DataError: NaN, or a record shorter than one period of the lowest frequency.
        ConfigError: An empty band.
    """
    return _in_band(x, fs, band, periodic, lambda omega: 1j * omega)


def _in_band(
    x: ArrayLike,
    fs: float,
    band: tuple[float, float],
    periodic: bool,
    factor: Callable[[NDArray[np.float64]], NDArray[Any]],
) -> NDArray[np.float64]:
    """Multiply the spectrum by factor(omega) inside the band."""
    x, fs = channel(x, "x"), sampling(fs)
    low, high = passband(band, fs / 2)
    num_samples = x.shape[-1]
    if 0 < low * num_samples / fs < 1 - 1e-9:
        raise DataError(
            f"The record must hold a period of the lowest frequency, {1 / low:.4g} s, but it lasts "
            f"{num_samples / fs:.4g} s.",
            remedy="Raise the band's lower edge, or measure longer.",
        )
    reach = 0 if periodic else int(4 * fs / low) if low > 0 else num_samples
    extended = continued(x, reach) if reach else x
    omega = 2 * np.pi * np.fft.rfftfreq(extended.shape[-1], 1 / fs)
    gain = np.zeros(omega.shape, complex)
    gain[1:] = factor(omega[1:]) * _gain(omega[1:] / (2 * np.pi), low, high)
    filtered = np.fft.irfft(np.fft.rfft(extended) * gain, extended.shape[-1])
    return filtered[..., reach : reach + num_samples]


def _gain(f: NDArray[np.float64], low: float, high: float) -> NDArray[np.float64]:
    """One inside the band, falling by a raised cosine outside of it."""
    below = np.clip((low - f) / (ROLL_OFF * low), 0, 1) if low > 0 else np.zeros_like(f)
    above = np.clip((f - high) / (ROLL_OFF * high), 0, 1)
    return np.cos(np.pi / 2 * below) ** 2 * np.cos(np.pi / 2 * above) ** 2


def continued(x: NDArray[np.float64], reach: int) -> NDArray[np.float64]:
    """Samples with `reach` predicted ones before and after, fading to the record's mean.

    Sums of steady or decaying tones continue as they were; what cannot be predicted fades out.

    Args:
        x: Samples, shape (..., time).
        reach: Samples to add at each end.

    Returns:
        Samples, shape (..., time + 2 reach).
    """
    mean = x.mean(axis=-1, keepdims=True)
    fade = np.cos(np.linspace(0, np.pi / 2, reach)) ** 2
    rows = (x - mean).reshape(-1, x.shape[-1])
    extended = [
        np.concatenate(
            [(fade * _predicted(row[::-1], reach))[::-1], row, fade * _predicted(row, reach)]
        )
        for row in rows
    ]
    return np.reshape(extended, (*x.shape[:-1], -1)) + mean


def _predicted(x: NDArray[np.float64], num_samples: int) -> NDArray[np.float64]:
    """What follows the samples when they go on as an autoregressive process."""
    order = min(ORDER, len(x) // 3)
    coefficients = burg(x[-RECENT:], order)
    state = signal.lfiltic([1.0], coefficients, x[: -order - 1 : -1])
    return signal.lfilter([1.0], coefficients, np.zeros(num_samples), zi=state)[0]


def burg(x: NDArray[np.float64], order: int) -> NDArray[np.float64]:
    """Coefficients (1, a_1, ..., a_p) of sum_i a_i x[n - i] = e[n] by Burg's method: stable.

    Args:
        x: Samples, shape (time,).
        order: Order p.

    Returns:
        The p + 1 coefficients.

    Reference:
        J. P. Burg, Maximum entropy spectral analysis, PhD thesis, Stanford (1975).
    """
    forward, backward = x[1:], x[:-1]
    a = np.ones(1)
    for _ in range(order):
        power = forward @ forward + backward @ backward
        k = -2 * (forward @ backward) / power if power > 0 else 0.0
        a = np.append(a, 0.0)
        a = a + k * a[::-1]
        forward, backward = (forward + k * backward)[1:], (backward + k * forward)[:-1]
    return a
