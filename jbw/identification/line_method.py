"""The line-fit method: a linear oscillator fitted to the inverse of an FRF."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from jbw.errors import DataError
from jbw.measurement.channels import ROUNDING, passband
from jbw.measurement.spectra import FRF
from jbw.quantities import derivative_order

PER_LINE = ("freq", "h", "coherence", "variance", "input_spectrum", "output_spectrum")
NEAR_PEAK = 0.2  # half width of the default band, relative to the peak frequency


@dataclass(frozen=True)
class LineFit:
    """A linear oscillator fitted to an FRF."""

    omega_n: float  # natural frequency [rad/s]
    zeta: float  # damping ratio [-]
    gain: float  # force per unit mass and unit of input [N/kg per unit]
    covariance: NDArray[np.float64]  # covariance of (omega_n, zeta, gain), with residual terms free
    upper: float  # constant receptance of higher modes; 0 if not fitted [m per unit]
    lower: float  # coefficient of 1 / omega^2 of lower modes; 0 if not fitted
    # Sum of squared residuals (real and imaginary), divided by their variance. Neighbouring lines
    # are correlated, so this sum varies more than a chi-square with `dof` degrees of freedom.
    chi_square: float
    dof: int  # number of real data minus parameters
    num_lines: int  # number of fitted lines
    band_hz: tuple[float, float]  # lowest and highest fitted line [Hz]
    smeared: bool  # whether the model includes the smearing of the resonance by the window

    @property
    def theta(self) -> NDArray[np.float64]:
        """The vector (omega_n, zeta, gain)."""
        return np.array([self.omega_n, self.zeta, self.gain])

    @property
    def std(self) -> NDArray[np.float64]:
        """The standard deviations of (omega_n, zeta, gain)."""
        return np.sqrt(np.diag(self.covariance))


def line_fit_start(frf: FRF) -> NDArray[np.float64]:
    r"""Return (omega_n, zeta, gain) by linear least squares on 1/H, as the start of `line_fit`.

    $$\frac1H = \frac{\omega_n^2}{g} - \frac{\omega^2}{g} + j\omega\,\frac{2\zeta\omega_n}{g}$$

    Weights are |H|^4 over the variance, as errors of 1/H require. The FRF is used as it is, so a
    short window gives too high a damping.

    Raises:
        DataError: The FRF shows no resonance that loses energy.
    """
    h, scale = frf.h, frf.omega.mean()
    x = frf.omega / scale
    weight = np.abs(h) ** 2 / np.sqrt(floored(frf.variance, h))
    zero = np.zeros_like(x)
    design = np.block([[np.ones_like(x), zero], [-(x**2), zero], [zero, x]]).T
    target = np.concatenate([(1 / h).real, (1 / h).imag])
    weights = np.tile(weight / weight.max(), 2)
    a, b, c = np.linalg.lstsq(design * weights[:, None], target * weights)[0]
    if not (a / b > 0 and c / b > 0 and c**2 < 4 * a * b):
        peak = frf.freq[np.argmax(np.abs(h))]
        raise DataError(
            f"The FRF must show a resonance that loses energy near {peak:.4g} Hz, but no such "
            "resonance fits the inverse of the FRF.",
            why="Swapped channels, a delay of the response channel or a band without the peak can "
            "cause this misfit.",
            remedy="Check `delay`, `band`, and which channel is the input.",
        )
    root = np.sqrt(a / b)
    return np.array([root * scale, c / b / (2 * root), scale**2 / b])


def floored(variance: NDArray[np.float64], h: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Return variances that are not too small, so that noise-free lines do not dominate."""
    typical = np.mean(variance[np.isfinite(variance)]) if np.isfinite(variance).any() else 0.0
    return np.maximum(variance, max(1e-6 * typical, (1e-12 * np.abs(h).max()) ** 2))


def in_band(frf: FRF, band: tuple[float, float] | None) -> FRF:
    """Return an FRF's lines in a band [Hz]; the default is 20 % on each side of the peak."""
    if band is None:
        # Use the measured response, whose noise does not rise towards low frequencies.
        size = np.abs(frf.h) * frf.omega ** derivative_order(frf.response) * frf.coherence
        peak = float(frf.freq[np.argmax(size)])
        band = ((1 - NEAR_PEAK) * peak, (1 + NEAR_PEAK) * peak)
        low, high = band
    else:
        low, high = passband(band, frf.fs / 2)
    first, last = np.searchsorted(frf.freq, [low * (1 - ROUNDING), high * (1 + ROUNDING)])
    if last - first < 4:
        raise DataError(
            f"The band {low:.4g} to {high:.4g} Hz must contain at least 4 lines, but contains only "
            f"{last - first} (line spacing {1 / frf.window_s:.3g} Hz).",
            remedy="Widen `band`, or lengthen the windows of the estimate.",
        )
    return replace(frf, **{name: getattr(frf, name)[first:last] for name in PER_LINE})
