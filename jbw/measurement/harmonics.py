"""Harmonic filtering: complex amplitudes of a steady tone and its multiples, with covariance."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jbw.measurement.channels import channel, sampling
from jbw.measurement.sine_fit import (
    Tones,
    amplitude_covariance,
    check_length,
    check_tones,
    half_drift,
    refined,
    sine_fit,
)
from jbw.quantities import derivative_order

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
    tones = Tones(omega, num_harmonics, tuple(also))
    check_tones(tones, fs)
    check_length(tones, fs, y.shape[-1], start)
    skip = round(start * fs)
    t, y = np.arange(skip, y.shape[-1]) / fs, y[..., skip:]
    if refine:
        tones = refined(y, t, tones)
        omega = tones.omega
    n = np.arange(1.0, num_harmonics + 1)
    fitted = sine_fit(y, t, tones)
    to_displacement = np.exp(1j * n * omega * delay) / (1j * n * omega) ** order
    drift, drift_std = half_drift(y, t, tones)
    cycles = omega * len(t) / (2 * np.pi * fs)
    result = Harmonics(
        omega=float(omega),
        amplitudes=fitted.amplitudes * to_displacement,
        covariance=_rotated(amplitude_covariance(fitted, fs, n * omega), to_displacement),
        drift=drift,
        drift_std=drift_std,
        residual_std=np.sqrt(np.sum(fitted.residual**2, axis=-1) / fitted.dof),
        cycles=float(cycles),
        off_bin=float(cycles - round(cycles)),
    )
    _warn_when_drifting(result)
    return result


def _rotated(
    covariance: NDArray[np.float64], factor: NDArray[np.complex128]
) -> NDArray[np.float64]:
    """Covariance after each complex amplitude was multiplied by its factor."""
    turn = np.zeros(covariance.shape[-2:])
    for i, f in enumerate(factor):
        turn[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[f.real, -f.imag], [f.imag, f.real]]
    return turn @ covariance @ turn.T


def _warn_when_drifting(result: Harmonics) -> None:
    drifting = (result.drift > DRIFT_LIMIT) & (result.drift > 3 * result.drift_std)
    if np.any(drifting):
        warnings.warn(
            f"The first harmonic at {result.omega / (2 * np.pi):.4g} Hz changes by "
            f"{np.max(result.drift):.1%} from one half of the record to the other: a transient is "
            "left, or the frequency is not exact. Discard more with `start`.",
            stacklevel=3,
        )
