r"""Faults of noise tests: different clocks of drive and response, and noise of a measured drive.

A constant lag is a delay, one that grows along the record comes from two clocks of different
speed, and one that jumps from a block of samples that one channel lost. Parts of a record have the
same FRF apart from the lag. Away from the resonance the phase of the structure is known whatever
its joint does,

$$\arg \frac{Y}{U} = -\omega\,\tau - \frac{2\zeta\,r}{1 - r^2} - k\pi, \quad
  r = \omega / \omega_n$$

A fit takes the measured drive as exact. White noise of the drive channel passes the resonance and
appears in the predicted response as an error that no residual reveals, as narrow as the resonance.
Its ratio to the noise of the response's channel is

$$r = |H|^2_{max}\, S_u / S_y$$

Two repeats determine both noises from their difference on lines that the drive does not excite.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.special import fdtrc

from jbw.measurement.channels import Reals
from jbw.measurement.faults.fault import Fault, doubt
from jbw.measurement.records import INPUTS, Record
from jbw.measurement.resonances import swept
from jbw.measurement.spans import kept_before
from jbw.measurement.spectra import averaged
from jbw.quantities import derivative_order
from jbw.report.messages import clock_faults as messages
from jbw.report.messages import record_faults

# Lines with |1 - r^2| above this are used, where r is the frequency ratio, because damping hardly
# shifts their phase.
AWAY = 0.08
# The phase of a line is used if its power exceeds this fraction of the drive's median power.
LOUD = 0.3
FEWEST = 12  # smallest number of lines with a usable phase
CERTAIN = 6.0  # smallest reported deviation of a lag from the stated delay, in standard errors
ONE_MODE = 0.3  # largest standard deviation of log |Y/U| about one mode; more means several modes
# [rad]; if the phase varies by more than this around a supposed single mode, there is more than one
# mode
ROUGH = 0.15
# number of parts into which a record is divided, and number of averages in each part
PARTS, AVERAGES = 8, 8
LEAST_PARTS = 2  # smallest number of parts before and after a part in which the lag jumps
COHERENT = 0.5  # smallest mean coherence of drive and response with which a lag is determined
MOST_TURNS = 3  # number of half turns of phase that are tried on either side of the nearest one
ODDS = 1e-6  # probability of mistaking chance for a lag
TURNED = 0.05  # phase error at the end of the record [rad] below which damping is not affected
EMPTY = 0.1  # Lines below this fraction of the drive's largest line count as not driven.
FEWEST_EMPTY = 32  # smallest number of lines for a median
HALF = 0.5  # Lines above this fraction of the largest power belong to the resonance.
# If more than this fraction of the difference between two drives appears in the response, the
# structure responded to it.
MEASURED = 0.5
# largest difference of power between the drives of two repeats, relative to the drive's power
ONE_DRIVE = 0.1
MORE = 1.0  # smallest ratio r that is reported


def untimely(record: Record, delay: float) -> Iterator[Fault]:
    """Yield a warning if drive and response of a noise test differ by a lag, a drift or a gap."""
    u, x = (record.channels[role] for role in (record.source, record.response))
    parts = _lags_of_noise(u, x, record.fs)
    if parts is None:
        return
    time, lags, hz = parts
    (slope, step), least = _course(time, lags), TURNED / (2 * np.pi * hz)
    length = record.num_samples / record.fs
    if step is not None and abs(step[2]) > least:
        before, after, jump = step
        text = messages.lost_block(0.5 * (before + after), jump, kept_before(record, before))
    elif abs(slope) * length > least:
        # A fast clock samples early, so that each sample shows an earlier time and the lag grows.
        text = messages.another_clock(slope, abs(slope) * length)
    elif (constant := _constant_of_noise(record)) is not None:
        seconds, error = constant
        # A voltage input is held between samples, which is a lag of half a sample.
        held = 1 / record.fs if record.source == "input" else 0.0
        if abs(seconds - delay) <= max(least, CERTAIN * error, held):
            return
        text = messages.another_delay(seconds, delay)
    else:
        return
    yield doubt(record.response, *text)


def _away(
    omega: Reals, receptance: Complex[np.ndarray, " line"]
) -> tuple[Int[np.ndarray, " kept"], Reals, Reals] | None:
    """Return lines off the resonance, their phases and phase lags per damping ratio; or None."""
    natural = float(omega[np.argmax(np.abs(omega * receptance))])
    r = omega / natural
    lines_away = np.flatnonzero(np.abs(1 - r**2) > AWAY)
    if len(lines_away) < FEWEST:
        return None
    r = r[lines_away]
    # With several modes, the phase does not determine a lag. With a single mode, the magnitude is
    # proportional to 1 / (1 - r^2), where r is the ratio of the frequency to that of the mode.
    if np.std(np.log(np.abs(receptance[lines_away] * (1 - r**2)))) > ONE_MODE:
        return None
    phase = np.angle(receptance[lines_away] * np.where(r < 1, 1.0, -1.0))
    return lines_away, phase, 2 * r / (1 - r**2)


def _constant_of_noise(record: Record) -> tuple[float, float] | None:
    """Return the lag of a noise test and its standard error [s], from the FRF off the resonance."""
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
    # Half turns of phase come from a channel's polarity; a lag rotates the phase with frequency.
    nearest = np.round(np.median(phase) / np.pi)
    turns = np.pi * (nearest + np.arange(-MOST_TURNS, MOST_TURNS + 1))
    fitted = min((_squares(design, phase - turn) for turn in turns), key=lambda fit: fit.squares)
    scatter = float(np.sqrt(fitted.squares / (len(lines_away) - 2)))
    if scatter > ROUGH:
        return None
    return float(fitted.values[0]), float(fitted.errors[0]) * scatter


class _Fit(NamedTuple):
    values: Reals
    errors: Reals  # standard errors of the values for residuals of unit variance
    squares: float


def _squares(design: Float[np.ndarray, "value unknown"], target: Reals) -> _Fit:
    scale = np.linalg.norm(design, axis=0)
    inverse = np.linalg.pinv(design / scale)
    values = (inverse @ target) / scale
    residual = target - design @ values
    return _Fit(values, np.linalg.norm(inverse, axis=1) / scale, float(residual @ residual))


def _better(simple: _Fit, extended: _Fit, count: int, unknowns: int) -> bool:
    """Return whether an additional unknown reduces the sum of squares by more than noise would."""
    degrees = (count - unknowns) / 2  # neighbouring values overlap by half
    ratio = (simple.squares - extended.squares) / max(extended.squares, 1e-300) * degrees
    return bool(fdtrc(1, degrees, ratio) < ODDS)


def _lags_of_noise(u: Reals, x: Reals, fs: float) -> tuple[Reals, Reals, float] | None:
    """Return times and lags [s] of the parts of a noise record, and their mean frequency [Hz]."""
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
    """Return the cross spectrum and coherence of drive and response in one part of a record."""
    window = np.hanning(short)
    starts = range(0, len(u) - short + 1, short // 2)
    spectra = np.array(
        [[np.fft.rfft(window * (y[i : i + short] - y[i : i + short].mean())) for i in starts]
         for y in (u, x)]
    )  # fmt: skip
    cross = np.mean(np.conj(spectra[0]) * spectra[1], axis=0)
    power = np.mean(np.abs(spectra) ** 2, axis=1)
    return np.stack([cross, np.abs(cross) ** 2 / np.maximum(np.prod(power, axis=0), 1e-300)])


def _course(time: Reals, lags: Reals) -> tuple[float, tuple[float, float, float] | None]:
    """Return the best model of lags over time: a slope [s/s], a step, or neither.

    A step has the times [s] between which the lag jumps, and its size [s].
    """
    count, part = len(time), np.arange(len(time))

    def fitted(*columns: np.ndarray) -> _Fit:
        return _squares(np.column_stack([np.ones_like(time), *columns]), lags)

    plain, growing = fitted(), fitted(time - time[0])
    steps = [(3, at - 1, at, fitted(part >= at)) for at in range(1, count)]
    # If the lag jumps within a part of the record, that part has an intermediate lag.
    for at in range(LEAST_PARTS, count - LEAST_PARTS):
        within = fitted(part > at, part == at)
        if _better(plain, within, 2 * count, 4):
            steps.append((4, at - 1, at + 1, within))
    unknowns, before, after, jump = min(steps, key=lambda candidate: candidate[-1].squares)
    chosen = plain
    # This test accounts for the fact that few of the eight parts remain for an estimate of the
    # variation.
    if _better(plain, growing, 2 * count, 2):
        chosen = growing
    if jump.squares < chosen.squares and _better(plain, jump, 2 * count, unknowns):
        chosen = jump
    slope = float(growing.values[1]) if chosen is growing else 0.0
    step = float(time[before]), float(time[after]), float(jump.values[1])
    return slope, step if chosen is jump else None


def noisy_drive(first: Record, second: Record) -> Iterator[Fault]:
    """Yield a warning if noise of the drive, seen in two repeats, exceeds the response's noise."""
    if not set(INPUTS) & first.channels.keys():
        return
    role, y = first.source, first.response
    if not {role, y} <= second.channels.keys() or first.fs != second.fs:
        return
    u, x = ([record.channels[name] for record in (first, second)] for name in (role, y))
    if len(u[0]) != len(u[1]) or not all(np.all(np.isfinite(samples)) for samples in (*u, *x)):
        return
    ratio = passed_on(np.stack(u), np.stack(x))
    if ratio > MORE:
        yield doubt(role, *record_faults.noisy_drive(role, ratio**0.5, y))


def passed_on(u: Reals, y: Reals) -> float:
    """Return the ratio r of drive noise to response noise at the resonance, from two repeats.

    The ratio is zero in three cases: the drives of the repeats differ; they leave too few lines
    without excitation; or the response followed the difference of the drives, which is then a real
    force and no noise of the drive's channel.
    """
    if np.mean((u[1] - u[0]) ** 2) > ONE_DRIVE * np.mean(u**2):
        return 0.0
    drive, response = np.abs(np.fft.rfft(u.mean(axis=0))), np.abs(np.fft.rfft(y.mean(axis=0)))
    of_drive, of_response = (
        np.abs(np.fft.rfft(repeats[1] - repeats[0])) ** 2 for repeats in (u, y)
    )
    empty = drive < EMPTY * drive.max()
    if np.sum(empty) < FEWEST_EMPTY:
        return 0.0
    noise, response_noise = np.median(of_drive[empty]), np.median(of_response[empty])
    peak = ~empty & (response**2 > HALF * np.max(response[~empty] ** 2))
    gain = np.sum(response[peak] ** 2) / np.sum(drive[peak] ** 2)
    passed = gain * noise
    if response_noise <= 0 or np.mean(of_response[peak]) > response_noise + MEASURED * passed:
        return 0.0
    return float(passed / response_noise)
