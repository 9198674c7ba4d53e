r"""Weighted least-squares fits of modes to FRFs, used by Step 2.

$$H_o(\omega) = \sum_i \frac{R_{oi}}{\omega_i^2 - \omega^2 + 2j\zeta_i\omega_i\omega}
  + U_o + \frac{L_o}{\omega^2}$$

for outputs o of one input, with real residues R. The parameters are those of each mode, (omega_n,
zeta, residue in each output), then (U, L) of each output, with L over the square of the band's mean
frequency.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize

from jbw.errors import DataError
from jbw.identification.line_method import floored
from jbw.identification.windowed import (
    Complex,
    LineErrors,
    Modes,
    Real,
    line_errors,
    receptance,
    smeared,
)
from jbw.measurement.spectra import FRF
from jbw.quantities import derivative_order

LEAST_ZETA = 1e-6  # smallest damping ratio; without damping there is no steady response
ONE_RECORD = 1.5  # If there are fewer averages than this, the noise of the lines is unknown.
NOISE_ROUNDS = 4


@dataclass(frozen=True)
class FRFLines:
    """The lines of several FRFs in one band, with the settings of the model."""

    outputs: tuple[FRF, ...]  # FRFs in the band
    num_modes: int
    num_residuals: int  # number of residual terms of (U, L), for every output
    smear: bool  # whether the model includes the smearing of a resonance by the window

    @property
    def width(self) -> int:
        """The number of parameters of one mode."""
        return 2 + len(self.outputs)

    @property
    def num_parameters(self) -> int:
        """The number of parameters of all modes and residual terms."""
        return self.num_modes * self.width + self.num_residuals * len(self.outputs)

    @property
    def data(self) -> Complex:
        """The measured spectral lines in the unit of the response, one output after another."""
        return np.concatenate([part.h * to_measured(part) for part in self.outputs])

    @property
    def noise_known(self) -> bool:
        """Whether there are enough averages to determine the noise of the lines."""
        return self.outputs[0].num_averages > ONE_RECORD


@dataclass(frozen=True)
class FittedLines:
    """The optimum of a weighted least-squares fit to spectral lines of FRFs."""

    theta: Real
    jacobian: Complex  # derivative of the model with respect to theta
    variance: Real  # variance of the lines, which gives the weights
    covariance: Real  # covariance of theta
    chi_square: float
    residual: Complex  # model minus data, one output after another


def to_measured(part: FRF) -> Complex:
    """Return the factor from receptance to the measured response, in which the noise is white."""
    return np.power(1j * part.omega, derivative_order(part.response), dtype=complex)


def observed_variance(lines: FRFLines) -> Real:
    """Return the variance of the lines from their averages, in the measured unit."""
    variances = [
        floored(part.variance * np.abs(to_measured(part)) ** 2, part.h * to_measured(part))
        for part in lines.outputs
    ]
    return np.concatenate(variances)


def fit_lines(lines: FRFLines, start: Real, typical: Real) -> FittedLines:
    """Fit spectral lines by least squares, with the correlated errors that windows cause."""
    data, observed = lines.data, observed_variance(lines)
    variance, of_sum = observed, None
    fitted = _least_squares(lines, data, variance, start, typical)
    windowed = lines.outputs[0].window == "hann"
    # The errors depend weakly on the parameters: two rounds are enough for the weights.
    for _ in range(2 if windowed else 0):
        errors = _errors(lines, observed, fitted.theta)
        variance = _floored(errors.variance, data, len(lines.outputs))
        of_sum = errors.of_sum
        fitted = _least_squares(lines, data, variance, fitted.theta, typical)
    for _ in range(0 if lines.noise_known else NOISE_ROUNDS):
        variance = variance * _left_over(lines, fitted.residual, variance)
        fitted = _least_squares(lines, data, variance, fitted.theta, typical)
    return replace(fitted, covariance=_covariance_of(fitted.jacobian, variance, of_sum))


def _errors(lines: FRFLines, observed: Real, theta: Real) -> LineErrors:
    ratio = observed * lines.outputs[0].num_averages
    return line_errors(lines.outputs, ratio, modes_by_output(lines, theta), leakage=lines.smear)


def _floored(variance: Real, data: Complex, num_outputs: int) -> Real:
    pairs = zip(np.split(variance, num_outputs), np.split(data, num_outputs), strict=True)
    return np.concatenate([floored(v, h) for v, h in pairs])


def _left_over(lines: FRFLines, residual: Complex, variance: Real) -> Real:
    """Return each output's mean squared residual / variance, by which unknown noise is scaled."""
    num = len(lines.outputs)
    # fraction of the values that remain as degrees of freedom
    free = 1 - lines.num_parameters / (2 * len(residual))
    share = np.abs(np.split(residual, num)) ** 2 / np.split(variance, num)
    return np.repeat(share.mean(axis=-1) / free, residual.size // num)


def modes_by_output(lines: FRFLines, theta: Real) -> list[Modes]:
    """Return (omega_n, zeta, residue) of each mode at each output."""
    blocks = theta[: lines.num_modes * lines.width].reshape(lines.num_modes, lines.width)
    return [[(b[0], b[1], b[2 + o]) for b in blocks] for o in range(len(lines.outputs))]


def terms(part: FRF, count: int) -> Complex:
    """Return the responses to unit residual terms U and L, as columns, in the measured quantity."""
    inverse_square = (part.omega.mean() / part.omega) ** 2
    return np.array([to_measured(part), to_measured(part) * inverse_square])[:count]


def mode_lines(part: FRF, mode: tuple[float, float, float], smear: bool) -> Complex:
    """Return the spectral lines of the measured response to which one mode contributes."""
    if smear:
        return smeared(part.omega, *mode, part.window_s, derivative_order(part.response))
    return receptance(part.omega, *mode) * to_measured(part)


def model_of(lines: FRFLines) -> Callable[[Real], Complex]:
    """Return a function that computes the spectral lines of all outputs from the parameters."""
    extra = [terms(part, lines.num_residuals) for part in lines.outputs]
    modal = lines.num_modes * lines.width

    def model(theta: Real) -> Complex:
        added = theta[modal:].reshape(len(extra), lines.num_residuals)
        outputs = zip(lines.outputs, modes_by_output(lines, theta), added, extra, strict=True)
        return np.concatenate(
            [
                sum(mode_lines(part, mode, lines.smear) for mode in modes) + coefficients @ columns
                for part, modes, coefficients, columns in outputs
            ]
        )

    return model


def _least_squares(
    lines: FRFLines, data: Complex, variance: Real, start: Real, typical: Real
) -> FittedLines:
    """Fit the parameters by weighted least squares; the covariance is left to the caller."""
    # real and imaginary parts have half of the variance each
    model, weight = model_of(lines), np.sqrt(2 / variance)

    def misfit(x: Real) -> Real:
        r = weight * (model(x * typical) - data)
        return np.concatenate([r.real, r.imag])

    omegas = np.arange(lines.num_modes) * lines.width
    low = np.full(len(start), -np.inf)
    low[omegas + 1] = LEAST_ZETA
    high = np.full(len(start), np.inf)
    high[omegas + 1] = 0.999 / typical[omegas + 1]
    x0 = np.clip(start / typical, low + 1e-9, high)
    # Changes of omega_n matter on the scale of the half-width, so its step is scaled by zeta.
    size = np.ones(len(start))
    size[omegas] = typical[omegas + 1]
    optimum = optimize.least_squares(
        misfit, x0, jac="3-point", x_scale=size, bounds=(low, high), xtol=1e-14, ftol=1e-14,
        gtol=1e-14,
    )  # fmt: skip
    if not (np.all(np.isfinite(optimum.x)) and np.all(optimum.x[omegas + 1] > 2 * LEAST_ZETA)):
        raise DataError(
            "The fit of the oscillator to the FRF found no positive damping.",
            remedy="Check `delay`, `band` and which channel is the input.",
        )
    half = len(data)
    jacobian = (optimum.jac[:half] + 1j * optimum.jac[half:]) / weight[:, None] / typical
    residual = (optimum.fun[:half] + 1j * optimum.fun[half:]) / weight
    none = np.full((len(start), len(start)), np.nan)
    return FittedLines(
        optimum.x * typical, jacobian, variance, none, float(2 * optimum.cost), residual
    )


def _covariance_of(
    jacobian: Complex, variance: Real, of_sum: Callable[[Complex], Real] | None
) -> Real:
    """Return the covariance of weighted least squares; `of_sum` is given for correlated lines."""
    scale = np.linalg.norm(jacobian, axis=0)
    weighted = (jacobian / scale).conj().T * (2 / variance)
    inverse = np.linalg.inv((weighted @ (jacobian / scale)).real) / np.outer(scale, scale)
    return inverse if of_sum is None else of_sum(inverse @ (weighted * scale[:, None]))
