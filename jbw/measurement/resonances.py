r"""Frequency and damping of a record near its resonance, as those of a linear oscillator.

The reading is a linear least-squares fit over the lines of the record's Fourier transform,

$$(\omega_n^2 + 2j\zeta\omega_n\omega)\,Y - g\,U - \sum_{k=-1}^{1} (j\omega)^k c_k
  = \omega^2\,Y$$

whose constants c represent the states in which the record begins and ends; a response curve has
none. Points of a controlled test are read one by one. The effect of a joint appears as readings
that change with the amplitude.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from jbw.errors import DataError
from jbw.measurement.channels import OF_NORMAL, Complexes, Reals, lines_within
from jbw.measurement.curves import ControlledCurve, controlled_curve
from jbw.measurement.records import Record, Test
from jbw.quantities import derivative_order
from jbw.report.messages import reading as messages

WIDE = 0.15  # half width of the band for the first fit, divided by the peak's frequency
HALF_WIDTHS = 6.0  # half width of the band of all fits after the first, over zeta omega_n
# smallest numbers of lines of a time record, and of points of a curve
LEAST_LINES, LEAST_POINTS = 12, 6
ROUNDS = 3  # number of fits, each in a narrower band about the resonance
DRIVEN = 1e-2  # A line is driven if it exceeds this fraction of the source's largest line.
SWEPT = 5e-3  # fraction of the source's energy beyond either end of the sweep
# largest relative residual near the resonance up to which an oscillator describes the response
MISSED = 0.5
# relative error of the damping ratio per unit of the oscillator's relative residual
LEFT_OPEN = 0.45
FLOOR = 1e-3  # smallest error of the damping ratio, divided by the damping ratio
# number of lines that are averaged to decide whether they are driven, since noise varies
NEAR_LINES = 9


class AmplitudeCurve(NamedTuple):
    """Equivalent frequency [rad/s] and damping against the amplitude y [m], with covariances."""

    y: Float[np.ndarray, " point"]
    omega: Float[np.ndarray, " point"]
    zeta: Float[np.ndarray, " point"]
    omega_covariance: Float[np.ndarray, "point point"]
    zeta_covariance: Float[np.ndarray, "point point"]

    def at(self, places: Bool[np.ndarray, " point"]) -> "AmplitudeCurve":
        """Return the curve restricted to the selected points."""
        square = np.ix_(places, places)
        values, covariances = self[:3], self[3:]
        return AmplitudeCurve(*(x[places] for x in values), *(x[square] for x in covariances))


def curve_of_points(points: Sequence[tuple[float, float, float]]) -> AmplitudeCurve:
    """Return amplitude, frequency and damping of points, with errors estimated from neighbours.

    A value's deviation from the line through its neighbours has 3/2 of its variance. The median is
    insensitive to a bend.
    """
    y, omega, zeta = np.array(points).T
    order = np.argsort(y)

    def covariance(values: Float[np.ndarray, " point"]) -> Float[np.ndarray, "point point"]:
        x = values[order]
        bend = np.abs(x[1:-1] - 0.5 * (x[:-2] + x[2:]))
        variance = (np.median(bend) / OF_NORMAL) ** 2 / 1.5 if len(bend) else 0.0
        return float(variance) * np.eye(len(x))

    return AmplitudeCurve(y, omega, zeta, covariance(omega), covariance(zeta))


class Reading(NamedTuple):
    """The frequency and damping of a record, curve or part of a decay, at one amplitude."""

    y: float  # amplitude of the displacement [m]
    frequency_hz: float
    damping: float
    # residual of the linear oscillator near resonance, divided by the rms of the response
    left: float = np.nan
    third: float = np.nan  # ratio of the displacement's largest third harmonic to its first
    frequency_sd: float = np.nan  # standard deviation of the frequency [Hz]
    damping_sd: float = np.nan
    # residual of the fit that gave frequency and damping; NaN if a linear oscillator was fitted
    residual: float = np.nan

    @property
    def holds(self) -> bool:
        """Whether the values are those of a dissipative oscillator that fits the measurement."""
        residual = self.left if np.isnan(self.residual) else self.residual
        return self.damping > 0.0 and not residual > MISSED and bool(np.isfinite(self.y))


class DrivenLines(NamedTuple):
    """The lines of a record's Fourier transform that its source drives."""

    omega: Float[np.ndarray, " line"]  # [rad/s]
    source: Complex[np.ndarray, " line"]
    y: Complex[np.ndarray, " line"]  # displacement [m]
    place: Int[np.ndarray, " line"]  # index among all lines; the mean has index 0
    num_samples: int


def driven_lines(record: Record, band_hz: tuple[float, float] | None = None) -> DrivenLines:
    """Return source and displacement at the driven lines, within a band if one is given."""
    if not record.valid.all():
        raise DataError(f"{_named(record)} has samples missing.")
    u, x = (record.channels[role] for role in (record.source, record.response))
    freq = np.fft.rfftfreq(len(u), 1 / record.fs)[1:]
    too_few = messages.few_driven_lines(_named(record), LEAST_LINES)
    if len(freq) < LEAST_LINES:
        raise DataError(too_few)
    source, response = (np.fft.rfft(samples - np.mean(samples))[1:] for samples in (u, x))
    y = response / (2j * np.pi * freq) ** derivative_order(record.response)
    near = np.ones(NEAR_LINES) / NEAR_LINES
    size = np.sqrt(np.convolve(np.abs(source) ** 2, near, "same"))
    is_driven = (size > DRIVEN * np.max(size)) & swept(np.abs(source) ** 2)
    if band_hz is not None:
        is_driven &= lines_within(freq, band_hz)
    if np.count_nonzero(is_driven) < LEAST_LINES:
        raise DataError(too_few)
    place = 1 + np.flatnonzero(is_driven)
    return DrivenLines(2 * np.pi * freq[is_driven], source[is_driven], y[is_driven], place, len(u))


def driven_band(record: Record) -> tuple[float, float]:
    """Return the lowest and the highest frequency that the source drives [Hz]."""
    u = record.channels[record.source]
    size = np.abs(np.fft.rfft(u - np.mean(u)))
    driven = np.fft.rfftfreq(len(u), 1 / record.fs)[size > DRIVEN * np.max(size)]
    return float(driven[0]), float(driven[-1])


def swept(power: Float[np.ndarray, " line"]) -> Bool[np.ndarray, " line"]:
    """Return a mask of the lines inside a source's sweep, which contain 99 % of its energy."""
    share = np.cumsum(power) / np.sum(power)
    return (share >= SWEPT) & (share <= 1 - SWEPT)


def _named(record: Record) -> str:
    return record.name or "A record"  # A record in memory has no file name.


def read_lines(lines: DrivenLines) -> Reading:
    """Return frequency and damping of a time record, at its energy-weighted mean amplitude."""
    read = read_resonance(lines.omega, lines.source, lines.y)
    centre = 2 * np.pi * read.frequency_hz
    near = np.abs(lines.omega - centre) < WIDE * centre
    spectrum = np.zeros(lines.num_samples, complex)
    spectrum[lines.place[near]] = 2 * lines.y[near]
    return read._replace(y=_weighed(np.fft.ifft(spectrum)))


def read_curve(
    omega: Float[np.ndarray, " point"],
    source: Complex[np.ndarray, " point"],
    y: Complex[np.ndarray, " point"],
) -> Reading:
    """Return frequency and damping of a response curve, at its energy-weighted mean amplitude."""
    if len(omega) < LEAST_POINTS:
        raise DataError(
            f"A response curve must have at least {LEAST_POINTS} frequencies to show its "
            f"resonance, but has {len(omega)}."
        )
    return read_resonance(omega, source, y, is_curve=True)._replace(y=_weighed(y))


def read_resonance(
    omega: Float[np.ndarray, " line"],
    source: Complex[np.ndarray, " line"],
    y: Complex[np.ndarray, " line"],
    *,
    is_curve: bool = False,
) -> Reading:
    r"""Fit an oscillator to the spectral lines about a peak, in narrower and narrower bands.

    The relative residual r of the response is due to noise or to a joint. A joint makes an error of
    $0.45\,r\,\zeta$, in the relative frequency and in the damping ratio, as calibrated on simulated
    records of noise and multisines; it is added to the standard deviations of the least squares.
    """
    centre = float(omega[int(np.argmax(np.abs(omega * y)))])
    half, least = WIDE * centre, LEAST_POINTS if is_curve else LEAST_LINES
    damping = residual = np.nan
    sds = np.nan, np.nan
    for _ in range(ROUNDS):
        away = np.abs(omega - centre)
        near = away <= max(half, float(np.sort(away)[min(least, len(away)) - 1]))
        centre, damping, residual, *sds = _through(omega[near], source[near], y[near], is_curve)
        half = min(half, HALF_WIDTHS * abs(damping) * centre)
    left_open = max(LEFT_OPEN * residual, FLOOR) * abs(damping)
    sd_hz = np.hypot(sds[0], left_open * centre) / (2 * np.pi)
    sd_damping = np.hypot(sds[1], left_open)
    hz = centre / (2 * np.pi)
    return Reading(np.nan, hz, damping, residual, np.nan, float(sd_hz), float(sd_damping))


def _through(
    omega: Float[np.ndarray, " line"],
    source: Complex[np.ndarray, " line"],
    y: Complex[np.ndarray, " line"],
    is_curve: bool,
) -> tuple[float, float, float, float, float]:
    """Return omega_n [rad/s], zeta, relative residual, and the errors of omega_n and zeta.

    Standard deviations are those of the linear least squares, from its residual.
    """
    # The end term 1 / (i omega) comes from the integration of a measured velocity or acceleration.
    ends = [] if is_curve else [np.ones_like(y), 1j * omega, 1 / (1j * omega)]
    columns = np.column_stack([y, 1j * omega * y, -source, *(-column for column in ends)])
    scale = np.linalg.norm(columns, axis=0)
    scaled: Any = columns / scale
    stacked = np.concatenate([scaled.real, scaled.imag])
    target = omega**2 * y
    both = np.concatenate([np.real(target), np.imag(target)])
    coefficients = np.linalg.lstsq(stacked, both)[0] / scale
    degrees = max(len(both) - stacked.shape[1], 1)
    variance = float(np.sum((both - stacked @ (coefficients * scale)) ** 2)) / degrees
    spread = variance * np.diag(np.linalg.pinv(stacked.T @ stacked)) / scale**2
    if not coefficients[0] > 0.0:
        raise DataError(
            "The spectral lines about the largest response show no resonance.",
            remedy="Measure around the natural frequency, or state a band around the mode.",
        )
    model = -(columns[:, 2:] @ coefficients[2:]) / (
        coefficients[0] + 1j * omega * coefficients[1] - omega**2
    )
    residual = np.linalg.norm(y - model) / np.linalg.norm(y)
    omega_n = float(np.sqrt(coefficients[0]))
    sds = np.sqrt(spread[:2]) / (2 * omega_n)
    damping = float(coefficients[1] / (2 * omega_n))
    return omega_n, damping, float(residual), float(sds[0]), float(sds[1])


def real_coefficients(
    columns: Complex[np.ndarray, "line column"], target: Complexes
) -> Float[np.ndarray, " column"]:
    """Return the real coefficients with which complex columns fit a target by least squares."""
    scale = np.linalg.norm(columns, axis=0)
    stacked = np.concatenate([(columns / scale).real, (columns / scale).imag])
    return np.linalg.lstsq(stacked, np.concatenate([target.real, target.imag]))[0] / scale


def oscillator_through(omega: Reals, u: Complexes, y: Complexes) -> dict[str, float]:
    r"""Return omega_n [rad/s], zeta and gain of an oscillator by linear least squares, y in m.

    $$(\omega_n^2 + 2j\zeta\omega_n\omega)\,Y - g\,U = \omega^2\,Y$$
    """
    columns = np.column_stack([y, 1j * omega * y, -u])
    coefficients = real_coefficients(columns, omega**2 * y)
    omega_n = float(np.sqrt(max(coefficients[0], np.min(omega) ** 2)))
    return {
        "omega_n": omega_n,
        "zeta": float(max(coefficients[1] / (2 * omega_n), 1e-4)),
        "gain": float(coefficients[2]),
    }


def _weighed(envelope: Complex[np.ndarray, " value"]) -> float:
    r"""Return the energy-weighted mean amplitude of an envelope, $\sum |Y|^3 / \sum |Y|^2$.

    A stiffness that falls with the amplitude, k(A) = k_0 - k_1 A, is read by least squares as

    $$\frac{\langle k(A)\,A^2\rangle}{\langle A^2\rangle}
      = k_0 - k_1 \frac{\langle A^3\rangle}{\langle A^2\rangle}$$

    so that the reading lies on the backbone at this amplitude. For noise, whose amplitudes follow a
    Rayleigh distribution, it is $3\sqrt{\pi/8} = 1.88$ times the rms.

    Reference:
        k = <F y> / <y^2>: Caughey (1963), J. Acoust. Soc. Am. 35, 1706.
    """
    size = np.abs(envelope)
    return float(np.sum(size**3) / np.sum(size**2))


def curves_of_points(test: Test) -> list[ControlledCurve]:
    """Return the points of every record of a controlled test, without lost points."""
    held = test.locked_phase if test.traits.is_locked else float("nan")
    curves = [controlled_curve(record, held) for record in test.records]
    return [curve.at(curve.valid) for curve in curves]


def readings_of_points(test: Test, gain: float | None) -> list[Reading]:
    r"""Return frequency and damping at the amplitude of each point of a controlled test.

    The force per mass is g F, where g is `gain`:

    $$\omega_r^2 = \omega^2 + \frac{g F \cos\varphi}{Y}, \qquad
      2\zeta\,\omega_r\,\omega = -\frac{g F \sin\varphi}{Y}$$

    Raises:
        DataError: Force or phase was not measured, or `gain` [1/kg] is not known.
    """
    curves = curves_of_points(test)
    if any(curve.force is None or curve.phase is None for curve in curves):
        raise DataError(
            f"Test {test.name} needs a measured force and the phase relative to the force, but "
            "lacks "
            "one of the two."
        )
    if gain is None:
        raise DataError(messages.STATE_MASS)
    return [reading for curve in curves for reading in _readings(curve, gain)]


def _readings(curve: ControlledCurve, gain: float) -> Iterator[Reading]:
    force, phase = np.asarray(curve.force), np.asarray(curve.phase)
    omega, pull = 2 * np.pi * curve.freq_hz, gain * force / curve.amplitude
    squared = omega**2 + pull * np.cos(phase)
    natural = np.sqrt(np.where(squared > 0, squared, np.nan))
    damping = -pull * np.sin(phase) / (2 * natural * omega)
    is_finite = np.isfinite(natural)
    rows = (curve.amplitude[is_finite], natural[is_finite] / (2 * np.pi), damping[is_finite])
    yield from map(Reading, *(row.tolist() for row in rows))


def locked_sentence(test: Test) -> str:
    """Return a sentence on how the frequency depends on amplitude at the held phase."""
    curve = curves_of_points(test)[0]
    order = np.argsort(curve.amplitude)
    y, hz = 1e3 * curve.amplitude[order], curve.freq_hz[order]
    return messages.held_phase(test.name, test.locked_phase, (y[0], y[-1]), (hz[0], hz[-1]))
