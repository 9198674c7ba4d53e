"""Checks whether records of tones, curves, loops and decays fit what their campaign file states."""

import warnings
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.ndimage import maximum_filter1d

from jbw.errors import DataError, JbwError
from jbw.measurement.channels import Reals, lines_within
from jbw.measurement.curves import ForcedLoop, MeasuredCurve, displacement_of
from jbw.measurement.demodulation import FEWEST_VALUES, band_filter
from jbw.measurement.faults.fault import Fault, doubt, refusal
from jbw.measurement.harmonics import NOISE_FLOOR, Harmonics, harmonics
from jbw.measurement.records import INPUTS, Record
from jbw.measurement.resonances import DrivenLines, driven_lines, read_lines
from jbw.quantities import derivative_order
from jbw.report.messages import decay_faults as decay_messages
from jbw.report.messages import response_faults as messages
from jbw.report.messages.message import first_of

THIRD = 3  # highest harmonic order that is checked
LISTED = 6  # largest number of tones that a message names
ALONG = 0.3  # correlation of force and displacement below which the force may be friction alone
DEGREES = 20.0  # [rad]; a phase beyond three full turns was probably written in degrees
FEWEST_LINES = 4
LOCKED = 0.2  # largest variation of a phase that a controller holds [rad]
LIKE = 2.0  # largest factor between a stated level and the peak or rms of its channel
NO_LEVEL = ("frequency", "phase", "time")
# Lines within this fraction of the strongest line's frequency, to either side, belong to it.
ABOUT = 0.2
WIDEST = 0.5  # largest half width of a band, relative to the frequency of its line
# smallest height of another peak relative to the strongest line, and number of lower lines on each
# side of a peak
OTHER, PEAK_LINES = 3e-3, 2
SURE = 3.0  # standard deviations of the noise's power
# largest fraction of a displacement's power that a single oscillator does not explain
ELSEWHERE = 0.1
# A line stands out if it exceeds the median around it by this factor; the largest of 1000 lines of
# noise reaches 3.2.
STANDS_OUT = 5.0
FEW = 256  # A displacement with fewer samples was probably read from a chart.
PERIODS = 8  # smallest number of periods in a record for a line to count as a mode
WIDENED = (1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0)  # factors by which a proposed band is widened
LOWEST = 0.2  # smallest lower edge of a band, relative to its centre
DECAYED = 0.9  # largest ratio of a decay's last quarter to its first; more is no decay


def unsteady(
    record: Record, tones_hz: Sequence[float], settle: float, dwell: float | None
) -> Iterator[Fault]:
    """Yield faults of tones or steps that are not steady or have a weak third harmonic."""
    y, role, fs = record.channels[record.response], record.response, record.fs
    fitted, refused = [], []
    for i, tone in enumerate(tones_hz):
        part, others = y, tones_hz
        if dwell is not None:
            part, others = y[round(i * dwell * fs) : round((i + 1) * dwell * fs)], ()
        # A harmonic of one tone may coincide with another tone, which is then fitted only once.
        others = [f for f in others if all(abs(f - n * tone) > 1e-6 * tone for n in (1, 2, THIRD))]
        omega, also = 2 * np.pi * tone, [2 * np.pi * f for f in others]
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # A drift is reported as a fault, not as a warning.
                fitted.append(
                    harmonics(part, fs, omega, THIRD, response=role, start=settle, also=also)
                )
        except JbwError as error:
            what = f"Tone {tone:.4g} Hz: {error.what}"
            refused.append(refusal(role, what, error.why, error.remedy))
    yield from refused[:1]
    if drifting := [fit for fit in fitted if fit.is_drifting]:
        largest = max(float(fit.drift) for fit in drifting)
        yield doubt(role, *messages.drifting(_named(drifting), largest))
    # The third harmonic is used only in probing tests, whose tones sound at the same time.
    third = [(abs(fit.amplitudes[-1]), float(np.sqrt(fit.variance[-1] / 2))) for fit in fitted]
    buried = [i for i, (size, std) in enumerate(third) if size < NOISE_FLOOR * std]
    if buried and dwell is None:
        size, std = third[buried[0]]
        yield doubt(role, *messages.buried_harmonic(_named([fitted[i] for i in buried]), size, std))


def _named(fitted: Sequence[Harmonics]) -> str:
    return f"Tone {first_of([f'{fit.omega / (2 * np.pi):.4g} Hz' for fit in fitted], LISTED)}"


def impassive(curve: MeasuredCurve) -> Iterator[Fault]:
    """Yield faults of sign or unit: work -pi F Im Y that is not positive, or a phase that rises."""
    role = curve.response_kind
    if len(curve.freq_hz) < FEWEST_LINES:
        yield refusal(role, *messages.few_lines(len(curve.freq_hz), FEWEST_LINES))
        return
    if np.all(np.angle(curve.response) == 0):
        yield doubt("phase", *messages.NO_PHASE)
        return
    if curve.source_kind == "force" and not np.all(curve.source > 0):
        yield refusal(curve.source_kind, *messages.NEGATIVE_AMPLITUDE)
    phase = np.unwrap(np.angle(curve.response[np.argsort(curve.freq_hz)]))
    if np.ptp(phase) < LOCKED:
        yield doubt(role, *messages.locked_phase(np.degrees(phase.mean())))
        return
    falls = phase[-1] < phase[0]
    upright = curve if falls else curve._replace(response=np.conj(curve.response))
    # The sum contains all lines; those at the resonance decide its sign.
    takes_in = np.sum(-np.imag(displacement_of(upright)) * curve.source) > 0
    turn = f"scale = {{ {role} = -1.0 }}"
    wrong = [] if falls else [(messages.RISING_PHASE, "`conjugate = true`")]
    wrong += [] if takes_in else [(messages.GIVES_ENERGY, f"`{turn}`")]
    if wrong:
        doubts, keys = zip(*wrong, strict=True)
        yield doubt(role, *messages.active(doubts, keys))


def phase_in_degrees(phase: Reals) -> Iterator[Fault]:
    """Yield a warning if a phase that is stated in radians appears to be in degrees."""
    largest = float(np.nanmax(np.abs(phase)))  # masked lines are NaN
    if largest > DEGREES:
        yield doubt("phase", *messages.in_degrees(largest))


def gives_energy(loop: ForcedLoop) -> Iterator[Fault]:
    """Yield a fault if a sign is probably wrong: force falls with displacement or supplies energy.

    A force that rises with the displacement but supplies energy is delayed instead.
    """
    y, force = loop.displacement, loop.force
    if not np.ptp(y) or not np.ptp(force):
        return
    rises = float(np.corrcoef(y, force)[0, 1])
    work = float(np.trapezoid(force, y))
    stored = float(np.ptp(force) * np.ptp(y)) / 8  # largest energy that a spring can store
    if rises < -ALONG or (rises < ALONG and work <= -stored):
        yield doubt("displacement", *messages.loop_turned(rises, work))


def undecaying(record: Record, settle: float) -> Iterator[Fault]:
    """Yield a warning if a free decay does not decay from its first to its last quarter."""
    x = record.channels[record.response][round(settle * record.fs) :]
    quarter = len(x) // 4
    if quarter == 0:
        return
    first, last = (float(np.std(part)) for part in (x[:quarter], x[len(x) - quarter :]))
    if last > DECAYED * first:
        times = last / first if first else np.inf
        yield doubt(record.response, *messages.undecaying(times))


def level_unlike(record: Record, level: float) -> Iterator[Fault]:
    """Yield a warning if a stated level is far from the peak and rms values of all channels."""
    seen = {}
    for role, samples in record.channels.items():
        x = np.abs(samples[np.isfinite(samples)])
        if role not in NO_LEVEL and x.size:
            seen[role] = float(x.max()), float(np.sqrt(np.mean(x**2)))
    if not level > 0 or not seen:
        return
    if any(1 / LIKE <= size / level <= LIKE for sizes in seen.values() for size in sizes):
        return
    role = next((role for role in INPUTS if role in seen), record.response)
    peak, rms = seen[role]
    yield doubt(role, *messages.unlike_level(level, role, peak, rms, record.units.get(role, "")))


def bandless(record: Record, settle: float) -> Iterator[Fault]:
    """Yield an error for a free decay without `band`; propose a band about its strongest line."""
    remedy = messages.STATE_BAND
    if record.num_samples - settle * record.fs > 2 * PERIODS:
        low, high = band_about_peak(record, settle)
        remedy = messages.put_band(low, high)
    yield refusal(record.response, *messages.without_band(remedy))


def several_resonances(record: Record) -> Iterator[Fault]:
    """Yield a warning if a driven record without a stated band contains several modes.

    The criterion is the power away from the strongest line, less the power that one oscillator has
    there under the same source.
    """
    try:
        lines = driven_lines(record)
        mode = read_lines(lines)
    except JbwError:
        return
    hz, power = lines.omega / (2 * np.pi), np.abs(lines.y) ** 2
    peak = float(hz[np.argmax(power * lines.omega**2)])
    noise = _white_noise(lines, derivative_order(record.response))
    ratio = hz / mode.frequency_hz
    of_mode = np.abs(lines.source / (1 - ratio**2 + 2j * mode.damping * ratio)) ** 2
    outside = ~lines_within(hz, _around_line(peak))
    # The power outside the band is uncertain, because the power of a single line of noise varies.
    total = max(np.sum(power - noise), power.max())
    least = np.sum((power - noise)[outside]) - SURE * np.linalg.norm(noise[outside])
    expected = np.sum(of_mode[outside]) / np.sum(of_mode)
    elsewhere = min(float(least / total), 1.0)
    if elsewhere - expected > ELSEWHERE:
        low, high = _in_two_digits(_around_line(peak))
        yield doubt(record.response, *messages.several_modes(elsewhere, low, high))


def _white_noise(lines: DrivenLines, order: int) -> Reals:
    """Return the power of white noise in each line of displacement; `order` is the derivative.

    Second differences of the ratio of response to drive contain noise and hardly any mode. The mean
    power of lines of noise is their median over ln 2.
    """
    ratio = lines.y / lines.source
    apart = (ratio[2:] - 2 * ratio[1:-1] + ratio[:-2]) * lines.source[1:-1]
    measured = np.abs(apart * lines.omega[1:-1] ** order) ** 2 / 6
    return np.median(measured) / np.log(2) / lines.omega ** (2 * order)


def _around_line(peak_hz: float) -> tuple[float, float]:
    """Return the limits [Hz] of the band around a peak in which all lines belong to the peak."""
    return (1 - ABOUT) * peak_hz, (1 + ABOUT) * peak_hz


def _in_two_digits(band_hz: tuple[float, float]) -> tuple[float, float]:
    """Round a band [Hz] to two digits for a proposal (not for computations)."""
    return float(f"{band_hz[0]:.2g}"), float(f"{band_hz[1]:.2g}")


def band_about_peak(
    record: Record, settle: float = 0.0, *, within: tuple[float, float] | None = None
) -> tuple[float, float]:
    """Return a band [Hz] about a record's strongest line, as a proposal rounded to two digits."""
    return _in_two_digits(about_peak(record, settle, within=within))


def about_peak(
    record: Record, settle: float = 0.0, *, within: tuple[float, float] | None = None
) -> tuple[float, float]:
    """Return a band [Hz] about a displacement's strongest line, limited by neighbouring lines.

    A filter of a narrow band takes long to settle, which costs the strongest part of a decay. The
    band therefore reaches half way to the nearest other line, but at most half of the line's
    frequency to either side.

    The line is searched `within` a band of frequencies [Hz] where this is given and contains lines,
    and among lines that stand out of their surroundings: noise of an acceleration is a large
    displacement at low frequencies.
    """
    freq, size, lowest = _lines(record, settle)
    every, standing = size.T
    if within is not None and np.any(inside := lines_within(freq, within)):
        every, chosen = np.where(inside, every, 0.0), np.where(inside, standing, 0.0)
    else:
        chosen = standing
    strongest = chosen if np.any(chosen[lowest:] > 0) else every
    peak = float(freq[lowest + np.argmax(strongest[lowest:])])
    near = _around_line(peak)
    is_peak = standing == maximum_filter1d(standing, 2 * PEAK_LINES + 1)
    others = freq[is_peak & (standing > OTHER * strongest.max()) & ~lines_within(freq, near)]
    below, above = others[others < peak], others[others > peak]
    low = np.sqrt(below[-1] * peak) if len(below) else 0.0
    high = np.sqrt(above[0] * peak) if len(above) else np.inf
    return max(low, (1 - WIDEST) * peak), min(high, (1 + WIDEST) * peak, 0.95 * record.fs / 2)


def height_within(record: Record, band: tuple[float, float]) -> float:
    """Return the highest spectral peak in a band, relative to the highest of the whole record."""
    freq, size, lowest = _lines(record, 0.0)
    standing = size[lowest:, 1]
    inside = lines_within(freq[lowest:], band)
    most = float(np.max(standing, initial=0.0))
    return float(np.max(standing[inside], initial=0.0)) / most if most else 0.0


def _lines(record: Record, settle: float) -> tuple[Reals, Reals, int]:
    """Return frequencies [Hz], all lines, only prominent lines, and the first reliable index.

    The first reliable line is above the lines of a drifting mean. A record of a few points, as read
    off a chart, may contain only two or three periods; a straight line is then subtracted instead,
    and lower lines are reliable.
    """
    x = record.channels[record.response][round(settle * record.fs) :]
    x = np.where(np.isfinite(x), x, 0.0) - np.nanmean(x)
    lowest = min(PERIODS - 1, max(len(x) // 2 - 1, 0))
    if len(x) < FEW and derivative_order(record.response) == 0:
        place = np.arange(len(x))
        x = x - np.polyval(np.polyfit(place, x, 1), place)
        lowest = min(2, lowest)
    freq = np.fft.rfftfreq(len(x), 1 / record.fs)[1:]
    # Lines are compared as displacements, in which the joint's mode is strongest.
    measured = np.abs(np.fft.rfft(x * np.hanning(len(x)))[1:])
    size = measured / freq ** derivative_order(record.response)
    stands_out = measured > STANDS_OUT * _around(freq, measured)
    return freq, np.stack([size, np.where(stands_out, size, 0.0)], axis=1), lowest


def _around(freq: Reals, size: Reals) -> Reals:
    """Return the median of the spectral lines around each frequency, in bands of ratio 1.5."""
    edges = np.geomspace(freq[0], freq[-1], 2 + int(np.log(freq[-1] / freq[0]) / np.log(1.5)))
    parts = np.searchsorted(edges, freq, side="right")
    masks = [parts == part for part in np.unique(parts)]
    middles, medians = [np.mean(freq[x]) for x in masks], [np.median(size[x]) for x in masks]
    return np.interp(freq, middles, medians)


def too_short(record: Record, band: tuple[float, float], settle: float) -> Iterator[Fault]:
    """Yield an error if a record's band contains too few independent values."""
    size = record.num_samples - round(settle * record.fs)
    count = _num_values(band, size, record.fs)
    if count >= FEWEST_VALUES:
        return
    centre, half = (band[0] + band[1]) / 2, (band[1] - band[0]) / 2
    wider = (
        (float(f"{centre - k * half:.3g}"), float(f"{centre + k * half:.3g}")) for k in WIDENED
    )
    enough = (
        (low, high)
        for low, high in wider
        if LOWEST * centre < low < high < record.fs / 2
        and _num_values((low, high), size, record.fs) >= FEWEST_VALUES
    )
    narrowest = next(enough, None)
    remedy = decay_messages.put_wider_band(*narrowest) if narrowest else decay_messages.LONGER
    length = size / record.fs, size / record.fs * centre
    fault = decay_messages.few_values(count, FEWEST_VALUES, band, length, remedy)
    yield refusal(record.response, *fault)


def _num_values(band: tuple[float, float], size: int, fs: float) -> int:
    """Return the number of independent envelope values of a record in a band."""
    try:
        chosen = band_filter(band, fs)
    except DataError:  # no record resolves the band
        return 0
    return max(0, -(-(size - 2 * chosen.half) // chosen.step))
