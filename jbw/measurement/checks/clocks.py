r"""Whether drive and response keep one time: a lag that stays, that grows, or that jumps.

A constant lag is a delay, one that grows along the record two clocks that run apart, and one that
jumps a block of samples that one channel lost. Along a sweep the lag shows away from the resonance,
where a structure's phase is known whatever its joint does,

$$\arg \frac{Y}{U} = -\omega\,\tau(t) - \frac{2\zeta\,r}{1 - r^2} - k\pi, \quad
  r = \omega / \omega_n$$

and in noise between parts of the record, whose FRFs are the same but for it. A block that a
response lost at its resonance, which leaves no phase to read, shows by the samples that do not
follow on.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.signal import hilbert
from scipy.stats import f as f_distribution

from jbw.errors import DataError
from jbw.measurement.breaks import MOST_A_PERIOD, breaks_of, turn_at
from jbw.measurement.channels import Reals
from jbw.measurement.checks.faults import Fault, doubt
from jbw.measurement.checks.responses import about_peak
from jbw.measurement.records import Record
from jbw.measurement.resonances import driven_lines, swept
from jbw.measurement.spans import kept_before
from jbw.measurement.spectra import averaged
from jbw.quantities import derivative_order
from jbw.report.messages import clock_faults as messages

TOGETHER = 3  # lines of a sweep's transform that one value of its phase is read over
PIECE = 16  # samples at least between two values of a sweep's frequency
ONE_WAY = 0.9  # of these that follow the direction of the sweep
AWAY = 0.08  # |1 - r^2| from where on the damping alone bends the phase
LOUD = 0.3  # of the drive's largest amplitude, where a phase is read
FEWEST = 12  # values of a phase, or of a lag
CERTAIN = 6.0  # standard errors of a lag along a sweep
ONE_MODE = 0.3  # scatter of log |Y/U| about that of one mode: more is of several
NEAR_HALF = 0.6  # [rad] about half a turn, which another mode makes
RIPPLED = 4.0  # a jump of the phase over what is left about it
ROUGH = 0.15  # [rad]; a phase that scatters by more is not that of one mode under a sweep
PARTS, AVERAGES = 8, 8  # of a record of noise, and of each of them
LEAST_PARTS = 2  # on each side of one in which the lag jumps
COHERENT = 0.5  # between response and drive in the mean, for a lag to be read
MOST_TURNS = 3  # half turns of the phase that are tried about its middle
ODDS = 1e-6  # that a lag of chance is called one
ONE_PLACE, MOST_PLACES = 2.0, 3  # periods of a break, and places of them: more is knocking
CUT_TURNS = 0.3  # [rad] at a cut, at the least: parts that knock turn the phase by less
ONE_TONE = 0.15  # of the rms on both sides of it, left by one tone: more is of several
TURNED = 0.05  # [rad] at the end of the record: a smaller error moves no damping


class Lag(NamedTuple):
    """How a response lags behind its drive along a record.

    Attributes:
        constant_s: At the start of the record [s], and its standard error.
        slope: Growth along it [s/s], and its standard error.
        step: Times between which it jumps, and by how much [s]; None where it does not.
        scatter_s: What is left about these [s].
    """

    constant_s: tuple[float, float]
    slope: tuple[float, float]
    step: tuple[float, float, float] | None
    scatter_s: float


def untimely(record: Record, delay: float, *, is_sweep: bool) -> Iterator[Fault]:
    """The doubt that drive and response of a record do not keep one time."""
    lag, hz = _lag_of(record, is_sweep=is_sweep)
    cut = _cut_of(record)
    if lag is not None and lag.step is not None and abs(lag.step[2]) > TURNED / (2 * np.pi * hz):
        before, after, jump = lag.step
        # To a sample where one shows the cut; a lag tells its size, whole periods as well.
        at, before = (cut.at_s, cut.before_s) if cut else (0.5 * (before + after), before)
        ahead = "ahead of" if jump < 0 else "behind"
        what = messages.response_jumps(abs(jump), ahead)
        yield _of_a_block(record, at, before, what)
    elif cut:
        what = messages.phase_jumps(cut.turn / (2 * np.pi))
        yield _of_a_block(record, cut.at_s, cut.before_s, what)
    elif lag is not None:
        yield from _lagging(record, lag, delay, TURNED / (2 * np.pi * hz), is_sweep=is_sweep)


def _lag_of(record: Record, *, is_sweep: bool) -> tuple[Lag | None, float]:
    """The lag along a record, None where it shows none, and the highest frequency of it [Hz]."""
    if is_sweep:
        course = _phase_of_sweep(record)
        if course is None:
            return None, 0.0
        return _lag_of_sweep(*course), float(np.max(course[1])) / (2 * np.pi)
    u, x = (record.channels[role] for role in (record.source, record.response))
    parts = _lags_of_noise(u, x, record.fs)
    if parts is None:
        return None, 0.0
    time, lags, hz = parts
    return _course(time, lags), hz


def _of_a_block(record: Record, at: float, before: float, what: str) -> Fault:
    """The doubt that a block is missing at a time, with a span that ends before it [s]."""
    keep = kept_before(record, before)
    return doubt(record.response, *messages.lost_block(at, what, keep))


class _Cut(NamedTuple):
    """Where a response was cut [s], a time before [s], and by how much its phase jumps [rad]."""

    at_s: float
    before_s: float
    turn: float


def _cut_of(record: Record) -> _Cut | None:
    """The worst cut of a response under a drive without any.

    At a resonance what a cut spreads over all lines leaves no phase to read a lag from.
    """
    low, high = about_peak(record)
    period = 2 * record.fs / (low + high)
    u, x = (record.channels[role] for role in (record.source, record.response))
    x = x - np.mean(x)
    broken = breaks_of(x, period)
    # A drive that jumps moves what it drives at once.
    if not broken or breaks_of(u - np.mean(u), period):
        return None
    apart = np.flatnonzero(np.diff(np.sort(broken)) > ONE_PLACE * period) + 1
    clusters = np.split(np.sort(broken), apart)
    # Parts that knock together break off every period, and hardly turn the phase.
    if len(clusters) > MOST_PLACES or max(map(np.ptp, clusters)) > ONE_PLACE * period:
        return None
    (worst,) = (place for place in clusters if broken[0] in place)
    cuts = _turns_about(x, int(worst[0]), int(worst[-1]), period)
    at, turn, residual = min(cuts, key=lambda cut: cut[2], default=(0, 0.0, np.inf))
    if abs(turn) < CUT_TURNS or residual > ONE_TONE:
        return None
    return _Cut(at / record.fs, (min(broken) - period) / record.fs, turn)


def _turns_about(
    x: Reals, first: int, last: int, period: float
) -> Iterator[tuple[int, float, float]]:
    """Samples about a place at which a tone may jump, its turn [rad] there, and what it leaves."""
    for at in range(first - int(period / MOST_A_PERIOD), last + 1):
        jump = turn_at(x, at, period)
        if jump is not None:
            yield at, *jump


def _lagging(
    record: Record, lag: Lag, delay: float, least: float, *, is_sweep: bool
) -> Iterator[Fault]:
    """The doubt that a lag grows along a record by more than `least` [s], or is not as stated."""
    length = record.num_samples / record.fs
    if abs(lag.slope[0]) * length > least:
        # A fast clock takes its samples early, so that they show what was before: a lag that grows.
        fast = "fast" if lag.slope[0] > 0 else "slow"
        yield doubt(
            record.response,
            *messages.another_clock(
                1e6 * abs(lag.slope[0]), fast, abs(lag.slope[0]) * length, 1e6 * lag.slope[0]
            ),
        )
    else:
        constant = lag if is_sweep else _constant_of_noise(record)
        yield from _delayed(record, constant, delay, least) if constant else ()


def _delayed(record: Record, lag: Lag, delay: float, least: float) -> Iterator[Fault]:
    """The doubt that a lag along the whole record is another than the campaign states."""
    seconds, error = lag.constant_s
    # What is fed in volts is held from sample to sample, which is half a sample of lag.
    held = 1 / record.fs if record.source == "input" else 0.0
    if abs(seconds - delay) > max(least, CERTAIN * error, held):
        way = "lags behind" if seconds > 0 else "leads"
        yield doubt(record.response, *messages.another_delay(way, abs(seconds), delay, seconds))


def _phase_of_sweep(record: Record) -> tuple[Reals, Reals, Reals, Reals] | None:
    """Time, frequency, phase of Y/U and bend of it by damping, away from the resonance.

    Of the transform of the whole record, in which what rings on after the resonance lies there; a
    line belongs to the time at which the drive passes it.
    """
    try:
        lines = driven_lines(record)
    except DataError:
        return None
    count = len(lines.omega) // TOGETHER * TOGETHER
    if count < FEWEST * TOGETHER:
        return None
    omega, source, y = (
        values[:count].reshape(-1, TOGETHER) for values in (lines.omega, lines.source, lines.y)
    )
    time = _time_of(record, omega.mean(axis=1))
    if time is None:
        return None
    receptance = np.sum(y * np.conj(source), axis=1) / np.sum(np.abs(source) ** 2, axis=1)
    omega = omega.mean(axis=1)
    away = _away(omega, receptance)
    if away is None:
        return None
    lines_away, phase, bend = away
    order = np.argsort(time[lines_away])
    return time[lines_away][order], omega[lines_away][order], np.unwrap(phase[order]), bend[order]


def _away(
    omega: Reals, receptance: Complex[np.ndarray, " line"]
) -> tuple[Int[np.ndarray, " kept"], Reals, Reals] | None:
    """Lines away from the one resonance, their phase, and its bend by damping; None of several."""
    natural = float(omega[np.argmax(np.abs(omega * receptance))])
    r = omega / natural
    lines_away = np.flatnonzero(np.abs(1 - r**2) > AWAY)
    if len(lines_away) < FEWEST:
        return None
    r = r[lines_away]
    # Of one mode the size falls off as 1 / (1 - r^2); of several the phase tells no lag.
    if np.std(np.log(np.abs(receptance[lines_away] * (1 - r**2)))) > ONE_MODE:
        return None
    phase = np.angle(receptance[lines_away] * np.where(r < 1, 1.0, -1.0))
    return lines_away, phase, 2 * r / (1 - r**2)


def _constant_of_noise(record: Record) -> Lag | None:
    """The lag of a whole record of noise, by its averaged FRF away from the resonance."""
    u, x = (record.channels[role] for role in (record.source, record.response))
    short = 2 * len(u) // (PARTS * (AVERAGES + 1))
    freq, power, response, cross = averaged(
        u, x, fs=record.fs, window="hann", nperseg=short, noverlap=short // 2
    )
    coherence = np.abs(cross) ** 2 / power / response
    lines = (freq > 0) & (coherence > COHERENT) & (power > LOUD * np.median(power[power > 0]))
    lines &= swept(power)
    omega = 2 * np.pi * freq[lines]
    order = derivative_order(record.response)
    away = (
        _away(omega, cross[lines] / power[lines] / (1j * omega) ** order) if lines.any() else None
    )
    if away is None:
        return None
    lines_away, phase, bend = away
    phase, design = np.unwrap(phase), np.column_stack([-omega[lines_away], -bend])
    # Half turns are the polarity of a channel: a lag turns the phase by as much as the frequency.
    nearest = np.round(np.median(phase) / np.pi)
    turns = np.pi * (nearest + np.arange(-MOST_TURNS, MOST_TURNS + 1))
    fitted = min((_squares(design, phase - turn) for turn in turns), key=lambda fit: fit.squares)
    scatter = float(np.sqrt(fitted.squares / (len(lines_away) - 2)))
    if scatter > ROUGH:
        return None
    constant = (float(fitted.values[0]), float(fitted.errors[0]) * scatter)
    return Lag(constant, (0.0, np.inf), None, scatter / float(np.mean(omega)))


def _time_of(record: Record, omega: Reals) -> Reals | None:
    """Times at which a sweep passes frequencies [s]; None of a drive that is no sweep."""
    u = record.channels[record.source]
    source = np.asarray(hilbert(u - np.mean(u)))
    loud = np.flatnonzero(np.abs(source) > LOUD * np.abs(source).max())
    # The transform takes the record for periodic: beyond its ends the amplitude is none.
    first, last = np.quantile(loud, (0.02, 0.98))
    if last - first < FEWEST * PIECE:
        return None
    # Straight lines between few values of the phase: the mean frequency between them.
    knots = np.linspace(first, last, len(omega) // 2 + FEWEST).astype(int)
    rates = np.diff(np.unwrap(np.angle(source))[knots]) / np.diff(knots) * record.fs
    middles = 0.5 * (knots[1:] + knots[:-1]) / record.fs
    steps = np.sign(rates[-1] - rates[0]) * np.diff(rates)
    if np.mean(steps > 0) < ONE_WAY:
        return None
    order = np.argsort(rates)
    return np.interp(omega, rates[order], middles[order])


def _lag_of_sweep(time: Reals, omega: Reals, phase: Reals, bend: Reals) -> Lag | None:
    """The lag by least squares: constant, growing or with a step, the simplest that serves."""
    # Half turns are the polarity of a channel; what turns the phase later is a lag that grew.
    phase = phase - np.pi * np.round(np.median(phase[: len(phase) // 4]) / np.pi)
    plain = _squares(np.column_stack([-omega, -bend]), phase)
    growing = _squares(np.column_stack([-omega, -bend, -omega * time]), phase)
    count = len(time)
    # At the ends of a sweep few lines tell two lags apart, and those are driven least.
    edge = max(FEWEST // 3, count // 6)
    stepped = [
        (at, _squares(np.column_stack([-omega, -bend, -omega * (np.arange(count) >= at)]), phase))
        for at in range(edge, count - edge)
    ]
    at, jump = min(stepped, key=lambda pair: pair[1].squares)
    chosen, extra = plain, 2
    if _better(plain, growing, count, 3):
        chosen, extra = growing, 3
    if jump.squares < chosen.squares and _better(plain, jump, count, 4):
        chosen, extra = jump, 4
    scatter = float(np.sqrt(chosen.squares / (count - extra)))
    if chosen is jump:
        # Another mode turns the phase by half a turn, whatever the frequency.
        after = np.arange(count) >= at
        turned = _squares(np.column_stack([-omega, -bend, after]), phase).values[2]
        if abs(abs(np.angle(np.exp(1j * turned))) - np.pi) < NEAR_HALF:
            return None
    # Where a block was cut out the two ends do not meet, and ripple the phase around.
    rough = ROUGH
    if chosen is jump:
        rough = max(ROUGH, abs(float(jump.values[2])) * float(np.mean(omega)) / RIPPLED)
    if scatter > rough:
        return None
    values, errors = chosen.values, chosen.errors * scatter
    zero = (0.0, np.inf)
    slope = (float(values[2]), float(errors[2])) if chosen is growing else zero
    step = (float(time[at - 1]), float(time[at]), float(values[2])) if chosen is jump else None
    return Lag((float(values[0]), float(errors[0])), slope, step, scatter / float(np.mean(omega)))


class _Fit(NamedTuple):
    values: Reals
    errors: Reals  # for residuals of unit variance
    squares: float


def _squares(design: Float[np.ndarray, "value unknown"], target: Reals) -> _Fit:
    scale = np.linalg.norm(design, axis=0)
    inverse = np.linalg.pinv(design / scale)
    values = (inverse @ target) / scale
    residual = target - design @ values
    return _Fit(values, np.linalg.norm(inverse, axis=1) / scale, float(residual @ residual))


def _better(simple: _Fit, extended: _Fit, count: int, unknowns: int) -> bool:
    """Whether a further unknown takes away more squares than noise would give it."""
    degrees = (count - unknowns) / 2  # neighbouring values overlap by half
    ratio = (simple.squares - extended.squares) / max(extended.squares, 1e-300) * degrees
    return bool(f_distribution.sf(ratio, 1, degrees) < ODDS)


def _lags_of_noise(u: Reals, x: Reals, fs: float) -> tuple[Reals, Reals, float] | None:
    """Time of the parts of a record, their lags against the first [s], and the frequency there."""
    size = len(u) // PARTS
    short = 2 * size // (AVERAGES + 1)
    if short < 64:
        return None
    cross = np.array(
        [_cross(u[i * size :][:size], x[i * size :][:size], short) for i in range(PARTS)]
    )
    power, coherence = np.abs(cross[:, 0]), np.abs(cross[:, 1])
    weight = np.prod(coherence, axis=0) ** (1 / PARTS) * np.prod(power, axis=0) ** (1 / PARTS)
    if np.sum(weight) < COHERENT * np.sum(np.prod(power, axis=0) ** (1 / PARTS)):
        return None
    ratios = cross[:, 0] / np.maximum(power, 1e-300)
    fine = 16
    lags = []
    for part in ratios:
        correlation = np.fft.irfft(part * np.conj(ratios[0]) * weight, fine * short)
        place = int(np.argmax(correlation))
        place -= fine * short if place > fine * short / 2 else 0
        around = correlation[[place - 1, place, (place + 1) % len(correlation)]]
        curve = around[0] - 2 * around[1] + around[2]
        lags.append((place + (0.5 * (around[0] - around[2]) / curve if curve else 0.0)) / fine / fs)
    freq = np.fft.rfftfreq(short, 1 / fs)
    hz = float(np.sqrt(np.sum(weight * freq**2) / np.sum(weight)))
    time: Reals = np.asarray((np.arange(PARTS) + 0.5) * size / fs, np.float64)
    return time, np.array(lags, np.float64), hz


def _cross(u: Reals, x: Reals, short: int) -> Complex[np.ndarray, "two line"]:
    """Cross spectrum of a part, and its coherence."""
    window = np.hanning(short)
    starts = range(0, len(u) - short + 1, short // 2)
    spectra = np.array(
        [[np.fft.rfft(window * (y[i : i + short] - y[i : i + short].mean())) for i in starts]
         for y in (u, x)]
    )  # fmt: skip
    cross = np.mean(np.conj(spectra[0]) * spectra[1], axis=0)
    power = np.mean(np.abs(spectra) ** 2, axis=1)
    return np.stack([cross, np.abs(cross) ** 2 / np.maximum(np.prod(power, axis=0), 1e-300)])


def _jump_within(at: int, lags: Reals) -> _Fit:
    """Lags that jump within one of the parts."""
    part = np.arange(len(lags))
    return _squares(np.column_stack([np.ones_like(lags), part > at, part == at]), lags)


def _course(time: Reals, lags: Reals) -> Lag | None:
    """Which of slope and step lags of noise follow; of neither, a constant."""
    constant = np.ones_like(time)
    plain = _squares(constant[:, None], lags)
    growing = _squares(np.column_stack([constant, time - time[0]]), lags)
    stepped = [
        (at, _squares(np.column_stack([constant, np.arange(len(time)) >= at]), lags))
        for at in range(1, len(time))
    ]
    # A part in which it jumps has a lag of its own, between the two.
    within = [(at, _jump_within(at, lags)) for at in range(LEAST_PARTS, len(time) - LEAST_PARTS)]
    unknowns, before, after, jump = min(
        *((3, at - 1, at, fit) for at, fit in stepped),
        *((4, at - 1, at + 1, fit) for at, fit in within if _better(plain, fit, 2 * len(time), 4)),
        key=lambda candidate: candidate[-1].squares,
    )
    chosen = plain
    # Two or three of eight parts are left for the scatter: the odds say what that is worth.
    if _better(plain, growing, 2 * len(time), 2):
        chosen = growing
    if jump.squares < chosen.squares and _better(plain, jump, 2 * len(time), unknowns):
        chosen = jump
    scatter = float(np.sqrt(chosen.squares / (len(time) - 2)))
    zero = (0.0, np.inf)
    slope = (float(chosen.values[1]), scatter) if chosen is growing else zero
    between = float(time[before]), float(time[after])
    step = (*between, float(chosen.values[1])) if chosen is jump else None
    return Lag((float(chosen.values[0]), scatter), slope, step, scatter)
