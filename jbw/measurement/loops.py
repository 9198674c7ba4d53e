"""Hysteresis loops from records: restoring force, enclosed area, the mean cycle."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jbw.errors import ConfigError, DataError
from jbw.measurement.channels import channel, same_length, sampling
from jbw.measurement.sine_fit import Tones, check_length, check_tones, sine_fit


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
    check_tones(Tones(omega, 1 if num_harmonics is None else num_harmonics), fs)
    if num_harmonics is None:
        num_harmonics = max(1, min(25, int(0.9 * np.pi * fs / omega)))
    tones, num_samples = Tones(omega, num_harmonics), y.shape[-1]
    check_length(tones, fs, num_samples)
    t = np.arange(num_samples) / fs
    phase = 2 * np.pi * np.arange(num_points) / num_points
    turn = np.exp(1j * np.outer(np.arange(1, num_harmonics + 1), phase))
    fits = [sine_fit(x, t, tones) for x in (y, force)]
    loop = [(fit.amplitudes @ turn).real for fit in fits]
    spread = [np.sqrt(np.sum(fit.residual**2, axis=-1) / fit.dof) for fit in fits]
    return MeanCycle(phase, *loop, *spread, cycles=float(omega * num_samples / (2 * np.pi * fs)))
