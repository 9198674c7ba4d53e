r"""Whether drive and response of noise keep one time: a lag that stays, that grows, or that jumps.

A constant lag is a delay, one that grows along the record two clocks that run apart, and one that
jumps a block of samples that one channel lost. Parts of a record have the same FRF but for it;
away from the resonance the structure's phase is known whatever its joint does,

$$\arg \frac{Y}{U} = -\omega\,\tau - \frac{2\zeta\,r}{1 - r^2} - k\pi, \quad
  r = \omega / \omega_n$$
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.special import fdtrc

from jbw.measurement.channels import Reals
from jbw.measurement.checks.faults import Fault, doubt
from jbw.measurement.records import Record
from jbw.measurement.resonances import swept
from jbw.measurement.spans import kept_before
from jbw.measurement.spectra import averaged
from jbw.quantities import derivative_order
from jbw.report.messages import clock_faults as messages

AWAY = 0.08  # |1 - r^2| from where on the damping alone bends the phase
LOUD = 0.3  # of the drive's largest amplitude, where a phase is read
FEWEST = 12  # values of a phase, or of a lag
CERTAIN = 6.0  # standard errors of a lag
ONE_MODE = 0.3  # scatter of log |Y/U| about that of one mode: more is of several
ROUGH = 0.15  # [rad]; a phase that scatters by more is not that of one mode
PARTS, AVERAGES = 8, 8  # of a record of noise, and of each of them
LEAST_PARTS = 2  # on each side of one in which the lag jumps
COHERENT = 0.5  # between response and drive in the mean, for a lag to be read
MOST_TURNS = 3  # half turns of the phase that are tried about its middle
ODDS = 1e-6  # that a lag of chance is called one
TURNED = 0.05  # [rad] at the end of the record: a smaller error moves no damping


class Lag(NamedTuple):
    """How a response lags behind its drive along a record.

    Attributes:
        constant_s: At the start of the record [s], and its standard error.
        slope: Growth along it [s/s], and its standard error.
        step: Times between which it jumps, and by how much [s]; None where it does not.
    """

    constant_s: tuple[float, float]
    slope: tuple[float, float] = (0.0, np.inf)
    step: tuple[float, float, float] | None = None


def untimely(record: Record, delay: float) -> Iterator[Fault]:
    """Yield the doubt that drive and response of a record of noise do not keep one time."""
    u, x = (record.channels[role] for role in (record.source, record.response))
    parts = _lags_of_noise(u, x, record.fs)
    if parts is None:
        return
    time, lags, hz = parts
    lag, least = _course(time, lags), TURNED / (2 * np.pi * hz)
    length = record.num_samples / record.fs
    if lag.step is not None and abs(lag.step[2]) > least:
        before, after, jump = lag.step
        what = messages.response_jumps(abs(jump), "ahead of" if jump < 0 else "behind")
        text = messages.lost_block(0.5 * (before + after), what, kept_before(record, before))
        yield doubt(record.response, *text)
    elif abs(lag.slope[0]) * length > least:
        # A fast clock takes its samples early: they show what was before, and the lag grows.
        slope, fast = lag.slope[0], "fast" if lag.slope[0] > 0 else "slow"
        text = messages.another_clock(1e6 * abs(slope), fast, abs(slope) * length, 1e6 * slope)
        yield doubt(record.response, *text)
    elif (constant := _constant_of_noise(record)) is not None:
        yield from _delayed(record, constant, delay, least)


def _delayed(record: Record, lag: Lag, delay: float, least: float) -> Iterator[Fault]:
    """Yield the doubt that a lag along the whole record is another than the campaign states."""
    seconds, error = lag.constant_s
    # What is fed in volts is held from sample to sample, which is half a sample of lag.
    held = 1 / record.fs if record.source == "input" else 0.0
    if abs(seconds - delay) > max(least, CERTAIN * error, held):
        way = "lags behind" if seconds > 0 else "leads"
        yield doubt(record.response, *messages.another_delay(way, abs(seconds), delay, seconds))


def _away(
    omega: Reals, receptance: Complex[np.ndarray, " line"]
) -> tuple[Int[np.ndarray, " kept"], Reals, Reals] | None:
    """Return lines off a single resonance, their phase, and its bend by damping; else None."""
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
    """Return the lag of a whole record of noise, by its averaged FRF away from the resonance."""
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
    return Lag(constant)


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
    """Return whether a further unknown takes away more squares than noise would give it."""
    degrees = (count - unknowns) / 2  # neighbouring values overlap by half
    ratio = (simple.squares - extended.squares) / max(extended.squares, 1e-300) * degrees
    return bool(fdtrc(1, degrees, ratio) < ODDS)


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
    """Return the cross spectrum and the coherence of a part."""
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
    """Fit lags that jump within one of the parts."""
    part = np.arange(len(lags))
    return _squares(np.column_stack([np.ones_like(lags), part > at, part == at]), lags)


def _course(time: Reals, lags: Reals) -> Lag:
    """Choose a constant, a slope or a step that describes the lags of noise over time."""
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
    return Lag((float(chosen.values[0]), scatter), slope, step)
