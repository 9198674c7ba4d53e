r"""Nonlinear distortion told from noise, by multisines: the best linear approximation, and parity.

A period of a multisine repeats exactly but for the noise, and another realisation of its phases
changes what a nonlinearity makes of it. So the scatter over periods is noise, and that over
realisations beyond it is distortion (the robust method). Where lines are left without excitation,
even and odd nonlinearities show there by themselves.

Reference:
    Schoukens, Vaes and Pintelon (2016), IEEE Control Systems Magazine 36(3), 38; Pintelon and
    Schoukens, System Identification, 2nd ed. (2012), sections 4.3 and 4.4.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike, NDArray

from jbw.errors import DataError
from jbw.measurement.channels import Complexes, Reals, channel, sampling

EXCITED = 0.05  # of the strongest line of the source, from where on a line is excited


class BestLinear(NamedTuple):
    """Best linear approximation at the excited lines, a realisation or more of them averaged.

    Standard deviations are of the complex number, sqrt(E|error|^2). Noise is NaN with one period,
    and what needs realisations with one of these.
    """

    freq: Reals  # [Hz]
    h: Complexes  # response over source
    noise_std: Reals  # of `h`, by the noise alone
    total_std: Reals  # of `h`, by noise and by distortion
    distortion_std: Reals  # of one realisation, by distortion alone; zero where below the noise
    num_realisations: int
    num_periods: int


class Distortion(NamedTuple):
    """Response at the lines that a period does not excite, between the excited ones.

    All are root mean squares over lines of complex amplitudes, over that of the excited lines;
    NaN where there are no such lines, and the noise with one period.
    """

    odd: float
    even: float
    noise: float  # of the mean of the periods
    num_odd: int
    num_even: int


def best_linear_approximation(u: ArrayLike, y: ArrayLike, fs: float) -> BestLinear:
    r"""Best linear approximation, its noise, and the distortion of one realisation.

    $$\hat G = \frac1M \sum_m \hat G_m, \quad \hat G_m = \frac{\bar Y_m}{\bar U_m}, \quad
      \sigma_{tot}^2 = \frac{1}{M (M - 1)} \sum_m |\hat G_m - \hat G|^2, \quad
      \sigma_S^2 = M (\sigma_{tot}^2 - \sigma_n^2)$$

    with bars for means over the P periods and sigma_n by the scatter of the periods about them.

    Args:
        u: Source of steady periods, shape (realisation, period, time) or (period, time).
        y: Response, of the same shape.
        fs: Sampling frequency [Hz].

    Raises:
        DataError: NaN, unequal shapes, or a source without any power.
    """
    (u, y), fs = _steady(u, y), sampling(fs)
    count, num_periods = u.shape[:2]
    spectra_u, spectra_y = np.fft.rfft(u), np.fft.rfft(y)
    lines = excited_lines(u)
    mean_u, mean_y = (x.mean(axis=1)[:, lines] for x in (spectra_u, spectra_y))
    ratios = mean_y / mean_u
    # Noise of source and response together, as the ratio of a period has it to first order.
    residual = spectra_y[..., lines] - ratios[:, None] * spectra_u[..., lines]
    noise = np.full(ratios.shape, np.nan)
    if num_periods > 1:
        square = np.sum(np.abs(residual) ** 2, axis=1) / (num_periods - 1)
        noise = square / num_periods / np.abs(mean_u) ** 2
    h, noise = ratios.mean(axis=0), noise.mean(axis=0) / count
    total, distortion = np.full(h.shape, np.nan), np.full(h.shape, np.nan)
    if count > 1:
        total = np.sum(np.abs(ratios - h) ** 2, axis=0) / (count * (count - 1))
        distortion = np.maximum(count * (total - noise), 0.0)
    freq = lines * fs / u.shape[-1]
    roots = np.sqrt(noise), np.sqrt(total), np.sqrt(distortion)
    return BestLinear(freq, h, *roots, count, num_periods)


def detection_lines(u: ArrayLike, y: ArrayLike) -> Distortion:
    """Response at unexcited odd and even lines, the source's own share there taken out.

    The source's share is its spectrum there times the response over it at the nearest excited
    line. `u` and `y` are steady periods of one realisation, (period, time).
    """
    whole_u, whole_y = (x[0] for x in _steady(u, y))
    lines = excited_lines(whole_u[None])
    spectra_u, spectra_y = np.fft.rfft(whole_u), np.fft.rfft(whole_y)
    mean_u, mean_y = spectra_u.mean(axis=0), spectra_y.mean(axis=0)
    band = np.arange(lines[0], lines[-1] + 1)
    idle = np.setdiff1d(band, lines)
    nearest = lines[np.argmin(np.abs(idle[:, None] - lines[None]), axis=1)] if idle.size else idle
    ratio = mean_y[nearest] / mean_u[nearest]
    response = mean_y[idle] - ratio * mean_u[idle]
    size = _rms(mean_y[lines])
    noise = np.nan
    if len(whole_u) > 1:
        spread = spectra_y - mean_y
        variance = np.sum(np.abs(spread) ** 2, axis=0) / (len(whole_u) * (len(whole_u) - 1))
        noise = float(np.sqrt(variance[band].mean()))
    odd, even = response[idle % 2 == 1], response[idle % 2 == 0]
    return Distortion(_rms(odd) / size, _rms(even) / size, noise / size, odd.size, even.size)


def excited_lines(u: Float[np.ndarray, "*batch time"]) -> Int[np.ndarray, " line"]:
    """Lines of the spectrum that the source excites, zero and the last one excluded."""
    power = np.mean(np.abs(np.fft.rfft(u)) ** 2, axis=tuple(range(u.ndim - 1)))
    power[0] = power[-1] = 0.0
    if not power.max() > 0:
        raise DataError("Channel `u` is constant.", why="A dead source excites nothing.")
    return np.flatnonzero(np.sqrt(power) > EXCITED * np.sqrt(power.max()))


def _rms(values: NDArray[np.complex128]) -> float:
    return float(np.sqrt(np.mean(np.abs(values) ** 2))) if values.size else float("nan")


def _steady(u: ArrayLike, y: ArrayLike) -> tuple[Reals, Reals]:
    """Source and response by realisation, period and time, checked."""
    source, response = np.asarray(u, float), np.asarray(y, float)
    if source.shape != response.shape or not 2 <= source.ndim <= 3:
        raise DataError(
            "Channels `u` and `y` must both be (period, time) or (realisation, period, time), but "
            f"have shapes {source.shape} and {response.shape}.",
            remedy="Cut the records to whole periods, one a row.",
        )
    shape = (-1, *source.shape[-2:])
    for name, values in (("u", source), ("y", response)):
        channel(values.reshape(-1, source.shape[-1]), name)
    return source.reshape(shape), response.reshape(shape)
