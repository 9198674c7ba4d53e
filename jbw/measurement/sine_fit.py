"""Least-squares sine fit of simultaneous tones, and the noise it leaves beside each of them."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from jbw.errors import ConfigError, DataError

# Bins of the residual's spectrum from which the noise at a harmonic is read: 12 % of scatter, over
# a width of 64 / (duration) in which the spectrum must not bend.
NEAREST_BINS = 64


class Tones(NamedTuple):
    """What is fitted to samples: the harmonics of a tone, and others beside it.

    Attributes:
        omega: Angular frequency of the first harmonic [rad/s].
        num_harmonics: Highest order.
        also: Other angular frequencies present [rad/s].
    """

    omega: float
    num_harmonics: int
    also: tuple[float, ...] = ()

    @property
    def unknowns(self) -> int:
        """Columns of the fit: two of each tone, a constant and a trend."""
        return 2 * (self.num_harmonics + len(self.also)) + 2


@dataclass(frozen=True)
class SineFit:
    """A fit of constant, trend and tones to samples of shape (..., time).

    Attributes:
        amplitudes: Complex peak amplitudes of the harmonics, shape (..., harmonic).
        residual: What the fit leaves, shape (..., time).
        inverse: (X^T X)^-1 for (Re Y_1, Im Y_1, Re Y_2, ...).
        tones: Angular frequencies of all tones fitted [rad/s].
        dof: Samples less unknowns.
    """

    amplitudes: NDArray[np.complex128]
    residual: NDArray[np.float64]
    inverse: NDArray[np.float64]
    tones: NDArray[np.float64]
    dof: int


def sine_fit(y: NDArray[np.float64], t: NDArray[np.float64], tones: Tones) -> SineFit:
    """Fit a constant, a trend, the harmonics of omega and the tones beside it.

    Args:
        y: Samples, shape (..., time).
        t: Times [s].
        tones: What to fit.

    Returns:
        The fit; the columns are cos and -sin, so that c + js is the complex amplitude.

    Raises:
        DataError: Two tones too close for the record's length.
    """
    return _fitted(y, _design(t, tones), tones)


def _fitted(y: NDArray[np.float64], design: NDArray[np.float64], tones: Tones) -> SineFit:
    """The fit to rows of a design."""
    num_samples = design.shape[1]
    normal = design @ design.T
    if np.linalg.cond(normal) > 1e8:
        raise DataError(
            "The tones cannot be told apart in a record of this length.",
            why="Two of the frequencies fitted nearly coincide.",
            remedy="Lengthen the record or leave one of `also` out.",
        )
    factor = cho_factor(normal)
    solution = cho_solve(factor, design @ y.reshape(-1, num_samples).T).T
    residual = y - solution.reshape(*y.shape[:-1], -1) @ design
    # A second pass on the residual recovers the digits that the normal equations round off.
    change = cho_solve(factor, design @ residual.reshape(-1, num_samples).T).T
    solution = (solution + change).reshape(*y.shape[:-1], -1)
    residual = y - solution @ design
    kept = slice(0, 2 * tones.num_harmonics)
    amplitudes = solution[..., kept][..., 0::2] + 1j * solution[..., kept][..., 1::2]
    inverse = cho_solve(factor, np.eye(len(design)))[kept, kept]
    orders = np.arange(1, tones.num_harmonics + 1)
    omegas = np.concatenate([tones.omega * orders, np.asarray(tones.also, float)])
    return SineFit(amplitudes, residual, inverse, omegas, num_samples - len(design))


def _design(t: NDArray[np.float64], tones: Tones) -> NDArray[np.float64]:
    """Rows cos and -sin of every tone in turn, a constant and a trend, shape (unknown, time)."""
    turn = np.tile(np.exp(-1j * tones.omega * t), (tones.num_harmonics, 1))
    turning = np.multiply.accumulate(turn)
    others = np.exp(-1j * np.outer(np.asarray(tones.also, float), t))
    pairs = [row for turn in (*turning, *others) for row in (turn.real, turn.imag)]
    return np.vstack([*pairs, np.ones_like(t), (t - t.mean()) / np.ptp(t)])


def amplitude_covariance(
    fit: SineFit, fs: float, omega: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Covariance of (Re Y_1, Im Y_1, ...) for noise that may be coloured.

    (X^T X)^-1, scaled by the residual's level beside each harmonic as if it were white there.

    Args:
        fit: The fit.
        fs: Sampling frequency [Hz].
        omega: Angular frequency of each harmonic [rad/s].

    Returns:
        Covariance, shape (..., 2 harmonic, 2 harmonic).
    """
    level = np.repeat(np.sqrt(local_level(fit, fs, omega)), 2, axis=-1)
    return level[..., :, None] * fit.inverse * level[..., None, :]


def local_level(fit: SineFit, fs: float, omega: NDArray[np.float64]) -> NDArray[np.float64]:
    """Variance that white noise with the residual's spectral density at each omega would have.

    Args:
        fit: The fit.
        fs: Sampling frequency [Hz].
        omega: Angular frequencies [rad/s].

    Returns:
        Variance, shape (..., harmonic).
    """
    num_samples = fit.residual.shape[-1]
    # The Hann window keeps strong remains elsewhere (hum, other tones) out of the local bins.
    w = np.sin(np.pi * (np.arange(num_samples) + 0.5) / num_samples) ** 2
    power = np.abs(np.fft.rfft(fit.residual * w)) ** 2 / np.sum(w**2)
    bins = np.arange(power.shape[-1])
    to_bins = num_samples / (2 * np.pi * fs)
    # Within two bins of a fitted tone, and of the constant, the fit has taken the noise as well.
    free = np.all(np.abs(bins[:, None] - fit.tones * to_bins) > 2, axis=-1) & (bins > 2)
    free = np.flatnonzero(free[:-1])
    if free.size < 4:
        white = np.sum(fit.residual**2, axis=-1) / fit.dof
        return np.broadcast_to(white[..., None], (*white.shape, len(omega)))
    nearest = [free[np.argsort(np.abs(free - o * to_bins))[:NEAREST_BINS]] for o in omega]
    return np.stack([power[..., local].mean(axis=-1) for local in nearest], axis=-1)


def _halves(
    y: NDArray[np.float64], t: NDArray[np.float64], tones: Tones
) -> tuple[SineFit, SineFit]:
    """The fits to the first and the second half of the samples, by one design."""
    design, half = _design(t, tones), len(t) // 2
    return (
        _fitted(y[..., :half], design[:, :half], tones),
        _fitted(y[..., half:], design[:, half:], tones),
    )


def half_drift(
    y: NDArray[np.float64], t: NDArray[np.float64], tones: Tones
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Relative change of the first harmonic from half to half, and what noise alone makes of it."""
    parts = _halves(y, t, tones)
    first, second = (part.amplitudes[..., 0] for part in parts)
    size = np.maximum(np.abs(first), np.finfo(float).tiny)
    fs, at = 1 / (t[1] - t[0]), np.full(tones.num_harmonics, tones.omega)
    noise = sum(
        amplitude_covariance(part, fs, at)[..., :2, :2].trace(axis1=-2, axis2=-1) for part in parts
    )
    return np.abs(second - first) / size, np.sqrt(noise) / size


def refined(y: NDArray[np.float64], t: NDArray[np.float64], tones: Tones) -> Tones:
    """The frequency at which the mean phase of the first harmonic stands still between halves."""
    half = len(t) // 2
    for _ in range(4):
        first, second = (part.amplitudes[..., 0] for part in _halves(y, t, tones))
        turn = np.angle(np.sum(second * first.conj()))
        omega = tones.omega + turn / (t[half:].mean() - t[:half].mean())
        tones = tones._replace(omega=float(omega))
    return tones


def check_tones(tones: Tones, fs: float) -> None:
    """Refuse a tone whose highest harmonic the sampling does not carry.

    Raises:
        ConfigError: `omega` or `num_harmonics` is not positive.
        DataError: The highest harmonic is above the Nyquist frequency.
    """
    omega, num_harmonics, _ = tones
    if not (np.isfinite(omega) and omega > 0):
        raise ConfigError(f"Argument `omega` must be positive [rad/s], but it is {omega}.")
    if num_harmonics < 1:
        raise ConfigError(
            f"Argument `num_harmonics` must be at least 1, but it is {num_harmonics}."
        )
    highest = num_harmonics * omega / (2 * np.pi)
    if highest >= (1 - 1e-6) * fs / 2:  # the sine of the Nyquist frequency is not seen either
        raise DataError(
            f"Harmonic {num_harmonics} of {omega / (2 * np.pi):.4g} Hz lies at {highest:.4g} Hz, "
            f"but a record at {fs:g} Hz ends at {fs / 2:g} Hz.",
            why="Above half the sampling frequency a harmonic folds back onto another frequency.",
            remedy=f"Sample above {2 * highest:.4g} Hz, or ask for fewer harmonics.",
        )


def check_length(tones: Tones, fs: float, num_samples: int, start: float = 0.0) -> None:
    """Refuse a record too short for the fit, naming the duration it needs.

    Args:
        tones: What is to be fitted.
        fs: Sampling frequency [Hz].
        num_samples: Samples of the whole record.
        start: Time that is discarded first [s].

    Raises:
        DataError: It is.
    """
    # Each half must hold a period for the drift, and more samples than the fit has unknowns.
    needed = max(4 * np.pi / tones.omega, 2 * (tones.unknowns + 1) / fs)
    if (num_samples - round(start * fs)) / fs < needed * (1 - 1e-9):
        raise DataError(
            f"The record must last {start + needed:.4g} s (two periods after the {start:g} s "
            f"discarded), but it lasts {num_samples / fs:.4g} s.",
            remedy="Measure longer, or discard less.",
        )
