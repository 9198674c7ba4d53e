r"""Powers of amplitude in frequency and damping, and the errors of fits with them.

By first-order averaging (Krylov and Bogoliubov), one mode of amplitude a moves slowly as

$$\frac{\dot a}{a} = -\sigma(a), \qquad \dot\varphi = \omega(a), \qquad
  \sigma = \sum_{k} \sigma_k r^{kp}, \quad \omega = \sum_{k} \omega_k r^{kp}, \quad
  r = \frac{a}{a_0}$$

The power p is a parameter like the others: 1 for a Bouc-Wen law and quadratic damping, 2 for a
cubic spring, 1 + chi for an Iwan law.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from scipy.signal import fftconvolve

from jbw.measurement.channels import Complexes, Reals

# A fit ends if the relative change of the sum of squares, or of the step, is below this. FULLY is
# for the fit of a mode alone, NEAR_BEST for a mode together with a cause. With NEAR_BEST the log
# likelihood of n values is wrong by n / 10^4, which matters little, because a cause is reported
# only at a likelihood ratio of 25.
FULLY, NEAR_BEST = 1e-8, 1e-4
SHIFT = 1e-7  # relative step of a cause's parameter for a finite difference
# smallest ratio of an amplitude to the largest, since an amplitude of zero has no logarithm
LEAST_RATIO = 1e-9
SMOOTHED = 12  # number of lines of a residual's spectrum that are averaged
# smallest fraction of independent values of a residual, however coloured it is
FEWEST_INDEPENDENT = 0.02


class AmplitudeBasis(NamedTuple):
    """The powers of the amplitude in a fit: their number, and whether the exponent is fitted."""

    terms: int
    is_free: bool = False

    def exponent(self, theta: Reals) -> float:
        """Return the exponent p of the amplitude: the last parameter if fitted, otherwise 1."""
        return float(theta[-1]) if self.is_free else 1.0

    def values(self, r: Reals, exponent: float) -> Float[np.ndarray, "term amplitude"]:
        """Return the powers r^(k p) of relative amplitudes r."""
        return np.maximum(r, LEAST_RATIO) ** (exponent * np.arange(self.terms)[:, None])


BASES = {
    "linear": AmplitudeBasis(1),
    # the sets of powers that test whether anything changes with amplitude
    "quadratic": AmplitudeBasis(3),
    "power": AmplitudeBasis(2, is_free=True),
    "power2": AmplitudeBasis(3, is_free=True),
    "power3": AmplitudeBasis(4, is_free=True),
}
NESTED = ("linear", "power", "power2", "power3")  # each basis contains its predecessor


class ModeFit(NamedTuple):
    """The fit of a mode with given powers of amplitude: parameters, residual, derivatives.

    Attributes:
        theta: Parameters; those of a cause fitted together with the mode come last.
        residual: Signal less model.
        jacobian: Derivatives of the model with respect to the parameters.
        squares: Weighted sum of squares of the residual.
        gains: Linear coefficients that were projected out; empty if there are none.
    """

    theta: Reals
    residual: Complexes
    jacobian: Complex[np.ndarray, "value parameter"]
    squares: float
    gains: Complexes = np.zeros(0, complex)


def independent_share(residual: Complexes) -> float:
    r"""Return the fraction of a coloured residual's values that count as independent.

    $$\frac{(\sum_k S_k)^2}{n \sum_k S_k^2}$$ with its smoothed power spectrum S.
    """
    if len(residual) < 8:
        return 1.0
    power = np.abs(np.fft.fft(residual)) ** 2
    width = SMOOTHED | 1
    smooth = np.convolve(np.pad(power, width // 2, "wrap"), np.ones(width) / width, "valid")
    share = smooth.sum() ** 2 / (len(smooth) * max(float(np.sum(smooth**2)), 1e-300))
    return float(np.clip(share, FEWEST_INDEPENDENT, 1.0))


def filtered_share(taps: Reals, step: int) -> float:
    r"""Return the fraction of values of filtered white noise that count as independent.

    $$\frac{r_0^2}{\sum_k r_k^2}, \qquad r_k = \sum_i h_i\,h_{i + k m}$$ for a filter h, one value
    per m samples, and k of both signs.
    """
    correlation = fftconvolve(taps, taps[::-1])[len(taps) - 1 :: step] / np.sum(taps**2)
    return float(1 / (2 * np.sum(correlation**2) - 1))


def covariance(fitted: ModeFit, weight: Reals) -> Float[np.ndarray, "parameter parameter"]:
    r"""Return the sandwich covariance of parameters under coloured noise.

    $$A^{-1} B A^{-1}, \quad A = \mathrm{Re}\,J^H J, \quad
      B = \tfrac12 \mathrm{Re} \sum_k S_k\,\hat J_k^H \hat J_k$$

    with J weighted, \hat J its Fourier transform, and S the residual's smoothed spectrum.
    """
    jacobian = fitted.jacobian * weight[:, None]
    size = np.linalg.norm(jacobian, axis=0) + 1e-300
    jacobian, residual = jacobian / size, fitted.residual * weight
    count, unknowns = jacobian.shape
    padded = 1 << int(np.ceil(np.log2(2 * count)))
    inner = np.real(jacobian.conj().T @ jacobian)
    spectrum = _smooth_spectrum(residual, padded) * count / max(count - unknowns / 2, 1)
    lines = np.fft.fft(jacobian, padded, axis=0)
    middle = 0.5 * np.real((lines.conj().T * np.maximum(spectrum, 1e-30)) @ lines) / padded
    scaled_back = np.linalg.pinv(inner, rcond=1e-14, hermitian=True) / size[:, None]
    return scaled_back @ middle @ scaled_back.T


def _smooth_spectrum(residual: Complexes, padded: int) -> Reals:
    """Return a residual's power per line, averaged over lines that its length cannot resolve."""
    power = np.abs(np.fft.fft(residual, padded)) ** 2 / len(residual)
    width = max(int(SMOOTHED * padded / len(residual)), 3) | 1
    kernel = np.hanning(width + 2)[1:-1]
    around = np.roll(np.pad(kernel / kernel.sum(), (0, padded - width)), -(width // 2))
    return np.real(np.fft.ifft(np.fft.fft(power) * np.fft.fft(around)))


def filtered_step(taps: Reals, since: Reals) -> Reals:
    """Return a unit step after a filter of sum 1, at times since the step in samples."""
    passed = np.concatenate([[0.0], np.cumsum(taps)])
    place = since + len(taps) // 2
    return np.interp(place, np.arange(len(passed)), passed, left=0.0, right=1.0)


def converter_step(x: Reals) -> float:
    """Return the step of an analogue-to-digital converter; 0 if the samples show none."""
    levels = np.unique(x[np.isfinite(x)])
    if len(levels) < 8 or (len(levels) > 0.5 * len(x) and len(x) > 500):
        return 0.0
    steps = np.diff(levels)
    least = float(steps[steps > 1e-12 * np.ptp(levels)].min())
    whole: Any = steps / least
    return least if np.mean(np.abs(whole - np.round(whole)) < 0.05) > 0.9 else 0.0


def slopes_of_cause(model: Callable[[Reals], Any], values: Reals) -> list[Any]:
    """Return forward differences of a model with respect to each parameter of a cause."""
    here, found = model(values), []
    for i, value in enumerate(values):
        further = values.copy()
        further[i] += SHIFT * max(abs(value), 1.0)
        found.append((model(further) - here) / (further[i] - value))
    return found


def strongest_line(values: Complexes, step_s: float) -> tuple[float, complex]:
    """Return the frequency [rad/s] and complex amplitude of the strongest line of a signal."""
    padded = 4 * len(values)
    spectrum = np.fft.fft(values, padded)
    at = int(np.argmax(np.abs(spectrum)))
    return float(2 * np.pi * np.fft.fftfreq(padded, step_s)[at]), complex(spectrum[at])
