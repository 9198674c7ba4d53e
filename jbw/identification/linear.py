"""Step 2: natural frequency, damping and gain from an FRF, with covariance."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from jbw.errors import ConfigError, DataError
from jbw.identification.windowed import line_errors, receptance, smeared
from jbw.measurement.channels import derivative_order, passband
from jbw.measurement.spectra import FRF

Residuals = Literal["none", "upper", "both"]

NUM_RESIDUALS = {"none": 0, "upper": 1, "both": 2}
NEAR_PEAK = 0.2  # default band, of the peak's frequency to either side
SCATTER_P = 0.01  # repeats scatter more than their errors say, below this probability


@dataclass(frozen=True)
class LineFit:
    """A linear oscillator fitted to an FRF.

    Attributes:
        omega_n: Natural frequency [rad/s].
        zeta: Damping ratio [-].
        gain: Force per unit mass and unit of input [N/kg per unit].
        covariance: Of (omega_n, zeta, gain), residual terms left free.
        upper: Constant receptance of the modes above, zero when not fitted [m per unit].
        lower: Coefficient of 1 / omega^2 of the modes below, zero when not fitted [N/kg per unit].
        chi_square: Sum of squared misfits, real and imaginary, over their variance. Neighbouring
            lines are correlated, so it scatters more than a chi-square about `dof`.
        dof: Real data less parameters.
        num_lines: Lines fitted.
        band_hz: The lowest and highest of them [Hz].
        smeared: Whether the window's smearing was part of the model.
    """

    omega_n: float
    zeta: float
    gain: float
    covariance: NDArray[np.float64]
    upper: float
    lower: float
    chi_square: float
    dof: int
    num_lines: int
    band_hz: tuple[float, float]
    smeared: bool

    @property
    def theta(self) -> NDArray[np.float64]:
        """The vector (omega_n, zeta, gain)."""
        return np.array([self.omega_n, self.zeta, self.gain])

    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviations of (omega_n, zeta, gain)."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True)
class PooledFit:
    """Fits of several repeats, together; every vector is (omega_n, zeta, gain).

    Attributes:
        mean: Mean over the repeats.
        covariance: Of the mean: from the fits' own, widened where the repeats scatter more.
        cv: Coefficient of variation across repeats [-].
        scatter_ratio: Variance across repeats over what the fits' covariances promise.
        scatter_p: Probability of such a ratio or a larger one by chance.
        num_repeats: Repeats.
    """

    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    cv: NDArray[np.float64]
    scatter_ratio: NDArray[np.float64]
    scatter_p: NDArray[np.float64]
    num_repeats: int

    @property
    def omega_n(self) -> float:
        """Mean natural frequency [rad/s]."""
        return float(self.mean[0])

    @property
    def zeta(self) -> float:
        """Mean damping ratio [-]."""
        return float(self.mean[1])

    @property
    def gain(self) -> float:
        """Mean gain [N/kg per unit]."""
        return float(self.mean[2])


def line_fit_start(frf: FRF, band: tuple[float, float] | None = None) -> LineFit:
    r"""The line-fit method: the inverse receptance is linear in its parameters.

    $$\frac1H = \frac{\omega_n^2}{g} - \frac{\omega^2}{g} + j\omega\,\frac{2\zeta\omega_n}{g}$$

    Weighted by |H|^4 over the variance, which is what 1/H inherits. Reads the FRF as it stands, so
    a short window reads too high a damping. No covariance (NaN): a start for `line_fit`.

    Args:
        frf: Estimated receptance.
        band: Lowest and highest frequency to fit [Hz]; by default 20 % about the peak.

    Returns:
        The fit.

    Raises:
        DataError: Fewer than 4 lines, or no resonance that loses energy.
    """
    lines = _lines(frf, band)
    omega, h = frf.omega[lines], frf.h[lines]
    scale = omega.mean()
    x = omega / scale
    weight = np.abs(h) ** 2 / np.sqrt(_floored(frf.variance[lines], h))
    zero = np.zeros_like(x)
    design = np.block([[np.ones_like(x), zero], [-(x**2), zero], [zero, x]]).T
    target = np.concatenate([(1 / h).real, (1 / h).imag])
    both = np.tile(weight / weight.max(), 2)
    a, b, c = np.linalg.lstsq(design * both[:, None], target * both)[0]
    if not (a / b > 0 and c / b > 0 and c**2 < 4 * a * b):
        peak = frf.freq[lines][np.argmax(np.abs(h))]
        raise DataError(
            f"The FRF must show a resonance that loses energy near {peak:.4g} Hz, but its inverse "
            "fits none.",
            why="Swapped channels, a delay of the response channel or a band without the peak do "
            "this.",
            remedy="Check which channel is the input, `delay` and `band`.",
        )
    root = np.sqrt(a / b)
    band_hz = float(frf.freq[lines][0]), float(frf.freq[lines][-1])
    return LineFit(
        omega_n=float(root * scale), zeta=float(c / b / (2 * root)), gain=float(scale**2 / b),
        covariance=np.full((3, 3), np.nan), upper=0.0, lower=0.0, chi_square=np.nan,
        dof=2 * len(h) - 3, num_lines=len(h), band_hz=band_hz, smeared=False,
    )  # fmt: skip


def line_fit(
    frf: FRF,
    band: tuple[float, float] | None = None,
    *,
    residuals: Residuals = "none",
    smear: bool | None = None,
) -> LineFit:
    r"""Natural frequency, damping and gain by weighted complex least squares.

    $$H(\omega) = \frac{g}{\omega_n^2 - \omega^2 + 2j\zeta\omega_n\omega} + r_u
      + \frac{r_l}{\omega^2}$$

    Under random input a Hann window smears the resonance (8 s read 0.44 % as 0.7 %); the smeared
    model is what is compared, so damping is unbiased with short windows too. The covariance knows
    that neighbouring lines of a window are correlated and that leakage is an error of its own.

    Args:
        frf: Estimated receptance.
        band: Lowest and highest frequency to fit [Hz]; by default 20 % about the peak.
        residuals: Terms for modes outside the band: none, upper (r_u) or both.
        smear: Whether the input was random, so that the window smears and leaks; by default for H1
            with a Hann window. Set False for a periodic input.

    Returns:
        The fit. Warns when damping is finer than the lines, or poorly known.

    Raises:
        DataError: Too few lines, no resonance, or a fit that does not converge.
        ConfigError: An option that cannot be meant.

    Reference:
        Eqs. (23), (38), (39).
    """
    if residuals not in NUM_RESIDUALS:
        raise ConfigError(f"Argument `residuals` must be none, upper or both: {residuals!r}.")
    possible = frf.estimator == "h1" and frf.window == "hann"
    if smear and not possible:
        raise ConfigError(
            "Argument `smear` holds for estimator h1 with a Hann window, "
            f"but the FRF is {frf.estimator} with {frf.window}."
        )
    smear = possible if smear is None else bool(smear)
    start = line_fit_start(frf, band)
    part = _part(frf, _lines(frf, band))
    order = derivative_order(frf.response)
    to_measured = (1j * part.omega) ** order
    data = part.h * to_measured
    # Columns of the residual terms, scaled to be of the size of one over the band.
    middle = part.omega.mean()
    extra = np.array([to_measured, to_measured * (middle / part.omega) ** 2])
    extra = extra[: NUM_RESIDUALS[residuals]]

    def model(theta: NDArray[np.float64]) -> NDArray[np.complex128]:
        omega_n, zeta, gain = theta[:3]
        if smear:
            mode = smeared(part.omega, omega_n, zeta, gain, frf.window_s, order)
        else:
            mode = receptance(part.omega, omega_n, zeta, gain) * to_measured
        return mode + theta[3:] @ extra

    observed = _floored(part.variance * np.abs(to_measured) ** 2, data)
    typical = np.concatenate([start.theta, np.full(len(extra), np.abs(part.h).max())])
    first = np.concatenate([start.theta, np.zeros(len(extra))])
    theta, _, _ = _least_squares(model, data, observed, first, typical)
    variance, of_sum = observed, None
    # The errors depend on the parameters, weakly: two rounds settle the weights.
    for _ in range(2 if frf.window == "hann" else 0):
        ratio = observed * frf.num_averages
        errors = line_errors(part, ratio, tuple(theta[:3]), leakage=smear)
        variance, of_sum = _floored(errors.variance, data), errors.of_sum
        theta, _, _ = _least_squares(model, data, variance, theta, typical)
    theta, jacobian, chi_square = _least_squares(model, data, variance, theta, typical)
    covariance = _covariance(jacobian, variance, of_sum)
    dof = 2 * len(data) - len(theta)
    lower = float(theta[4] * middle**2) if len(theta) > 4 else 0.0
    fit = LineFit(
        omega_n=float(theta[0]), zeta=float(theta[1]), gain=float(theta[2]),
        covariance=covariance[:3, :3], upper=float(theta[3]) if len(theta) > 3 else 0.0,
        lower=lower, chi_square=chi_square, dof=dof, num_lines=len(data),
        band_hz=start.band_hz, smeared=smear,
    )  # fmt: skip
    _warn_when_doubtful(fit, frf)
    return fit


def pool(fits: Sequence[LineFit]) -> PooledFit:
    r"""Fits of several repeats as one: mean, its covariance, and the CV across repeats.

    $$\mathrm{Cov}(\bar\theta) = D\,\frac{1}{R^2}\sum_r C_r\,D$$

    D is one, except where the repeats scatter beyond what their covariances promise (p < 0.01, by
    chi-square): there it is the root of the ratio of the two variances.

    Args:
        fits: One fit a repeat, at least one.

    Returns:
        The pooled fit; CV and scatter are NaN with one repeat.

    Raises:
        DataError: No fits.
    """
    if not fits:
        raise DataError("At least one fit is needed to pool, but none was given.")
    theta = np.array([fit.theta for fit in fits])
    promised = np.mean([fit.covariance for fit in fits], axis=0)
    num_repeats, mean = len(fits), theta.mean(axis=0)
    variance = np.var(theta, axis=0, ddof=1) if num_repeats > 1 else np.full(3, np.nan)
    ratio = variance / np.diag(promised)
    p = stats.chi2.sf(ratio * (num_repeats - 1), num_repeats - 1)
    widen = np.where(p < SCATTER_P, np.sqrt(ratio), 1.0)
    covariance = np.outer(widen, widen) * promised / num_repeats
    cv = np.sqrt(variance) / np.abs(mean)
    return PooledFit(mean, covariance, cv, ratio, p, num_repeats)


def _lines(frf: FRF, band: tuple[float, float] | None) -> slice:
    """Lines inside the band; by default 20 % to either side of the peak."""
    if band is None:
        # In the response as measured, whose noise does not rise towards low frequencies.
        size = np.abs(frf.h) * frf.omega ** derivative_order(frf.response) * frf.coherence
        peak = float(frf.freq[np.argmax(size)])
        band = ((1 - NEAR_PEAK) * peak, (1 + NEAR_PEAK) * peak)
        low, high = band
    else:
        low, high = passband(band, frf.fs / 2)
    first, last = np.searchsorted(frf.freq, [low, high * (1 + 1e-12)])
    if last - first < 4:
        raise DataError(
            f"The band {low:.4g} to {high:.4g} Hz must hold at least 4 lines, "
            f"but it holds {last - first} of the {1 / frf.window_s:.3g} Hz grid.",
            remedy="Widen `band`, or lengthen the windows of the estimate.",
        )
    return slice(int(first), int(last))


def _part(frf: FRF, lines: slice) -> FRF:
    """The FRF at some of its lines."""
    arrays = ("freq", "h", "coherence", "variance", "input_spectrum", "output_spectrum")
    return replace(frf, **{name: getattr(frf, name)[lines] for name in arrays})


def _floored(variance: NDArray[np.float64], h: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Variance kept off zero: a noise-free line would outweigh all others."""
    typical = np.mean(variance[np.isfinite(variance)]) if np.isfinite(variance).any() else 0.0
    return np.maximum(variance, max(1e-6 * typical, (1e-12 * np.abs(h).max()) ** 2))


def _least_squares(
    model: Callable[[NDArray[np.float64]], NDArray[np.complex128]],
    data: NDArray[np.complex128],
    variance: NDArray[np.float64],
    start: NDArray[np.float64],
    typical: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.complex128], float]:
    """Parameters, complex Jacobian of the model and chi-square, weighted by the variance."""
    weight = np.sqrt(2 / variance)  # each component has half of the variance

    def misfit(x: NDArray[np.float64]) -> NDArray[np.float64]:
        r = weight * (model(x * typical) - data)
        return np.concatenate([r.real, r.imag])

    low = np.full(len(start), -np.inf)
    low[1] = 1e-6  # a damping of zero has no steady response
    high = np.full(len(start), np.inf)
    high[1] = 0.999 / typical[1]
    x0 = np.clip(start / typical, low + 1e-9, high)
    # Widths of zeta's size matter in omega_n too, so its step is scaled down.
    size = np.ones(len(start))
    size[0] = typical[1]
    found = optimize.least_squares(
        misfit, x0, jac="3-point", x_scale=size, bounds=(low, high), xtol=1e-14, ftol=1e-14,
        gtol=1e-14,
    )  # fmt: skip
    if not (np.all(np.isfinite(found.x)) and found.x[1] > 2e-6):
        raise DataError(
            "The fit of the oscillator to the FRF found no positive damping.",
            remedy="Check `delay`, `band` and which channel is the input.",
        )
    half = len(data)
    jacobian = (found.jac[:half] + 1j * found.jac[half:]) / weight[:, None] / typical
    return found.x * typical, jacobian, float(2 * found.cost)


def _covariance(
    jacobian: NDArray[np.complex128],
    variance: NDArray[np.float64],
    of_sum: Callable[[NDArray[np.complex128]], NDArray[np.float64]] | None,
) -> NDArray[np.float64]:
    """Covariance of weighted least squares; of correlated lines where `of_sum` knows them."""
    scale = np.linalg.norm(jacobian, axis=0)
    weighted = (jacobian / scale).conj().T * (2 / variance)
    inverse = np.linalg.inv((weighted @ (jacobian / scale)).real) / np.outer(scale, scale)
    return inverse if of_sum is None else of_sum(inverse @ (weighted * scale[:, None]))


def _warn_when_doubtful(fit: LineFit, frf: FRF) -> None:
    """Warn when the damping is finer than the lines, or hardly known."""
    f_n, std = fit.omega_n / (2 * np.pi), fit.std[1]
    if fit.zeta * f_n < 1 / frf.window_s:
        warnings.warn(
            f"The damping {fit.zeta:.3%} of the mode at {f_n:.4g} Hz is finer than the lines "
            f"({fit.zeta * f_n:.3g} Hz against {1 / frf.window_s:.3g} Hz): read it with its error, "
            f"+-{std:.3%}.",
            stacklevel=3,
        )
    if std > 0.3 * fit.zeta:
        warnings.warn(
            f"The damping {fit.zeta:.3%} +- {std:.3%} is hardly known. Measure about "
            f"{(10 * std / fit.zeta) ** 2:.0f} times longer for one part in ten.",
            stacklevel=3,
        )
