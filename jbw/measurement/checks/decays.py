r"""Whether a record is the free decay that its test says: the blow, the drive, lines, the window.

All is read off the envelope X of the band, by values that white noise leaves almost independent,
each compared with the noise that these leave: no finding depends on a scale of time or of length.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from scipy.signal import ShortTimeFFT
from scipy.signal.windows import blackmanharris
from scipy.stats import chi2

from jbw.errors import DataError
from jbw.measurement.breaks import breaks_of
from jbw.measurement.channels import Reals, whole_up
from jbw.measurement.checks.faults import Fault, doubt, refusal
from jbw.measurement.checks.responses import about_peak, undecaying
from jbw.measurement.demodulation import band_filter, decay_steps, demodulate
from jbw.measurement.records import Record
from jbw.measurement.spans import left_out_from
from jbw.report.messages import decay_faults as messages

FEWEST_VALUES = 16  # of an envelope, before anything is said of it
WIDENED, LOWEST = (
    (1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0),
    0.2,
)  # times a band, and of its centre at least
QUIET, LOUD = 0.1, 0.5  # of the largest response, before a blow and within a period after it
FLAT = 0.05  # change of log X while a shaker holds the motion
FALLS = 0.3  # change of log X in the time after it, as long as the held one, at the least
TIMES_FLAT = 12.0  # of that change over the held one; at the top of a beat it is 8
SURE = 8.0  # standard deviations: of some thousand places at which a record is looked at
JUMP = 0.15  # of log X [-] or phase [rad] across a blow: less matters to no fit
SIDE = 7  # values on each side of a blow
CUBIC = 4  # coefficients of log X on both sides of it together
SMOOTH = 4.0  # a jump over what the cubic leaves on its sides
CLEAN = 0.1  # of log X, left by the cubic: more is noise, whose phase turns anyhow
SAME = 0.9  # of the largest jump, at neighbouring places
MATTERS = 0.03  # of the largest response, on one side of a jump at the least
MOST_LINES = 4  # of a late part of an envelope: hum, the mode and what it becomes as it stiffens
LEAST_OF_LINES = 10  # values, before lines are looked for
WORTH_A_LINE = 0.7  # of the variance that is left: what a further line must come below
SHORTEST = 0.1  # modulus of a pole: what decays faster in a value is none
SLOWER = 0.15  # of the mode's own decay rate, for a line to be none of the structure's
STEADY = 0.05  # of that rate: a line that decays faster belongs to another mode
SPOILS = 0.01  # of the largest response: a line by which readings a decade below it are off by 10 %
LINE = 2e-3  # of the largest response: a weaker line matters to no reading
FRAMES, LINES_OF_NOISE = 10, 10  # in time and in frequency, at the least, for the noise's course
APART = 3  # lines between two that a Blackman-Harris window leaves independent
GROUPS, LEAST_OF_GROUP = 4, 5  # of frequencies, in which noise under a window falls alike; of lines
SCATTERED = 0.67  # lower quartile of the noise's lines over their median, at the most
ALIKE = 1e-3  # probability of the scatter between them and along time, at the least


class Course(NamedTuple):
    """The envelope of a record in its band.

    Attributes:
        log: Its logarithm, log |X| + j arg X without jumps, turned by `turn` a value.
        time: Of its values since the record's start [s].
        half_s: Time that the filter reaches to either side [s].
        across: Values between which a sudden change is spread.
        centre_hz: Frequency that became zero [Hz].
        outside_hz: Below and above these the filter leaves nothing [Hz].
        turn: Phase between two values that was taken out [rad].
    """

    log: Complex[np.ndarray, " value"]
    time: Float[np.ndarray, " value"]
    half_s: float
    across: int
    centre_hz: float
    outside_hz: tuple[float, float]
    turn: float

    @property
    def size(self) -> Reals:
        """Logarithm of the modulus, log |X|."""
        return np.real(self.log)

    @property
    def step_s(self) -> float:
        """Time between two values [s]."""
        return float(self.time[1] - self.time[0])


def course_of(record: Record, band: Sequence[float] | None, settle: float) -> Course | None:
    """The envelope of a record after `settle`; None where it is too short to be looked at."""
    x = record.channels[record.response][round(settle * record.fs) :]
    if len(x) < FEWEST_VALUES or not np.any(x):
        return None
    low, high = band or about_peak(record, settle)
    if not 0 < low < high < record.fs / 2:
        return None
    try:
        chosen = band_filter((low, high), record.fs)
        time, envelope = demodulate(x - np.mean(x), chosen)
    except DataError:
        return None
    time, envelope = time[:: chosen.step], envelope[:: chosen.step]
    if len(time) < FEWEST_VALUES or not np.all(np.abs(envelope) > 0):
        return None
    steps = envelope[1:] * np.conj(envelope[:-1])
    turn = float(np.angle(np.sum(steps)))
    level = envelope * np.exp(-1j * turn * np.arange(len(envelope)))
    log = np.log(np.abs(level)) + 1j * np.unwrap(np.angle(level))
    across = -(-chosen.half // chosen.step)
    half_s = chosen.half / record.fs
    outside = (1.5 * low - 0.5 * high, 1.5 * high - 0.5 * low)
    return Course(log, settle + time, half_s, across, chosen.centre_hz, outside, turn)


def too_short(record: Record, band: tuple[float, float], settle: float) -> Iterator[Fault]:
    """The refusal of a record that holds too few independent values in its band."""
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
    remedy = messages.put_wider_band(*narrowest) if narrowest else messages.LONGER
    length = size / record.fs, size / record.fs * centre
    fault = messages.few_values(count, FEWEST_VALUES, band, length, remedy)
    yield refusal(record.response, *fault)


def _num_values(band: tuple[float, float], size: int, fs: float) -> int:
    """Independent values that a record of some samples has in a band."""
    try:
        chosen = band_filter(band, fs)
    except DataError:  # a band that no record resolves
        return 0
    return max(0, -(-(size - 2 * chosen.half) // chosen.step))


def not_free(record: Record, band: Sequence[float] | None, settle: float) -> Iterator[Fault]:
    """What makes a record another than one free decay from its start, the first cause alone."""
    course = course_of(record, band, settle)
    if course is None:
        yield from undecaying(record, settle)
        return
    for finding in (late_blow, still_driven):
        if faults := list(finding(record, course)):
            yield from faults
            return
    if faults := list(undecaying(record, settle)):
        yield from faults
        return
    yield from second_blow(record, course)
    yield from steady_line(record, course)
    yield from windowed(record, course)


def late_blow(record: Record, course: Course) -> Iterator[Fault]:
    """The refusal of a record that begins before its blow."""
    begins = course.time[0] - course.half_s
    onset = _onset(record.channels[record.response], record.fs, begins, course.centre_hz)
    if onset is None:
        size = course.size
        peak = int(np.argmax(size))
        # A beat of two modes rises as well, but not within a filter's length out of quiet.
        before = size[: max(peak - course.across, 0)]
        if len(before) <= course.across or before.max() > size[peak] + np.log(QUIET):
            return
        onset = float(course.time[peak])
    yield refusal(
        record.response,
        *messages.late_blow(onset - begins, begins, _rounded_up(onset + 1 / course.centre_hz)),
    )


def _onset(x: Reals, fs: float, begins: float, centre_hz: float) -> float | None:
    """Time at which a quiet record turns loud within a period of the mode [s]."""
    first, period = round(begins * fs), whole_up(fs / centre_hz)
    size = np.abs(x[first:] - np.median(x[first:]))
    size = size / size.max()
    blow = int(np.argmax(size > QUIET))
    if blow < period or size[blow : blow + period].max() < LOUD:
        return None
    return begins + blow / fs


def still_driven(record: Record, course: Course) -> Iterator[Fault]:
    """The refusal of a record that begins with steady motion and decays later."""
    size = course.size
    best = None
    for held in range(course.across, (len(size) - course.across) // 2 + 1):
        steady, after = size[:held], size[held + course.across : 2 * held + course.across]
        flat = float(np.ptp(steady))
        if flat > FLAT:
            break
        fall = float(after[0] - after[-1])
        if fall > FALLS and fall > TIMES_FLAT * flat:
            best = held
    if best is None:
        return
    # The largest part that is flat ends where the drive does.
    end = course.time[best - 1] + 2 * course.half_s
    yield refusal(record.response, *messages.still_driven(course.time[best - 1], _rounded_up(end)))


def second_blow(record: Record, course: Course) -> Iterator[Fault]:
    """The doubt that a decay is interrupted: by a second blow, or because samples are missing."""
    jumps = _jumps(course)
    if not jumps:
        yield from interrupted(record, course)
        return
    jump = max((pair[1] for pair in jumps), key=abs)
    # Places between the same sides see the same jump; it lies in their middle.
    at = float(np.mean([time for time, other in jumps if abs(other) > SAME * abs(jump)]))
    remedy, grows = left_out_from(record, at), jump.real > JUMP
    yield doubt(record.response, *messages.second_blow(at, abs(jump), remedy, grows=grows))


def interrupted(record: Record, course: Course) -> Iterator[Fault]:
    """The doubt that a sample does not follow from those before it, as of any sum of modes it does.

    It sees what an envelope smears: a fifth of a period that is missing, a blow next to another.
    """
    start = round(float(course.time[0] - course.half_s) * record.fs)
    x = record.channels[record.response][start:]
    period = record.fs / course.centre_hz
    broken = breaks_of(x - np.mean(x), period)
    if not broken:
        return
    at = (start + broken[0]) / record.fs
    yield doubt(record.response, *messages.interrupted(at, left_out_from(record, at)))


def _jumps(course: Course) -> list[tuple[float, complex]]:
    """Times at which log X jumps between two smooth sides [s], and by how much."""
    gap, jumps = course.across, []
    width = 2 * SIDE + gap
    x = np.arange(width) - (width - 1) / 2
    sides = np.abs(x) > gap / 2
    x = x[sides] / x.max()
    design = np.column_stack([*(x**power for power in range(CUBIC)), np.sign(x) / 2])
    solve = np.linalg.pinv(design)
    # Standard error of the jump for residuals of unit variance.
    error = float(np.linalg.norm(solve[-1]))
    for first in range(len(course.log) - width + 1):
        values = course.log[first : first + width][sides]
        fitted = solve @ values
        residual = values - design @ fitted
        std = np.linalg.norm(residual) / np.sqrt(len(values) - CUBIC - 1)
        # A phase is known up to whole turns.
        jump = complex(fitted[-1].real, np.angle(np.exp(1j * fitted[-1].imag)))
        matters = np.real(values).max() > course.size.max() + np.log(MATTERS)
        if matters and std < CLEAN and abs(jump) > max(JUMP, SURE * error * std, SMOOTH * std):
            jumps.append((float(course.time[first + width // 2]), jump))
    return jumps


class Line(NamedTuple):
    """A line of an envelope: its turn a value [rad], its amplitude, decay a value, and errors."""

    turn: float
    amplitude: float
    rate: float
    amplitude_error: float
    rate_error: float


def steady_line(record: Record, course: Course) -> Iterator[Fault]:
    """The doubt, or refusal where it is strong, of a line in the band that does not decay."""
    envelope = np.exp(course.log)
    half, quarter = (envelope[len(envelope) * part // 4 :] for part in (2, 3))
    largest, middle = float(np.abs(envelope).max()), len(envelope) // 2
    # Two modes beat, and fall steeply at times: the fall to the middle of the record counts too.
    fallen = np.log(largest / np.median(np.abs(envelope[middle - 2 : middle + 3]))) / middle
    decay_rate = min(_first_fall(course.size), float(fallen))
    for values in (half, quarter):
        for line in _lines_of(values):
            share = line.amplitude / largest
            steady = abs(line.rate) < STEADY * decay_rate + 3 * line.rate_error
            slower = line.rate + 3 * line.rate_error < SLOWER * decay_rate
            sure = line.amplitude > SURE * line.amplitude_error
            if not (steady and slower and sure and share > LINE):
                continue
            hz = _frequency_of(line.turn + course.turn, record, course)
            # As many digits as tell its place among the lines of the record's spectrum.
            digits = max(4, 1 + int(np.ceil(np.log10(hz * record.num_samples / record.fs))))
            named = f"{hz:.{digits}g}"
            yield (refusal if share > SPOILS else doubt)(
                record.response, *messages.steady_line(named, share)
            )
            return


def _first_fall(log_size: Reals) -> float:
    """Rate of the fall to 1/e, a value: what lies under a decay has not come out of it by then."""
    start = int(np.argmax(log_size))
    low = np.flatnonzero(log_size[start:] < log_size[start] - 1.0)
    fall = log_size[start : start + max(int(low[0]) + 1, SIDE) if low.size else len(log_size)]
    return max(-float(np.polyfit(np.arange(len(fall)), fall, 1)[0]), 0.0) if len(fall) > 1 else 0.0


def _frequency_of(turn: float, record: Record, course: Course) -> float:
    """Frequency of a line that turns so much a value [Hz], of those that do the one that is there.

    Values are as far apart as the band is wide: at its edges they cannot tell one from the other.
    """
    apart = 1 / course.step_s
    near = course.centre_hz + (turn / (2 * np.pi) + np.arange(-1, 2)) * apart
    low, high = course.outside_hz
    near = near[(near > low) & (near < high)]
    x = record.channels[record.response]
    x = x[len(x) // 2 :] * np.hanning(len(x) - len(x) // 2)
    phase = 2j * np.pi / record.fs * np.arange(len(x))
    return float(max(near, key=lambda hz: abs(np.sum(x * np.exp(-phase * hz)))))


def _lines_of(values: Complex[np.ndarray, " value"]) -> list[Line]:
    r"""Lines among values that noise leaves independent, the strongest at their end first.

    $$v_k = \sum_j c_j z_j^k$$

    by the matrix pencil, of as many lines as improve it: the mode has not gone where hum shows.
    """
    count = len(values)
    if count < LEAST_OF_LINES:
        return []
    pencil = count // 3
    hankel = np.lib.stride_tricks.sliding_window_view(values, count - pencil).T
    scale = np.abs(values).max()
    basis = np.linalg.svd(hankel / scale, full_matrices=False)[0]
    best: tuple[float, list[Line]] = (np.inf, [])
    for number in range(1, min(MOST_LINES, count // 4) + 1):
        shifted = np.linalg.lstsq(basis[:-1, :number], basis[1:, :number])[0]
        poles = np.linalg.eigvals(shifted)
        if not np.all((np.abs(poles) > SHORTEST) & (np.abs(poles) < 1 / SHORTEST)):
            break
        k = np.arange(count)
        modes = poles[None, :] ** k[:, None]
        sizes = np.linalg.lstsq(modes, values)[0]
        residual = values - modes @ sizes
        variance = float(np.sum(np.abs(residual) ** 2)) / (count - 2 * number)
        # Of sizes and of logarithms of poles, complex and linear about the fit.
        slopes = np.concatenate([modes, k[:, None] * modes * sizes], axis=1)
        errors = np.sqrt(variance * np.abs(np.diag(np.linalg.pinv(slopes.conj().T @ slopes))) / 2)
        logs = np.log(poles)
        middle = np.exp(np.real(logs) * (count - 1) / 2)
        lines = [
            Line(float(log.imag), float(abs(size) * part), float(-log.real), float(error * part),
                 float(off))
            for log, size, part, error, off in zip(
                logs, sizes, middle, errors[:number], errors[number:], strict=True)
        ]  # fmt: skip
        lines.sort(key=lambda line: -line.amplitude * np.exp(-line.rate * count / 2))
        if variance < WORTH_A_LINE * best[0]:
            best = variance, lines
    return best[1]


def windowed(record: Record, course: Course) -> Iterator[Fault]:
    r"""The doubt that a record was multiplied by exp(-t/tau): its noise decays as well.

    $$\log P(t, f) = c(f) - 2 t / \tau$$

    of the noise outside the band, alike at all frequencies and to the record's end.
    """
    constant_and_error = noise_time_constant(record, course)
    if constant_and_error is None:
        return
    tau, error = constant_and_error
    yield doubt(record.response, *messages.windowed(tau, error))


def noise_time_constant(record: Record, course: Course) -> tuple[float, float] | None:
    """Time constant tau of the noise outside the band, and its error [s]; None where steady."""
    start = round(float(course.time[0] - course.half_s) * record.fs)
    x = record.channels[record.response][start:]
    size = len(x) // (2 * FRAMES)
    if size < LINES_OF_NOISE:
        return None
    window = blackmanharris(2 * size, sym=False)
    transform = ShortTimeFFT(window, size, record.fs)
    spectra = np.abs(transform.stft(x - np.mean(x))) ** 2
    complete_frames = slice(transform.lower_border_end[1], transform.upper_border_begin(len(x))[1])
    spectra, time = spectra[:, complete_frames], transform.t(len(x))[complete_frames]
    low, high = course.outside_hz
    outside = (transform.f < low) | (transform.f > high)
    spectra = spectra[outside][1:-1:APART]
    if len(spectra) < LINES_OF_NOISE or spectra.shape[1] < FRAMES // 2 or not spectra.min() > 0:
        return None
    groups = np.array_split(spectra, min(GROUPS, len(spectra) // LEAST_OF_GROUP))
    logs = np.array([np.log(np.median(group, axis=0)) for group in groups])
    count = len(spectra) // len(groups)
    # The median of n exponential variables has the relative variance 1 / (n ln^2 2).
    variance = 1 / (count * np.log(2) ** 2)
    # Noise scatters about its median; the skirt of a strong line is smooth. Low values tell:
    # the lower quartile of an exponential variable is 0.415 of its median.
    low = np.array([np.log(np.quantile(group, 0.25, axis=0)) for group in groups])
    if np.mean(low - logs) > np.log(SCATTERED):
        return None
    # Frames overlap by half: every second is independent.
    logs, time = logs[:, ::2], time[::2]
    fall = _fall_of(logs, time, variance)
    if fall.unlike < ALIKE:
        # Of few lines those that other modes stand in are more than a median passes over.
        modal = int(np.argmax([group.max() for group in groups]))
        fall = _fall_of(np.delete(logs, modal, axis=0), time, variance)
    mode = 2 / (decay_steps(course.size) * course.step_s)
    if fall.unlike < ALIKE or not SURE * fall.error <= fall.rate <= 0.95 * mode:
        return None
    return 2 / fall.rate, 2 * fall.error / fall.rate**2


class _Fall(NamedTuple):
    """Fall of log P [1/s], its standard error, and how likely its misfit is by chance."""

    rate: float
    error: float
    unlike: float


def _fall_of(logs: Float[np.ndarray, "group frame"], time: Reals, variance: float) -> _Fall:
    """The one fall of all groups, whose values have a variance."""
    centred = time - time.mean()
    spread = float(np.sum(centred**2))
    rate = -float(np.mean(logs @ centred)) / spread
    misfit = logs - logs.mean(axis=1, keepdims=True) + rate * centred
    degrees = misfit.size - len(logs) - 1
    unlike = float(chi2.sf(float(np.sum(misfit**2)) / variance, degrees))
    return _Fall(rate, float(np.sqrt(variance / spread / len(logs))), unlike)


def _rounded_up(seconds: float) -> str:
    """A time to two digits, not below it."""
    unit = 10.0 ** (np.floor(np.log10(seconds)) - 1)
    return f"{np.ceil(seconds / unit * (1 - 1e-12)) * unit:.2g}"
