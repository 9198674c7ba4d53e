"""Harmonic filtering: complex amplitudes of a steady tone and its multiples, with covariance."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag, cho_factor, cho_solve

from jbw.errors import ConfigError, DataError
from jbw.measurement.channels import Complexes, Reals, channel, sampling
from jbw.quantities import Motion, derivative_order

DRIFT_LIMIT = 0.01
NOISE_FLOOR = 3.0  # number of standard errors above which a value is not noise
# Number of bins of the residual's spectrum that are averaged for the noise at a harmonic: the
# estimate varies by 12 %, over a width of 64 / (duration) in which the spectrum must be smooth.
NEAREST_BINS = 64


@dataclass(frozen=True)
class Harmonics:
    """Harmonics of a steady motion: y(t) = Re sum Y_n exp(j n omega t) from the first sample on."""

    omega: float  # angular frequency of the first harmonic [rad/s]
    amplitudes: Complexes  # peak amplitudes of orders 1..n, shape (..., harmonic) [m]
    # covariance of (Re Y_1, Im Y_1, Re Y_2, ...), shape (..., 2 harmonic, 2 harmonic) [m^2]
    covariance: Reals
    drift: Reals  # relative change of Y_1 between the halves of the record, shape (...)
    drift_std: Reals  # standard deviation of `drift` from noise alone
    residual_std: Reals  # rms of the residual of the fit, in the measured unit
    cycles: float  # number of periods in the record
    # distance from omega to the nearest Fourier line, in lines; unlike a Fourier transform, the fit
    # has no leakage at any distance
    off_bin: float

    @property
    def variance(self) -> Reals:
        """The mean square error E|error|^2 of each complex amplitude [m^2]."""
        variances = np.diagonal(self.covariance, axis1=-2, axis2=-1)
        return variances.reshape(*self.amplitudes.shape, 2).sum(axis=-1)

    @property
    def is_drifting(self) -> NDArray[np.bool_]:
        """Whether Y_1 changes between the record's halves by more than noise; shape (...)."""
        return (self.drift > DRIFT_LIMIT) & (self.drift > NOISE_FLOOR * self.drift_std)


def harmonics(
    y: ArrayLike,
    fs: float,
    omega: float,
    num_harmonics: int,
    *,
    response: Motion = "displacement",
    start: float = 0.0,
    delay: float = 0.0,
    also: Sequence[float] = (),
    refine: bool = False,
) -> Harmonics:
    r"""Return the complex amplitudes of orders 1..n by a least-squares sine fit.

    $$y(t) \approx c_0 + c_1 t + \mathrm{Re}\sum_n Y_n e^{jn\omega t}, \qquad
      Y_n = \frac{V_n}{jn\omega} = \frac{A_n}{-(n\omega)^2}$$

    The tone need not fall on a line of the Fourier transform. The fit assumes a steady state: a
    remaining transient appears as `drift`, with a warning above 1 %.

    Args:
        y: Response, shape (time,) or (repeat, time).
        fs: Sampling frequency [Hz].
        omega: Angular frequency of the tone [rad/s].
        num_harmonics: Highest order to fit.
        response: Kind of `y`: displacement, velocity or acceleration.
        start: Time to discard at the start [s]; phases still refer to the record's first sample.
        delay: Lag of the channel to remove [s].
        also: Angular frequencies of additional tones, which are fitted but not returned [rad/s].
        refine: Whether to correct `omega` from the mean phase drift of the record itself.

    Raises:
        DataError: A sample is NaN, the record is shorter than two periods or than the number of
            unknowns, or a harmonic is above the Nyquist frequency.
        ConfigError: An argument is out of its range.

    Examples:
        The fit reads a tone of 1 mm and its third harmonic of 20 um, which lie on no Fourier line:

        >>> import jbw
        >>> import numpy as np
        >>> t = np.arange(4096) / 1024.0
        >>> y = 1e-3 * np.cos(100.0 * t) + 2e-5 * np.cos(300.0 * t)
        >>> found = jbw.harmonics(y, fs=1024.0, omega=100.0, num_harmonics=3)
        >>> print((1e6 * abs(found.amplitudes)).round(2), "um")
        [1000.    0.   20.] um
    """
    y, fs, order = channel(y, "y"), sampling(fs), derivative_order(response)
    tones = Tones(omega, num_harmonics, tuple(also))
    check_tones(tones, fs, y.shape[-1], start)
    skip = round(start * fs)
    t, y = np.arange(skip, y.shape[-1]) / fs, y[..., skip:]
    if refine:
        tones = _refined(y, t, tones)
        omega = tones.omega
    n = np.arange(1.0, num_harmonics + 1)
    fitted = sine_fit(y, t, tones)
    to_displacement = np.exp(1j * n * omega * delay) / (1j * n * omega) ** order
    # Multiplication of an amplitude by a complex factor rotates and scales its two components.
    pairs = [[[f.real, -f.imag], [f.imag, f.real]] for f in to_displacement]
    turn = np.asarray(block_diag(*pairs))
    drift, drift_std = _drift(y, t, tones)
    cycles = omega * len(t) / (2 * np.pi * fs)
    result = Harmonics(
        omega=float(omega),
        amplitudes=fitted.amplitudes * to_displacement,
        covariance=turn @ _covariance(fitted, fs, n * omega) @ turn.T,
        drift=drift,
        drift_std=drift_std,
        residual_std=np.sqrt(np.sum(fitted.residual**2, axis=-1) / fitted.dof),
        cycles=float(cycles),
        off_bin=float(cycles - round(cycles)),
    )
    if np.any(result.is_drifting):
        warnings.warn(
            f"The first harmonic at {omega / (2 * np.pi):.4g} Hz changes by "
            f"{np.max(result.drift):.1%} from one half of the record to the other: a transient is "
            "left, or the frequency is not exact. Discard more of the record with `start`.",
            stacklevel=2,
        )
    return result


class Tones(NamedTuple):
    """The tones to fit to samples: harmonics 1..n of omega, and additional tones [rad/s]."""

    omega: float
    num_harmonics: int
    also: tuple[float, ...] = ()


class SineFit(NamedTuple):
    """The least-squares fit of a constant, a trend and tones to samples of shape (..., time)."""

    amplitudes: Complexes  # peak amplitudes of the harmonics, shape (..., harmonic)
    residual: Reals  # residual of the fit, shape (..., time)
    inverse: Reals  # (X^T X)^-1 for (Re Y_1, Im Y_1, Re Y_2, ...)
    tones: Reals  # angular frequencies of all fitted tones [rad/s]
    dof: int  # number of samples minus number of unknowns


def sine_fit(y: Reals, t: Reals, tones: Tones) -> SineFit:
    """Fit a constant, a trend and tones to samples of shape (..., time) by least squares."""
    return _fitted(y, _design(t, tones), tones)


def _design(t: Reals, tones: Tones) -> Reals:
    """Return the fit's rows: cos and -sin of each tone (amplitude c + js), constant, trend."""
    turn = np.tile(np.exp(-1j * tones.omega * t), (tones.num_harmonics, 1))
    turning = np.multiply.accumulate(turn)
    others = np.exp(-1j * np.outer(np.asarray(tones.also, float), t))
    pairs = [row for turn in (*turning, *others) for row in (turn.real, turn.imag)]
    return np.vstack([*pairs, np.ones_like(t), (t - t.mean()) / np.ptp(t)])


def _fitted(y: Reals, design: Reals, tones: Tones) -> SineFit:
    num_samples = design.shape[1]
    normal = design @ design.T
    if np.linalg.cond(normal) > 1e8:
        raise DataError(
            "The tones cannot be distinguished in a record of this length.",
            why="Two of the fitted frequencies nearly coincide.",
            remedy="Lengthen the record, or remove one of the frequencies in `also`.",
        )
    factor = cho_factor(normal)
    solution = cho_solve(factor, design @ y.reshape(-1, num_samples).T).T
    residual = y - solution.reshape(*y.shape[:-1], -1) @ design
    # A second fit, of the residual, recovers the digits that the normal equations lose to
    # round-off.
    change = cho_solve(factor, design @ residual.reshape(-1, num_samples).T).T
    solution = (solution + change).reshape(*y.shape[:-1], -1)
    residual = y - solution @ design
    of_harmonics = slice(0, 2 * tones.num_harmonics)
    amplitudes = (
        solution[..., of_harmonics][..., 0::2] + 1j * solution[..., of_harmonics][..., 1::2]
    )
    inverse = cho_solve(factor, np.eye(len(design)))[of_harmonics, of_harmonics]
    orders = np.arange(1, tones.num_harmonics + 1)
    omegas = np.concatenate([tones.omega * orders, np.asarray(tones.also, float)])
    return SineFit(amplitudes, residual, inverse, omegas, num_samples - len(design))


def _covariance(fit: SineFit, fs: float, omega: Reals) -> Reals:
    """Return the covariance of (Re Y_1, Im Y_1, ...) under noise that may be coloured."""
    # The covariance is (X^T X)^-1, scaled by the residual's level near each harmonic as if the
    # noise were white.
    num_samples = fit.residual.shape[-1]
    # The Hann window keeps strong remaining tones at other frequencies, such as hum, out of these
    # bins.
    w = np.sin(np.pi * (np.arange(num_samples) + 0.5) / num_samples) ** 2
    power = np.abs(np.fft.rfft(fit.residual * w)) ** 2 / np.sum(w**2)
    bins = np.arange(power.shape[-1])
    to_bins = num_samples / (2 * np.pi * fs)
    # Within two bins of a fitted tone or of zero frequency, the fit has also removed noise.
    free = np.all(np.abs(bins[:, None] - fit.tones * to_bins) > 2, axis=-1) & (bins > 2)
    free = np.flatnonzero(free[:-1])
    if free.size < 4:
        white = np.sum(fit.residual**2, axis=-1) / fit.dof
        variance = np.broadcast_to(white[..., None], (*white.shape, len(omega)))
    else:
        nearest = [free[np.argsort(np.abs(free - o * to_bins))[:NEAREST_BINS]] for o in omega]
        variance = np.stack([power[..., local].mean(axis=-1) for local in nearest], axis=-1)
    level = np.repeat(np.sqrt(variance), 2, axis=-1)
    return level[..., :, None] * fit.inverse * level[..., None, :]


def _halves(y: Reals, t: Reals, tones: Tones) -> list[SineFit]:
    """Return separate fits to the first and the second half of the samples."""
    design, half = _design(t, tones), len(t) // 2
    parts = slice(half), slice(half, None)
    return [_fitted(y[..., part], design[:, part], tones) for part in parts]


def _drift(y: Reals, t: Reals, tones: Tones) -> tuple[Reals, Reals]:
    """Return the first harmonic's relative change between halves, and its sd from noise alone."""
    parts = _halves(y, t, tones)
    first, second = (part.amplitudes[..., 0] for part in parts)
    size = np.maximum(np.abs(first), np.finfo(float).tiny)
    fs, at = 1 / (t[1] - t[0]), np.full(tones.num_harmonics, tones.omega)
    noise = sum(_covariance(part, fs, at)[..., :2, :2].trace(axis1=-2, axis2=-1) for part in parts)
    return np.abs(second - first) / size, np.sqrt(noise) / size


def _refined(y: Reals, t: Reals, tones: Tones) -> Tones:
    """Correct omega of the tones, so that Y_1 has the same phase in both halves of the record."""
    half = len(t) // 2
    for _ in range(4):
        first, second = (part.amplitudes[..., 0] for part in _halves(y, t, tones))
        turn = np.angle(np.sum(second * first.conj()))
        omega = tones.omega + turn / (t[half:].mean() - t[:half].mean())
        tones = tones._replace(omega=float(omega))
    return tones


def check_tones(tones: Tones, fs: float, num_samples: int, start: float = 0.0) -> None:
    """Raise an error if a record is too short or its rate too low for a fit of the tones."""
    omega, num_harmonics, also = tones
    if not (np.isfinite(omega) and omega > 0):
        raise ConfigError(f"Argument `omega` must be positive [rad/s], but it is {omega}.")
    if num_harmonics < 1:
        raise ConfigError(
            f"Argument `num_harmonics` must be at least 1, but it is {num_harmonics}."
        )
    highest = num_harmonics * omega / (2 * np.pi)
    if highest >= (1 - 1e-6) * fs / 2:  # At the Nyquist frequency the sine cannot be observed.
        raise DataError(
            f"Harmonic {num_harmonics} of {omega / (2 * np.pi):.4g} Hz lies at {highest:.4g} Hz, "
            f"but a record sampled at {fs:g} Hz contains frequencies only up to {fs / 2:g} Hz.",
            why="Above half the sampling frequency a harmonic folds back onto another frequency.",
            remedy=f"Sample above {2 * highest:.4g} Hz, or ask for fewer harmonics.",
        )
    # To measure the drift, each half must contain a period and more samples than unknowns.
    unknowns = 2 * (num_harmonics + len(also)) + 2
    needed = max(4 * np.pi / omega, 2 * (unknowns + 1) / fs)
    if (num_samples - round(start * fs)) / fs < needed * (1 - 1e-9):
        raise DataError(
            f"The record must last {start + needed:.4g} s (two periods after the {start:g} s "
            f"discarded), but it lasts {num_samples / fs:.4g} s.",
            remedy="Measure longer, or discard less.",
        )
