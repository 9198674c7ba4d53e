r"""Powers of the amplitude that frequency and damping are read in, and errors of what is read.

One mode of amplitude a moves slowly by (averaging of Krylov and Bogoliubov, first order)

$$\frac{\dot a}{a} = -\sigma(a), \qquad \dot\varphi = \omega(a), \qquad
  \sigma = \sum_{k} \sigma_k r^{kp}, \quad \omega = \sum_{k} \omega_k r^{kp}, \quad
  r = \frac{a}{a_0}$$

whose power p is a parameter like the others: 1 of a Bouc-Wen law and of quadratic damping, 2 of a
cubic spring, 1 + chi of an Iwan law.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from scipy.signal import fftconvolve

from jbw.measurement.channels import Complexes, Reals

# Least change of squares and steps: of a mode, and of one beside a cause, where the likelihood of n
# values is then off by n / 10^4, against the 25 of a cause that is named.
FULLY, NEAR_BEST = 1e-8, 1e-4
SHIFT = 1e-7  # of a cause's parameter, for its slope
LEAST_RATIO = 1e-9  # of an amplitude over the largest: none is zero
SMOOTHED = 12  # lines of a residual's spectrum that are averaged
FEWEST_INDEPENDENT = 0.02  # of a residual's values, however coloured it is


class AmplitudeBasis(NamedTuple):
    """Powers of the amplitude: how many, and whether their common exponent is a parameter."""

    terms: int
    is_free: bool = False

    def exponent(self, theta: Reals) -> float:
        """Return the exponent p among parameters, of which it is the last."""
        return float(theta[-1]) if self.is_free else 1.0

    def values(self, r: Reals, exponent: float) -> Float[np.ndarray, "term amplitude"]:
        """Return the powers r^(k p) of relative amplitudes."""
        return np.maximum(r, LEAST_RATIO) ** (exponent * np.arange(self.terms)[:, None])


BASES = {
    "linear": AmplitudeBasis(1),
    "quadratic": AmplitudeBasis(3),  # for the test of whether anything changes with amplitude
    "power": AmplitudeBasis(2, is_free=True),
    "power2": AmplitudeBasis(3, is_free=True),
    "power3": AmplitudeBasis(4, is_free=True),
}
NESTED = ("linear", "power", "power2", "power3")  # each holds the one before it


class ModeFit(NamedTuple):
    """Parameters of a basis fitted to a signal: exponents and coefficients, what is left, squares.

    Attributes:
        theta: Parameters; those of a cause that was fitted together with the mode come last.
        residual: Signal less model.
        jacobian: Derivatives of the model by the parameters.
        squares: Weighted sum of squares of the residual.
        gains: Linear coefficients that were projected out; empty where there are none.
    """

    theta: Reals
    residual: Complexes
    jacobian: Complex[np.ndarray, "value parameter"]
    squares: float
    gains: Complexes = np.zeros(0, complex)


def independent_share(residual: Complexes) -> float:
    r"""Return the share of a coloured residual's values that count as independent.

    $$\frac{(\sum_k S_k)^2}{n \sum_k S_k^2}$$ of its smoothed power spectrum S.
    """
    if len(residual) < 8:
        return 1.0
    power = np.abs(np.fft.fft(residual)) ** 2
    width = SMOOTHED | 1
    smooth = np.convolve(np.pad(power, width // 2, "wrap"), np.ones(width) / width, "valid")
    share = smooth.sum() ** 2 / (len(smooth) * max(float(np.sum(smooth**2)), 1e-300))
    return float(np.clip(share, FEWEST_INDEPENDENT, 1.0))


def filtered_share(taps: Reals, step: int) -> float:
    r"""Return the share of values of filtered white noise that count as independent.

    $$\frac{r_0^2}{\sum_k r_k^2}, \qquad r_k = \sum_i h_i\,h_{i + k m}$$ of a filter h, for one
    value in m samples and k of both signs.
    """
    correlation = fftconvolve(taps, taps[::-1])[len(taps) - 1 :: step] / np.sum(taps**2)
    return float(1 / (2 * np.sum(correlation**2) - 1))


def covariance(fitted: ModeFit, weight: Reals) -> Float[np.ndarray, "parameter parameter"]:
    r"""Return the sandwich covariance of parameters under coloured noise.

    $$A^{-1} B A^{-1}, \quad A = \mathrm{Re}\,J^H J, \quad
      B = \tfrac12 \mathrm{Re} \sum_k S_k\,\hat J_k^H \hat J_k$$

    with J weighted, its Fourier transform, and the residual's smoothed spectrum S.
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
    """Return a unit step as a filter of sum 1 passes it, at times since the step in samples."""
    passed = np.concatenate([[0.0], np.cumsum(taps)])
    place = since + len(taps) // 2
    return np.interp(place, np.arange(len(passed)), passed, left=0.0, right=1.0)


def converter_step(x: Reals) -> float:
    """Return the step of an analogue-to-digital converter, 0 where samples show none."""
    levels = np.unique(x[np.isfinite(x)])
    if len(levels) < 8 or (len(levels) > 0.5 * len(x) and len(x) > 500):
        return 0.0
    steps = np.diff(levels)
    least = float(steps[steps > 1e-12 * np.ptp(levels)].min())
    whole: Any = steps / least
    return least if np.mean(np.abs(whole - np.round(whole)) < 0.05) > 0.9 else 0.0


def slopes_of_cause(model: Callable[[Reals], Any], values: Reals) -> list[Any]:
    """Return forward differences of a model by each parameter of a cause."""
    here, found = model(values), []
    for i, value in enumerate(values):
        further = values.copy()
        further[i] += SHIFT * max(abs(value), 1.0)
        found.append((model(further) - here) / (further[i] - value))
    return found


def strongest_line(values: Complexes, step_s: float) -> tuple[float, complex]:
    """Return frequency [rad/s] and complex amplitude of the strongest line among values."""
    padded = 4 * len(values)
    spectrum = np.fft.fft(values, padded)
    at = int(np.argmax(np.abs(spectrum)))
    return float(2 * np.pi * np.fft.fftfreq(padded, step_s)[at]), complex(spectrum[at])
