r"""Frequency and damping of a record at several amplitudes, with covariances.

Damping is that of the *motion*: a response of order n decays differently if the frequency changes,

$$\sigma_{motion} = \sigma_{response} \Big(1 - n \frac{d \ln\omega}{d \ln a}\Big)$$

Values are the mean over all bases, weighted by their evidence $w_m$ (BIC). Errors combine the
sandwich covariances of the bases with the spread of their values,

$$\sum_m w_m \big(C_m + (x_m - \bar x)(x_m - \bar x)^T\big)$$

and a lower limit: the frequency at an amplitude is no better defined than first-order averaging is,

$$(c + \zeta)\,\Delta f + \Delta f^2 / f + f \zeta \Delta\zeta, \qquad
  (c + \zeta)\,\Delta\zeta + \zeta\,\Delta f / f$$

and 0.3 % of zeta (1 % for the frequency of a sweep), as the documentation states.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.special import fdtrc

from jbw.measurement.channels import Reals
from jbw.measurement.readings.decay import DecayFits, decay_model
from jbw.measurement.readings.slow_flow import (
    BASES,
    NESTED,
    ModeFit,
    covariance,
    independent_share,
)
from jbw.measurement.readings.statement import RecordTable
from jbw.measurement.readings.sweep import SweepFits
from jbw.measurement.resonances import MISSED

POINTS = 12  # number of amplitudes in a table
ABOVE_NOISE = 3.0  # Amplitudes below this multiple of the noise are not used.
DEEPEST = 0.02  # Amplitudes below this fraction of the largest are not used.
FLOOR_OF_DAMPING = 0.003  # smallest error of zeta, divided by zeta
BEYOND = 0.3  # error of zeta, divided by zeta and by the relative residual in excess of noise
# p-value of a change with amplitude below which a mode is nonlinear
ODDS = 1e-4
# smallest relevant change of zeta, or of the relative frequency, divided by zeta
LEAST_CHANGE = 5e-3
SURE = 3.0  # number of standard deviations by which a change must differ from zero
# tangent of 31 degrees: beyond this phase, the sign of a gain is not known
MOST_TURNED = 0.6

Square = Float[np.ndarray, "row row"]


class MeasuredChange(NamedTuple):
    """A change from the smallest to the largest amplitude, and its standard deviation."""

    value: float
    sd: float


@dataclass(frozen=True)
class ModeReading:
    """The frequency and damping of one mode against amplitude, determined from one record.

    Attributes:
        kind: "decay" or "sweep".
        order: Order of the derivative of displacement that the response is.
        amplitude: Peak amplitudes of the response in its unit, in decreasing order.
        hz: Natural frequency at each amplitude, sqrt(omega^2 + sigma^2) / (2 pi) [Hz].
        zeta: Damping ratio of the motion at each amplitude.
        hz_covariance: Covariance of the frequencies [Hz^2].
        zeta_covariance: Covariance of the damping ratios.
        linear_hz: Frequency of a linear mode, with standard deviation [Hz].
        linear_zeta: Damping ratio of a linear mode, with standard deviation.
        basis: Name of the basis that describes the data best.
        chance: Probability that a linear mode shows such a change with amplitude.
        hz_change: Relative change of the frequency.
        zeta_change: Change of the damping ratio.
        exponent: Power of the amplitude, with standard deviation; NaN for a linear record.
        residual: Root mean square of the residual, divided by that of the response.
        linear_residual: The same ratio for a linear mode.
        noise: Amplitude of the noise in the band, in the unit of the response.
        gain: Gain of the mode per unit of the drive, real for a force; NaN for a decay.
    """

    kind: str
    order: int
    amplitude: Reals
    hz: Reals
    zeta: Reals
    hz_covariance: Square
    zeta_covariance: Square
    linear_hz: MeasuredChange
    linear_zeta: MeasuredChange
    basis: str
    chance: float
    hz_change: MeasuredChange
    zeta_change: MeasuredChange
    exponent: MeasuredChange
    residual: float
    linear_residual: float
    noise: float
    gain: float

    @property
    def holds(self) -> bool:
        """Whether a single mode with positive damping fits the record."""
        return bool(np.median(self.zeta) > 0 and self.residual <= MISSED)

    @property
    def hz_sd(self) -> Reals:
        """The standard deviation of each frequency [Hz]."""
        return np.sqrt(np.diag(self.hz_covariance))

    @property
    def zeta_sd(self) -> Reals:
        """The standard deviation of each damping ratio."""
        return np.sqrt(np.diag(self.zeta_covariance))

    @property
    def y(self) -> Reals:
        """The amplitude of the displacement [m]."""
        return self.amplitude / (2 * np.pi * self.hz) ** self.order

    def at(self, amplitudes: Reals) -> "ModeReading":
        """Return frequency and damping at given amplitudes in the range, by interpolation."""
        rows = np.eye(len(self.amplitude))[::-1]
        weights = CubicSpline(np.log(self.amplitude[::-1]), rows)(np.log(amplitudes))
        return replace(
            self, amplitude=amplitudes, hz=weights @ self.hz, zeta=weights @ self.zeta,
            hz_covariance=weights @ self.hz_covariance @ weights.T,
            zeta_covariance=weights @ self.zeta_covariance @ weights.T,
        )  # fmt: skip

    def table(self) -> RecordTable:
        """Return frequency and damping as a table for statistical tests, by rising amplitude."""
        back = slice(None, None, -1)
        return RecordTable(
            self.y[back], self.hz[back], self.zeta[back], self.hz_covariance[back, back],
            self.zeta_covariance[back, back], self.chance,
        )  # fmt: skip


def read_fits(fits: DecayFits | SweepFits) -> ModeReading:
    """Return frequency and damping with errors, from the fit that describes a record best."""
    best = min(fits.fits.values(), key=lambda fit: fit.squares)
    count = 2 * len(fits.signal.z) * independent_share(best.residual * fits.weight)
    weights = _evidence(fits.fits, count)
    chosen = max((name for name in NESTED if name in weights), key=weights.__getitem__)
    grid = _amplitudes(fits, max(weights, key=weights.__getitem__))
    by_fit = {name: _rows(fits, name, grid) for name in weights}
    rows, linear = _mean([*by_fit.values()], [*weights.values()]), by_fit["linear"]
    floor_hz, floor_zeta = _floors(fits, best, rows)
    if chosen != "linear":
        own_hz, own_zeta = _second_order(fits, rows)
        floor_hz, floor_zeta = np.hypot(floor_hz, own_hz), np.hypot(floor_zeta, own_zeta)
    hz_covariance = rows.hz_covariance + np.diag(floor_hz**2)
    zeta_covariance = rows.zeta_covariance + np.diag(floor_zeta**2)
    hz_change = _change(rows.hz, rows.hz_covariance, floor_hz[0], 1 / rows.hz[0])
    zeta_change = _change(rows.zeta, rows.zeta_covariance, floor_zeta[0])
    linear_zeta = MeasuredChange(
        float(linear.zeta[0]), float(np.sqrt(linear.zeta_covariance[0, 0]))
    )
    chance = _chance_of_linear(fits, count)
    if not _matters(hz_change, zeta_change, linear_zeta.value):
        chance = max(chance, 0.5)
    exponent = MeasuredChange(np.nan, np.nan)
    if "power" in fits.fits and chance < ODDS:
        power = fits.fits["power"]
        sd = float(np.sqrt(max(covariance(power, fits.weight)[-1, -1], 0.0)))
        exponent = MeasuredChange(float(power.theta[-1]), sd)
    amplitude, gain = grid, np.nan
    if isinstance(fits, SweepFits):
        # The amplitude of the motion at resonance is converted to that of the measured response.
        top = fits.signal.rate[fits.signal.top]
        amplitude = grid * (2 * np.pi * rows.hz / top) ** fits.signal.order
        if fits.signal.is_force:
            turned = complex(fits.fits[chosen].gains[0])
            # A lag or an error of a clock turns the phase. Where it is over 31 degrees away from 0
            # and from 180, the gain has no sign.
            if abs(turned.imag) < MOST_TURNED * abs(turned.real):
                gain = turned.real * fits.signal.unit / fits.signal.drive_unit
    size = float(np.linalg.norm(fits.signal.z))
    residual, linear_residual = (
        float(np.linalg.norm(fits.fits[name].residual)) / size for name in (chosen, "linear")
    )
    unit = fits.signal.unit
    return ModeReading(
        kind=fits.KIND, order=fits.signal.order,
        amplitude=amplitude * unit, hz=rows.hz, zeta=rows.zeta,
        hz_covariance=hz_covariance, zeta_covariance=zeta_covariance,
        linear_hz=MeasuredChange(float(linear.hz[0]), float(np.sqrt(linear.hz_covariance[0, 0]))),
        linear_zeta=linear_zeta, basis=chosen, chance=chance, hz_change=hz_change,
        zeta_change=zeta_change, exponent=exponent,
        residual=residual, linear_residual=linear_residual, noise=fits.noise * unit, gain=gain,
    )  # fmt: skip


def _evidence(fits: dict[str, ModeFit], count: float) -> dict[str, float]:
    """Return the weight of each fit by its evidence (BIC), which penalises each parameter.

    `count` is the number of independent values.
    """
    score = np.array([
        count * np.log(max(fit.squares, 1e-300)) + len(fit.theta) * np.log(count)
        for fit in fits.values()
    ])  # fmt: skip
    weights = np.exp(-0.5 * (score - score.min()))
    return dict(zip(fits, (weights / weights.sum()).tolist(), strict=True))


def _amplitudes(fits: DecayFits | SweepFits, name: str) -> Reals:
    """Return the table's amplitudes, from the largest down to where the noise begins."""
    if isinstance(fits, DecayFits):
        size = np.abs(decay_model(fits.signal, fits.fits[name].theta, BASES[name], fits.scale))
    else:
        size = fits.signal.amplitude
    top = float(size.max())
    low = max(ABOVE_NOISE * fits.noise, 2 * fits.faded, float(size.min()), DEEPEST * top)
    return np.geomspace(top, low, POINTS) if low < 0.9 * top else np.array([top])


def _rows(fits: DecayFits | SweepFits, name: str, grid: Reals) -> RecordTable:
    """Return frequency and damping at several amplitudes from the fit of one basis."""
    basis, fit, scale = BASES[name], fits.fits[name], fits.scale
    first = fits.FIRST
    own = slice(first, first + basis.terms)
    turned = slice(own.stop, own.stop + basis.terms)
    theta, exponent = fit.theta, basis.exponent(fit.theta)
    ratio = np.maximum(grid / fits.signal.a0, 1e-9)
    powers = basis.values(ratio, exponent)
    sigma = theta[own] @ powers * scale
    omega = theta[turned] @ powers * scale + 2 * np.pi * fits.signal.centre_hz
    by_sigma, by_omega = np.zeros((2, len(grid), len(theta)))
    by_sigma[:, own] = by_omega[:, turned] = powers.T * scale
    if basis.is_free:
        slope = np.arange(basis.terms)[:, None] * powers * np.log(ratio)
        by_sigma[:, -1], by_omega[:, -1] = (theta[x] @ slope * scale for x in (own, turned))
    if isinstance(fits, DecayFits) and len(grid) > 3:
        along = np.gradient(np.log(omega), np.log(grid))
        sigma = sigma * (1 - fits.signal.order * along)
    by_zeta = by_sigma / omega[:, None] - (sigma / omega**2)[:, None] * by_omega
    spread = covariance(fit, fits.weight)
    return RecordTable(
        grid,
        np.hypot(sigma, omega) / (2 * np.pi),
        sigma / np.hypot(sigma, omega),
        by_omega @ spread @ by_omega.T / (2 * np.pi) ** 2,
        by_zeta @ spread @ by_zeta.T,
    )


def _mean(rows: list[RecordTable], weights: list[float]) -> RecordTable:
    """Return the weighted mean of several fits' values; include the covariance between fits."""

    def mean(values: Sequence[Reals]) -> Reals:
        return np.tensordot(weights, np.stack(values), 1)

    def covariance_of(values: Sequence[Reals], within: Sequence[Square]) -> Square:
        between = np.stack(values) - mean(values)
        return mean(within) + (between.T * weights) @ between

    (y, *_), hz, zeta, hz_within, zeta_within, _ = zip(*rows, strict=True)
    covariances = covariance_of(hz, hz_within), covariance_of(zeta, zeta_within)
    return RecordTable(y, mean(hz), mean(zeta), *covariances)


def _floors(fits: DecayFits | SweepFits, best: ModeFit, rows: RecordTable) -> tuple[Reals, Reals]:
    """Return errors of frequency and damping: the residual beyond noise, but at least a minimum."""
    size = np.abs(fits.signal.z)
    loud = size > 0.4 * size.max()
    excess = float(np.mean(np.abs(best.residual[loud]) ** 2)) - 1.5 * fits.noise**2
    beyond = BEYOND * np.sqrt(max(excess, 0.0)) / float(size.max())
    zeta = np.abs(rows.zeta)
    return (
        max(beyond, fits.FLOOR) * zeta * rows.hz,
        max(beyond, FLOOR_OF_DAMPING) * zeta,
    )


def _second_order(fits: DecayFits | SweepFits, rows: RecordTable) -> tuple[Reals, Reals]:
    """Return the error of first-order averaging due to changes of frequency or damping."""
    hz, zeta = rows.hz, np.abs(rows.zeta)
    share = fits.SECOND_ORDER + float(zeta.max())
    change, growth = np.ptp(hz), np.ptp(rows.zeta)
    of_hz = share * change + change**2 / hz + hz * zeta.max() * growth
    return of_hz, share * growth + change / hz * zeta


def _change(values: Reals, spread: Square, floor: float, factor: float = 1.0) -> MeasuredChange:
    """Return the difference between a table's first and last value, with its error."""
    variance = spread[0, 0] + spread[-1, -1] - 2 * spread[0, -1]
    sd = np.hypot(np.sqrt(max(float(variance), 0.0)), floor)
    return MeasuredChange(float((values[0] - values[-1]) * factor), float(sd * factor))


def _matters(hz: MeasuredChange, zeta: MeasuredChange, damping: float) -> bool:
    """Return whether a change exceeds the error of averaging and is certain."""
    is_large = max(abs(hz.value), abs(zeta.value)) >= LEAST_CHANGE * abs(damping)
    return is_large and any(abs(change.value) >= SURE * change.sd for change in (hz, zeta))


def _chance_of_linear(fits: DecayFits | SweepFits, count: float) -> float:
    """Return the probability of the measured effect of amplitude in a linear mode (Wald's test)."""
    if "quadratic" not in fits.fits:
        return 1.0
    fit, first = fits.fits["quadratic"], fits.FIRST
    at = [first + 1, first + 2, first + 4, first + 5]
    spread = covariance(fit, fits.weight)[np.ix_(at, at)]
    statistic = fit.theta[at] @ np.linalg.pinv(spread, hermitian=True) @ fit.theta[at]
    return float(fdtrc(4, max(count - len(fit.theta), 4), max(float(statistic), 0.0) / 4))
