"""Steady hysteresis loops from records: calculus in a band, the mean cycle, the enclosed area."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from jbw.errors import ConfigError, DataError
from jbw.measurement.channels import Reals, channel, passband, same_length, sampling
from jbw.measurement.harmonics import Tones, check_tones, sine_fit

ROLL_OFF = 0.2  # of each edge of the band, outside of it
ORDER = 64  # poles: thirty tones or so
RECENT = 2048  # samples next to an end from which it is predicted
MOST_HARMONICS = 25  # of a mean cycle


def enclosed_area(y: ArrayLike, force: ArrayLike) -> Reals:
    r"""Energy that a loop dissipates [J/kg], its area: positive when force works against motion.

    $$E = \oint F\,\mathrm{d}y = \pi\sum_n n\,\mathrm{Im}(F_n \bar Y_n)$$

    with Y_n, F_n the Fourier coefficients of displacement [m] and force [N/kg] over a cycle, of
    shape (time,) or (repeat, time). Noise in the two channels adds no bias when it is independent,
    and band-limited loops come out exact.
    """
    y, force = channel(y, "y"), channel(force, "force")
    same_length(y=y, force=force)
    num_samples = y.shape[-1]
    if num_samples < 8:
        raise DataError(f"A cycle must have at least 8 samples, but it has {num_samples}.")
    y_k, f_k = (2 / num_samples * np.fft.rfft(x) for x in (y, force))
    k = np.arange(y_k.shape[-1])
    if num_samples % 2 == 0:
        k[-1] = 0  # the sine of the Nyquist frequency is not seen
    return np.pi * np.sum(k * (f_k * y_k.conj()).imag, axis=-1)


def mean_cycles(x: Reals, fs: float, omega: float, num_points: int) -> Reals:
    """A cycle of every channel of shape (channel, time), at omega t from 0 to 2 pi, end excluded.

    A fit of harmonics over all cycles: samples need not fall on the same phases in each of them.
    """
    carried = int(0.9 * np.pi * fs / omega) if omega > 0 else 1  # else refused below
    tones = Tones(omega, max(1, min(MOST_HARMONICS, carried)))
    check_tones(tones, fs, x.shape[-1])
    phase = 2 * np.pi * np.arange(num_points) / num_points
    turn = np.exp(1j * np.outer(np.arange(1, tones.num_harmonics + 1), phase))
    return (sine_fit(x, np.arange(x.shape[-1]) / fs, tones).amplitudes @ turn).real


def integrate(x: ArrayLike, fs: float, band: tuple[float, float]) -> Reals:
    r"""Integral over time without drift, zero mean: X(omega) / (j omega) inside a stated band.

    Outside of it the gain falls to zero over a fifth of each edge. The record is continued by
    linear prediction: steady or decaying tones come out to about 1e-3, worst at the ends. Samples
    have the shape (time,) or (repeat, time); the band [Hz] must start above zero.
    """
    if not band[0] > 0:
        raise ConfigError(
            f"Argument `band` must start above zero to integrate, but it starts at {band[0]:g} Hz.",
            why="Division by j omega turns the offset of a sensor into a drift.",
        )
    return _in_band(x, fs, band, lambda omega: 1 / (1j * omega))


def differentiate(x: ArrayLike, fs: float, band: tuple[float, float]) -> Reals:
    """Derivative by time inside a band, j omega X(omega); its upper edge bounds the noise."""
    return _in_band(x, fs, band, lambda omega: 1j * omega)


def _in_band(
    x: ArrayLike, fs: float, band: tuple[float, float], factor: Callable[[Reals], NDArray[Any]]
) -> Reals:
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
    reach = int(4 * fs / low) if low > 0 else num_samples
    extended = continued(x, reach)
    omega = 2 * np.pi * np.fft.rfftfreq(extended.shape[-1], 1 / fs)
    gain = np.zeros(omega.shape, complex)
    gain[1:] = factor(omega[1:]) * _gain(omega[1:] / (2 * np.pi), low, high)
    filtered = np.fft.irfft(np.fft.rfft(extended) * gain, extended.shape[-1])
    return filtered[..., reach : reach + num_samples]


def _gain(f: Reals, low: float, high: float) -> Reals:
    """One inside the band, falling by a raised cosine outside of it."""
    below = np.clip((low - f) / (ROLL_OFF * low), 0, 1) if low > 0 else np.zeros_like(f)
    above = np.clip((f - high) / (ROLL_OFF * high), 0, 1)
    return np.cos(np.pi / 2 * below) ** 2 * np.cos(np.pi / 2 * above) ** 2


def continued(x: Reals, reach: int) -> Reals:
    """Samples (..., time) with `reach` predicted ones before and after, fading to their mean."""
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


def _predicted(x: Reals, num_samples: int) -> Reals:
    """What follows the samples when they go on as an autoregressive process."""
    order = min(ORDER, len(x) // 3)
    coefficients = _burg(x[-RECENT:], order)
    state = signal.lfiltic([1.0], coefficients, x[: -order - 1 : -1])
    return signal.lfilter([1.0], coefficients, np.zeros(num_samples), zi=state)[0]


def _burg(x: Reals, order: int) -> Reals:
    """Coefficients (1, a_1, ..., a_p) of sum_i a_i x[n - i] = e[n] by Burg's method: stable."""
    # J. P. Burg, Maximum entropy spectral analysis, PhD thesis, Stanford (1975).
    forward, backward = x[1:], x[:-1]
    a = np.ones(1)
    for _ in range(order):
        power = forward @ forward + backward @ backward
        k = -2 * (forward @ backward) / power if power > 0 else 0.0
        a = np.append(a, 0.0)
        a = a + k * a[::-1]
        forward, backward = (forward + k * backward)[1:], (backward + k * forward)[:-1]
    return a
