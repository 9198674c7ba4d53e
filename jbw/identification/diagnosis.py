r"""Diagnosis of a joint from frequency and damping against amplitude, before a law is fitted.

$$\omega(Y) = \omega_0 (1 - a\,(Y/Y_{max})^q), \qquad \zeta(Y) = \zeta_0 + b\,(Y/Y_{max})^p,
  \qquad r = \frac{b}{a} = \frac{\Delta\zeta}{-\Delta\omega/\omega}$$

To first order, every law has equal exponents, and r is a closed form. In a law of Masing's kind,
softening determines damping: $r = C_d(q) / C_s(q)$. If r is smaller, a part of the softening is
elastic; if it is larger, there is damping without softening. In Bouc-Wen's law the ratio is free,
$\gamma/\delta = r\,(q + 2)\,I(q + 2) / (q + 1)$.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar
from scipy.special import gammaln

from jbw.inference.posterior.quantiles import QUANTILES
from jbw.measurement.resonances import AmplitudeCurve
from jbw.oscillator.power_losses import power_losses
from jbw.report.messages import effects as messages

FEWEST = 5  # smallest number of measured values from which an exponent is estimated
EXPONENTS = (0.1, 4.0)
DRAWN = 400  # number of random variations of the measured values, from which bands are computed
SEED = 0
# Smallest change of frequency on each side of a turning point, in standard deviations, at which the
# turning point counts as real.
TURNS = 3.5
LEAST_TURN = 1e-4  # smallest relative change of frequency on both sides of a turning point
CURVES = 15  # If there are more values than this, neighbouring values are averaged.
# number of averages; smallest number of measured values from which a turning point is searched
GROUPS, FEWEST_TURNING = 8, 6
Values = Float[np.ndarray, " point"]
# relative error of the ratio of damping to frequency change, due to neglected higher orders in
# amplitude
CLOSE = 0.1


class Diagnosis(NamedTuple):
    """The diagnosis of a joint; triples are lower end, middle and upper end of a 99 % band.

    Attributes:
        num_readings: Number of readings of frequency and damping.
        y: Smallest and largest amplitude [m].
        softening: a, the relative loss of frequency at the largest amplitude.
        softening_exponent: q, from the frequency alone.
        damping: b, the increase of the damping ratio at the largest amplitude.
        damping_exponent: p, from the damping alone.
        ratio: r, at the exponent of the softening, which is better determined.
        masing: Value of r for Masing's laws with that exponent.
        elastic: Share of the softening that Masing's laws do not explain, 1 - r / r_Masing.
        opening: Ratio gamma/delta of the Bouc-Wen law with that exponent.
        spring: Coefficient c of a smooth spring c y|y| with the same softening [1/(m s^2)].
        damper: Coefficient c of a smooth damper c v|v| with the same damping [1/m].
        turn: Turning point of the frequency: amplitude [m], frequency there and at the largest
            amplitude [Hz]; None if it is monotonic. No power of the amplitude has such a point.
    """

    num_readings: int
    y: tuple[float, float]
    softening: tuple[float, float, float]
    softening_exponent: tuple[float, float, float]
    damping: tuple[float, float, float]
    damping_exponent: tuple[float, float, float]
    ratio: tuple[float, float, float]
    masing: tuple[float, float, float]
    elastic: tuple[float, float, float]
    opening: tuple[float, float, float]
    spring: tuple[float, float, float]
    damper: tuple[float, float, float]
    turn: tuple[float, float, float] | None = None


def diagnose(curve: AmplitudeCurve) -> Diagnosis | None:
    """Determine exponents and the ratio of damping to softening; None if there are too few values.

    Bands come from readings drawn within their errors. Readings are weighted by their amplitude:
    the noise of frequency and damping falls as the motion grows.
    """
    if len(np.unique(curve.y)) < FEWEST:
        return None
    rng = np.random.default_rng(SEED)
    omega, zeta = (
        np.vstack([values, rng.multivariate_normal(values, spread, DRAWN, method="eigh")])
        for values, spread in zip(curve[1:3], curve[3:], strict=True)
    )
    rows = [_read(curve.y, *drawn) for drawn in zip(omega, zeta, strict=True)]
    bands = [tuple(np.quantile(column, QUANTILES).tolist()) for column in np.array(rows).T]
    reach = float(curve.y.min()), float(curve.y.max())
    return Diagnosis(len(curve.y), reach, *bands, turn=turning_point(curve))


def turning_point(curve: AmplitudeCurve) -> tuple[float, float, float] | None:
    """Return the amplitude at which the frequency stops falling or rising, with its band, or None.

    The frequency must change by more than 3.5 standard deviations on both sides of the point. Many
    readings are averaged in groups of neighbouring amplitudes.
    """
    if len(curve.y) < FEWEST_TURNING:
        return None
    order = np.argsort(curve.y)
    num = min(GROUPS, len(order) // 4) if len(order) > CURVES else len(order)
    means = np.zeros((num, len(order)))
    for row, group in zip(means, np.array_split(order, num), strict=True):
        row[group] = 1 / len(group)
    y, omega = means @ curve.y, means @ curve.omega
    spread = means @ curve.omega_covariance @ means.T
    for at in (int(np.argmin(omega)), int(np.argmax(omega))):
        away = np.eye(num)[[0, -1]] - np.eye(num)[at]
        least = TURNS * np.sqrt(np.diag(away @ spread @ away.T))
        if np.all(np.abs(away @ omega) > np.maximum(least, LEAST_TURN * omega[at])):
            turn_hz, end_hz = (omega[[at, -1]] / (2 * np.pi)).tolist()
            return float(y[at]), turn_hz, end_hz
    return None


def _read(y: Values, omega: Values, zeta: Values) -> Sequence[float]:
    """Return the values of a `Diagnosis` from one set of frequencies and damping ratios."""
    y_max = float(y.max())
    x = y / y_max
    share = x**2 / np.sum(x**2)  # Values are weighted by their amplitude.

    def line(values: Values, exponent: float) -> tuple[np.ndarray, float]:
        """Fit a constant plus a power of the amplitude to values; return the residual as well."""
        power = x**exponent
        middle, centre = share @ power, share @ values
        across, along = power - middle, values - centre
        change = (share * across) @ along / ((share * across) @ across)
        residual = along - change * across
        return np.array([centre - change * middle, change]), float(np.sum((x * residual) ** 2))

    def exponent(values: Values) -> float:
        minimum: Any = minimize_scalar(
            lambda e: line(values, e)[1], bounds=EXPONENTS, method="bounded"
        )
        return float(minimum.x)

    q, p = exponent(omega), exponent(zeta)
    (at_rest, lost), _ = line(omega, q)
    (_, added), _ = line(zeta, q)
    softening, masing = -lost / at_rest, masing_ratio(q)
    ratio = added / softening if softening else np.inf
    integral = 0.5 * np.sqrt(np.pi) * np.exp(gammaln((q + 3) / 2) - gammaln(q / 2 + 2))
    opening = ratio * (q + 2) * integral / (q + 1)
    smooth = _smooth_pair(line(omega, 1.0)[0], line(zeta, 1.0)[0], y_max)
    return softening, q, added, p, ratio, masing, 1 - ratio / masing, opening, *smooth


def _smooth_pair(
    omega: Float[np.ndarray, " two"], zeta: Float[np.ndarray, " two"], y_max: float
) -> tuple[float, float]:
    r"""Return c of a spring c y|y| and a damper c v|v| that explain changes linear in amplitude.

    $$\frac{\Delta\omega}{\omega} = \frac{8}{3\pi} \frac{c Y}{2 \omega^2}, \qquad
      \Delta\zeta = \frac{8}{3\pi} \frac{c' Y}{2}$$
    """
    factor = 0.5 * 8.0 / (3.0 * np.pi) * y_max
    return float(omega[0] * omega[1] / factor), float(zeta[1] / factor)


def masing_ratio(exponent: float) -> float:
    """Return the ratio of damping to softening for laws that follow Masing's rule, C_d / C_s."""
    softening, damping = power_losses(exponent)
    return float(damping / softening)


def diagnosis_sentences(found: Diagnosis) -> list[str]:
    """Return the sentences on how natural frequency and damping depend on amplitude."""
    range_mm = 1e3 * found.y[0], 1e3 * found.y[1]
    grown = messages.damping_grows(found.damping, found.damping_exponent)
    if found.turn is not None:
        turns = messages.turning(*found.turn)
        return [messages.readings(found.num_readings, range_mm, turns, grown)]
    falls = messages.frequency_falls(found.softening, found.softening_exponent)
    first = messages.readings(found.num_readings, range_mm, falls, grown)
    (low, _, high), p = found.softening, found.damping_exponent
    if low <= 0.0 <= high:
        return [first, messages.no_softening(grows=found.damping[0] > 0.0)]
    if high < 0.0:
        return [first, messages.HARDENS]
    low, share, high = found.elastic
    if low > 0.0 and share > CLOSE:
        compared = messages.elastic_softening(found.elastic)
    elif high < 0.0 and share < -CLOSE:
        compared = messages.MORE_DAMPING
    else:
        compared = messages.SLIDERS
    sentence = messages.masing(found.ratio, found.masing[1], compared, found.opening)
    if not all(low <= 1.0 <= high for low, _, high in (found.softening_exponent, p)):
        return [first, sentence]
    return [first, sentence, messages.smooth_alternative(found.spring, found.damper)]
