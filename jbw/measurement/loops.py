"""Hysteresis loops from records: drift-free integration, restoring force, enclosed area."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jbw.errors import ConfigError, DataError
from jbw.measurement.channels import channel, passband, same_length, sampling
from jbw.measurement.continuation import continued
from jbw.measurement.sine_fit import check_length, check_tone, sine_fit

ROLL_OFF = 0.2  # of each edge of the band, outside of it


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


def restoring_force(
    u: ArrayLike,
    a: ArrayLike,
    v: ArrayLike,
    zeta: float,
    omega_n: float,
    *,
    viscous: bool = False,
) -> NDArray[np.float64]:
    r"""Restoring force per unit mass, from the balance of the oscillator.

    $$F = u - a - 2\zeta\omega_n v = k\,y + Z, \qquad
      F_{\mathrm{viscous}} = u - a = k\,y + Z + 2\zeta\omega_n v$$

    Args:
        u: Input as the oscillator sees it: gain times volts [N/kg].
        a: Acceleration [m/s^2].
        v: Velocity [m/s].
        zeta: Viscous damping ratio [-].
        omega_n: Natural frequency [rad/s].
        viscous: Whether to leave the viscous part in.

    Returns:
        Force [N/kg].

    Raises:
        DataError: NaN or unequal shapes.

    Reference:
        Eq. (1).
    """
    u, a, v = channel(u, "u"), channel(a, "a"), channel(v, "v")
    same_length(u=u, a=a, v=v)
    return u - a if viscous else u - a - 2 * zeta * omega_n * v


def enclosed_area(y: ArrayLike, force: ArrayLike, cycles: int = 1) -> NDArray[np.float64]:
    r"""Energy dissipated in a cycle, the loop's area: positive when force works against motion.

    $$E = \oint F\,\mathrm{d}y = \pi\sum_n n\,\mathrm{Im}(F_n \bar Y_n)$$

    with Y_n, F_n the Fourier coefficients of samples that cover whole cycles. Noise in the two
    channels adds no bias when it is independent, and band-limited loops come out exact.

    Args:
        y: Displacement over a whole number of cycles, shape (time,) or (repeat, time) [m].
        force: Force, of the same shape [N/kg].
        cycles: Cycles in the samples.

    Returns:
        Energy of a cycle, the mean over them, shape () or (repeat,) [J/kg].

    Raises:
        DataError: NaN, unequal shapes, fewer than 8 samples a cycle.
        ConfigError: `cycles` below 1.
    """
    y, force = channel(y, "y"), channel(force, "force")
    same_length(y=y, force=force)
    num_samples = y.shape[-1]
    if cycles < 1:
        raise ConfigError(f"Argument `cycles` must be at least 1, but it is {cycles}.")
    if num_samples < 8 * cycles:
        raise DataError(
            f"A cycle must have at least 8 samples, but {num_samples} samples hold {cycles} cycles."
        )
    y_k, f_k = (2 / num_samples * np.fft.rfft(x) for x in (y, force))
    k = np.arange(y_k.shape[-1])
    if num_samples % 2 == 0:
        k[-1] = 0  # the sine of the Nyquist frequency is not seen
    return np.pi * np.sum(k * (f_k * y_k.conj()).imag, axis=-1) / cycles


@dataclass(frozen=True)
class MeanCycle:
    """A loop averaged over its cycles, on a uniform grid of phase.

    Attributes:
        phase: omega t from 0 to 2 pi, end excluded; zero at the record's first sample [rad].
        y: Displacement, shape (..., phase) [m].
        force: Force, shape (..., phase) [N/kg].
        y_residual_std: Standard deviation of what does not repeat from cycle to cycle [m].
        force_residual_std: The same of the force [N/kg].
        cycles: Periods averaged.
    """

    phase: NDArray[np.float64]
    y: NDArray[np.float64]
    force: NDArray[np.float64]
    y_residual_std: NDArray[np.float64]
    force_residual_std: NDArray[np.float64]
    cycles: float


def mean_cycle(
    y: ArrayLike,
    force: ArrayLike,
    fs: float,
    omega: float,
    num_points: int = 256,
    *,
    num_harmonics: int | None = None,
) -> MeanCycle:
    """One cycle of a steady loop, averaged over all cycles by a fit of harmonics.

    The samples need not fall on the same phases in each cycle; offset and trend are left out.

    Args:
        y: Displacement, shape (time,) or (repeat, time) [m].
        force: Force, of the same shape [N/kg].
        fs: Sampling frequency [Hz].
        omega: Angular frequency of the cycle [rad/s].
        num_points: Points of the averaged cycle.
        num_harmonics: Highest order kept; by default 25, or what the sampling carries.

    Returns:
        The averaged cycle, ready for `enclosed_area`.

    Raises:
        DataError: NaN, unequal shapes, fewer than two periods, a harmonic above Nyquist.
    """
    y, force, fs = channel(y, "y"), channel(force, "force"), sampling(fs)
    same_length(y=y, force=force)
    check_tone(omega, 1 if num_harmonics is None else num_harmonics, fs)
    if num_harmonics is None:
        num_harmonics = max(1, min(25, int(0.9 * np.pi * fs / omega)))
    num_samples = y.shape[-1]
    duration = num_samples / fs
    check_length(duration, duration, 0.0, omega, num_samples, num_harmonics, ())
    t = np.arange(num_samples) / fs
    phase = 2 * np.pi * np.arange(num_points) / num_points
    turn = np.exp(1j * np.outer(np.arange(1, num_harmonics + 1), phase))
    fits = [sine_fit(x, t, omega, num_harmonics) for x in (y, force)]
    loop = [(fit.amplitudes @ turn).real for fit in fits]
    spread = [np.sqrt(np.sum(fit.residual**2, axis=-1) / fit.dof) for fit in fits]
    return MeanCycle(phase, *loop, *spread, cycles=float(omega * duration / (2 * np.pi)))


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
