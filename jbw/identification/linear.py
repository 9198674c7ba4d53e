"""Step 2 of Teloli et al.: natural frequency, damping and gain from an FRF, with covariance."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import stats

from jbw.errors import ConfigError, DataError
from jbw.identification.line_method import LineFit, in_band, line_fit_start
from jbw.identification.lines import FRFLines, fit_lines
from jbw.identification.windowed import Real
from jbw.measurement.spectra import FRF

Residuals = Literal["none", "upper", "both"]

NUM_RESIDUALS = {"none": 0, "upper": 1, "both": 2}
# If the probability of the variation of the repeats is larger than this, errors of the fits explain
# it.
SCATTER_P = 0.01


@dataclass(frozen=True)
class PooledFit:
    """The combined fit of several repeats; vectors are (omega_n, zeta, gain)."""

    mean: Real  # mean over the repeats
    # covariance of the mean, enlarged if the repeats vary more than their errors allow
    covariance: Real
    cv: Real  # coefficient of variation across repeats [-]
    scatter_ratio: Real  # ratio of the variance between repeats to that expected from the fits
    scatter_p: Real  # p-value of the ratio
    num_repeats: int

    @property
    def omega_n(self) -> float:
        """The mean natural frequency [rad/s]."""
        return float(self.mean[0])

    @property
    def zeta(self) -> float:
        """The mean damping ratio [-]."""
        return float(self.mean[1])

    @property
    def gain(self) -> float:
        """The mean gain [N/kg per unit]."""
        return float(self.mean[2])


def line_fit(
    frf: FRF,
    band: tuple[float, float] | None = None,
    *,
    residuals: Residuals = "none",
    smear: bool | None = None,
) -> LineFit:
    r"""Fit the natural frequency, damping and gain of one mode to an FRF.

    $$H(\omega) = \frac{g}{\omega_n^2 - \omega^2 + 2j\zeta\omega_n\omega} + r_u
      + \frac{r_l}{\omega^2}$$

    The fit is by weighted complex least squares. Under random input, a Hann window smears the
    resonance (8 s windows show a damping of 0.44 % as 0.6 to 0.9 %). The model is smeared in the
    same way, so damping is unbiased with short windows too. The covariance includes the correlation
    of neighbouring lines and the error by leakage.

    Args:
        frf: Estimated receptance.
        band: Lowest and highest frequency to fit [Hz]; by default 20 % around the peak.
        residuals: Terms for modes outside the band: none, upper (r_u) or both.
        smear: Whether the input was random, so that the window smears and leaks; by default for H1
            with a Hann window. Set False for a periodic input.

    Returns:
        The fit. A warning is given if the damping is finer than the lines, or poorly determined.

    Raises:
        DataError: There are too few lines or no resonance, or the fit does not converge.
        ConfigError: An option is invalid.

    Reference:
        Step 2, with the receptance of Eq. (23).

    Examples:
        The virtual rig has 118.12 rad/s, a damping ratio of 0.444 % and a gain of 15 N/kg/V:

        >>> import jbw; jbw.enable_x64()
        >>> (noise,) = jbw.rig.measure(tests=["noise_0p005V"], repeats=1).tests
        >>> line = jbw.line_fit(jbw.frf(noise, "input", "velocity"), band=(17.0, 20.5))
        >>> print(f"{line.omega_n:.2f} rad/s, {line.gain:.2f} N/kg/V")
        118.12 rad/s, 15.00 N/kg/V
        >>> print(f"{line.zeta:.3%} +- {line.std[1]:.3%}")
        0.445% +- 0.001%
    """
    smear = checked_smear(frf, residuals, smear)
    part = in_band(frf, band)
    start = line_fit_start(part)
    extra = np.zeros(NUM_RESIDUALS[residuals])
    typical = np.concatenate([start, extra + np.abs(part.h).max()])
    optimum = fit_lines(
        FRFLines((part,), 1, len(extra), smear), np.concatenate([start, extra]), typical
    )
    upper, lower = (*optimum.theta[3:], 0.0, 0.0)[:2]
    omega_n, zeta, gain = map(float, optimum.theta[:3])
    fit = LineFit(
        omega_n, zeta, gain, covariance=optimum.covariance[:3, :3],
        upper=float(upper), lower=float(lower * part.omega.mean() ** 2),
        chi_square=optimum.chi_square, dof=2 * len(part.h) - len(optimum.theta),
        num_lines=len(part.h), band_hz=(float(part.freq[0]), float(part.freq[-1])), smeared=smear,
    )  # fmt: skip
    _warn_when_doubtful(fit, frf)
    return fit


def pool(fits: Sequence[LineFit]) -> PooledFit:
    r"""Combine the line fits of several repeats: mean, its covariance, variation between repeats.

    $$\mathrm{Cov}(\bar\theta) = D\,\frac{1}{R^2}\sum_r C_r\,D$$

    D is one, except if the repeats scatter more than their covariances explain (p < 0.01, by
    chi-square): then it is the square root of the ratio of the two variances.

    Args:
        fits: One fit per repeat, at least one.

    Returns:
        The pooled fit; CV and scatter are NaN with one repeat.

    Raises:
        DataError: No fits are given.

    Examples:
        Three records of the virtual rig, which has 118.12 rad/s and 0.444 %, are pooled:

        >>> import jbw; jbw.enable_x64()
        >>> (noise,) = jbw.rig.measure(tests=["noise_0p005V"], repeats=3).tests
        >>> frfs = [jbw.frf(record, "input", "velocity") for record in noise.records]
        >>> pooled = jbw.pool([jbw.line_fit(frf, band=(17.0, 20.5)) for frf in frfs])
        >>> print(f"{pooled.num_repeats} records: {pooled.omega_n:.2f} rad/s, {pooled.zeta:.2%}")
        3 records: 118.12 rad/s, 0.44%
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


def checked_smear(frf: FRF, residuals: str, smear: bool | None) -> bool:
    """Return whether the model includes smearing by the FRF's window; check the options."""
    if residuals not in NUM_RESIDUALS:
        raise ConfigError(
            f"Argument `residuals` must be none, upper or both, but it is {residuals!r}."
        )
    possible = frf.estimator == "h1" and frf.window == "hann"
    if smear and not possible:
        raise ConfigError(
            "Argument `smear` may be true only for estimator h1 with a Hann window, but the FRF "
            f"was estimated by {frf.estimator} with {frf.window}.",
            remedy="Leave `smear` out.",
        )
    return possible if smear is None else bool(smear)


def _warn_when_doubtful(fit: LineFit, frf: FRF) -> None:
    """Warn if the resonance is narrower than the spacing of the lines, or poorly determined."""
    f_n, std = fit.omega_n / (2 * np.pi), fit.std[1]
    if fit.zeta * f_n < 1 / frf.window_s:
        warnings.warn(
            f"The half-power half width of the mode at {f_n:.4g} Hz ({fit.zeta * f_n:.3g} Hz, "
            f"damping {fit.zeta:.3%}) is smaller than the line spacing ({1 / frf.window_s:.3g} "
            f"Hz): quote the damping with its error, +-{100 * std:.2g}%, or lengthen the windows.",
            stacklevel=3,
        )
    if std > 0.3 * fit.zeta:
        warnings.warn(
            f"The damping {fit.zeta:.3%} +- {std:.3%} is very uncertain. Measure about "
            f"{(10 * std / fit.zeta) ** 2:.0f} times longer to determine the damping to 10 %.",
            stacklevel=3,
        )
