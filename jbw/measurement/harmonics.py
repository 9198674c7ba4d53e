"""Harmonic filtering: complex amplitudes of a steady tone and its multiples, with covariance."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jbw.errors import ConfigError, DataError
from jbw.measurement.channels import channel, derivative_order, sampling

NEAREST_BINS = 64  # of the residual's spectrum, from which the noise at a harmonic is read
DRIFT_LIMIT = 0.01


@dataclass(frozen=True)
class Harmonics:
    """Steady harmonics y(t) = Re sum Y_n exp(j n omega t), t counted from the first sample given.

    Attributes:
        omega: Angular frequency of the first harmonic [rad/s].
        amplitudes: Complex peak displacement amplitudes of orders 1..n, shape (..., harmonic) [m].
        covariance: Of (Re Y_1, Im Y_1, Re Y_2, ...), shape (..., 2 harmonic, 2 harmonic) [m^2];
            the noise may be coloured, its level is read beside each harmonic.
        drift: Change of Y_1 from the first half of the record to the second, relative; shape (...).
        drift_std: What noise alone makes of it.
        residual_std: Standard deviation of what the harmonics do not explain, in the unit measured.
        cycles: Periods in the record.
        off_bin: Distance of omega from the nearest line of a Fourier transform, in lines; the
            least-squares fit does not mind, a transform would leak.
    """

    omega: float
    amplitudes: NDArray[np.complex128]
    covariance: NDArray[np.float64]
    drift: NDArray[np.float64]
    drift_std: NDArray[np.float64]
    residual_std: NDArray[np.float64]
    cycles: float
    off_bin: float

    @property
    def variance(self) -> NDArray[np.float64]:
        """E|error|^2 of each amplitude, real and imaginary part together [m^2]."""
        return np.diagonal(self.covariance, axis1=-2, axis2=-1).reshape(
            *self.amplitudes.shape, 2
        ).sum(axis=-1)  # fmt: skip


def harmonics(
    y: ArrayLike,
    fs: float,
    omega: float,
    num_harmonics: int,
    *,
    response: str = "displacement",
    start: float = 0.0,
    delay: float = 0.0,
    also: Sequence[float] = (),
    refine: bool = False,
) -> Harmonics:
    r"""Complex amplitudes of orders 1..n by a least-squares sine fit.

    $$y(t) \approx c_0 + c_1 t + \mathrm{Re}\sum_n Y_n e^{jn\omega t}, \qquad
      Y_n = \frac{V_n}{jn\omega} = \frac{A_n}{-(n\omega)^2}$$

    The tone need not fall on a line of the Fourier transform. Holds for the steady state: a
    transient left in shows as `drift`, with a warning above 1 %.

    Args:
        y: Response, shape (time,) or (repeat, time).
        fs: Sampling frequency [Hz].
        omega: Angular frequency of the tone [rad/s].
        num_harmonics: Highest order to fit.
        response: What `y` is: displacement, velocity or acceleration.
        start: Time to discard first [s]; phases stay those of the record's first sample.
        delay: Lag of the channel to take out [s].
        also: Angular frequencies present besides, fitted and left out [rad/s].
        refine: Whether to correct `omega` by the record itself (from its mean phase drift).

    Returns:
        Amplitudes of the displacement with their covariance.

    Raises:
        DataError: NaN, a record shorter than two periods or than the fit's unknowns, a harmonic
            above the Nyquist frequency.
        ConfigError: An option that cannot be meant.
    """
    y, fs, order = channel(y, "y"), sampling(fs), derivative_order(response)
    _check_tone(omega, num_harmonics, fs)
    skip = round(start * fs)
    t = np.arange(skip, y.shape[-1]) / fs
    _check_length(len(t) / fs, y.shape[-1] / fs, start, omega, len(t), num_harmonics, also)
    y = y[..., skip:]
    if refine:
        omega = _refined(y, t, omega, num_harmonics, also)
    n = np.arange(1, num_harmonics + 1)
    fitted = _fit(y, t, omega, num_harmonics, also)
    to_displacement = np.exp(1j * n * omega * delay) / (1j * n * omega) ** order
    half = len(t) // 2
    drift, drift_std = _drift(y, t, half, omega, num_harmonics, also)
    cycles = omega * len(t) / (2 * np.pi * fs)
    result = Harmonics(
        omega=float(omega),
        amplitudes=fitted.amplitudes * to_displacement,
        covariance=_rotated(_covariance(fitted, fs, n * omega), to_displacement),
        drift=drift,
        drift_std=drift_std,
        residual_std=np.sqrt(np.sum(fitted.residual**2, axis=-1) / fitted.dof),
        cycles=float(cycles),
        off_bin=float(cycles - round(cycles)),
    )
    _warn_when_drifting(result)
    return result


@dataclass(frozen=True)
class _Fit:
    """A least-squares sine fit in the unit measured, the residual it leaves, and (X^T X)^-1."""

    amplitudes: NDArray[np.complex128]
    residual: NDArray[np.float64]
    inverse: NDArray[np.float64]
    tones: NDArray[np.float64]
    dof: int


def _fit(
    y: NDArray[np.float64],
    t: NDArray[np.float64],
    omega: float,
    num_harmonics: int,
    also: Sequence[float] = (),
) -> _Fit:
    """Fit constant, trend and tones; the columns are cos and -sin, so c + js is the amplitude."""
    tones = np.concatenate([omega * np.arange(1, num_harmonics + 1), np.asarray(also, float)])
    angle = np.outer(t, tones)
    middle, span = t.mean(), np.ptp(t)
    pairs = np.stack([np.cos(angle), -np.sin(angle)], axis=-1).reshape(len(t), -1)
    design = np.column_stack([pairs, np.ones_like(t), (t - middle) / span])
    q, r = np.linalg.qr(design)
    if np.linalg.cond(r) > 1e8:
        raise DataError(
            "The tones cannot be told apart in a record of this length.",
            why="Two of the frequencies fitted nearly coincide.",
            remedy="Lengthen the record or leave one of `also` out.",
        )
    r_inverse = np.linalg.inv(r)
    solution = (y @ q) @ r_inverse.T
    # A second pass on the residual recovers the digits that the first one rounds off.
    residual = y - solution @ design.T
    solution = solution + (residual @ q) @ r_inverse.T
    residual = y - solution @ design.T
    kept = slice(0, 2 * num_harmonics)
    amplitudes = solution[..., kept][..., 0::2] + 1j * solution[..., kept][..., 1::2]
    inverse = (r_inverse @ r_inverse.T)[kept, kept]
    return _Fit(amplitudes, residual, inverse, tones, len(t) - design.shape[1])


def _covariance(fit: _Fit, fs: float, omega: NDArray[np.float64]) -> NDArray[np.float64]:
    """(X^T X)^-1 scaled by the residual's level beside each harmonic, as if white there."""
    level = np.repeat(np.sqrt(_local_level(fit, fs, omega)), 2, axis=-1)
    return level[..., :, None] * fit.inverse * level[..., None, :]


def _local_level(
    fit: _Fit, fs: float, omega: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Variance that white noise with the residual's spectral density at each omega would have."""
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


def _rotated(
    covariance: NDArray[np.float64], factor: NDArray[np.complex128]
) -> NDArray[np.float64]:
    """Covariance after each complex amplitude was multiplied by its factor."""
    turn = np.zeros(covariance.shape[-2:])
    for i, f in enumerate(factor):
        turn[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[f.real, -f.imag], [f.imag, f.real]]
    return turn @ covariance @ turn.T


def _drift(
    y: NDArray[np.float64],
    t: NDArray[np.float64],
    half: int,
    omega: float,
    num_harmonics: int,
    also: Sequence[float],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Relative change of the first harmonic between the halves, and its noise."""
    parts = [_fit(y[..., s], t[s], omega, num_harmonics, also) for s in (slice(half), slice(half, None))]
    first, second = (part.amplitudes[..., 0] for part in parts)
    size = np.maximum(np.abs(first), np.finfo(float).tiny)
    fs = 1 / (t[1] - t[0])
    noise = sum(
        _covariance(part, fs, np.array([omega] * num_harmonics))[..., :2, :2].trace(axis1=-2, axis2=-1)
        for part in parts
    )
    return np.abs(second - first) / size, np.sqrt(noise) / size


def _refined(
    y: NDArray[np.float64],
    t: NDArray[np.float64],
    omega: float,
    num_harmonics: int,
    also: Sequence[float],
) -> float:
    """Frequency at which the mean phase of the first harmonic stands still from half to half."""
    half = len(t) // 2
    for _ in range(4):
        first = _fit(y[..., :half], t[:half], omega, num_harmonics, also).amplitudes[..., 0]
        second = _fit(y[..., half:], t[half:], omega, num_harmonics, also).amplitudes[..., 0]
        turn = np.angle(np.sum(second * first.conj()))
        omega += turn / (t[half:].mean() - t[:half].mean())
    return float(omega)


def _check_tone(omega: float, num_harmonics: int, fs: float) -> None:
    if not (np.isfinite(omega) and omega > 0):
        raise ConfigError(f"Argument `omega` must be positive [rad/s], but it is {omega}.")
    if num_harmonics < 1:
        raise ConfigError(f"Argument `num_harmonics` must be at least 1, but it is {num_harmonics}.")
    highest = num_harmonics * omega / (2 * np.pi)
    if highest >= fs / 2:
        raise DataError(
            f"Harmonic {num_harmonics} of {omega / (2 * np.pi):.4g} Hz lies at {highest:.4g} Hz, "
            f"but a record at {fs:g} Hz ends at {fs / 2:g} Hz.",
            why="Above half the sampling frequency a harmonic folds back onto another frequency.",
            remedy=f"Sample above {2 * highest:.4g} Hz, or ask for fewer harmonics.",
        )


def _check_length(
    duration: float,
    total: float,
    start: float,
    omega: float,
    num_samples: int,
    num_harmonics: int,
    also: Sequence[float],
) -> None:
    # Each half must hold a period for the drift, and more samples than the fit has unknowns.
    unknowns = 2 * (num_harmonics + len(also)) + 2
    fs = num_samples / duration if duration > 0 else np.inf
    needed = max(4 * np.pi / omega, 2 * (unknowns + 1) / fs)
    if duration < needed * (1 - 1e-9):
        raise DataError(
            f"The record must last {start + needed:.4g} s (two periods after the {start:g} s "
            f"discarded), but it lasts {total:.4g} s.",
            remedy="Measure longer, or discard less.",
        )


def _warn_when_drifting(result: Harmonics) -> None:
    drifting = (result.drift > DRIFT_LIMIT) & (result.drift > 3 * result.drift_std)
    if np.any(drifting):
        warnings.warn(
            f"The first harmonic at {result.omega / (2 * np.pi):.4g} Hz changes by "
            f"{np.max(result.drift):.1%} from one half of the record to the other: a transient is "
            "left, or the frequency is not exact. Discard more with `start`.",
            stacklevel=3,
        )
