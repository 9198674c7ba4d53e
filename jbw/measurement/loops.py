r"""Force loops from records: integration in a band, the mean cycle, and properties of each cycle.

A cycle reaches from one passage of the middle to the second next. With its amplitude a and the
secant stiffness k between its turning points,

$$W = \oint F\,\mathrm{d}y, \qquad \zeta_{eq} = \frac{W}{2 \pi k a^2}$$

An offset of the load cell changes none of them. A drift hardly does: its effect is the drift in a
cycle times the distance between the ends of the cycle.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from jbw.errors import ConfigError, DataError
from jbw.measurement.channels import Reals, channel, passband, same_length, sampling
from jbw.measurement.curves import ForcedLoop
from jbw.measurement.harmonics import Tones, check_tones, sine_fit

# width of the roll-off outside the band, relative to the frequency of the band's edge
ROLL_OFF = 0.2
ORDER = 64  # number of poles, enough for about thirty tones
RECENT = 2048  # number of samples at an end from which the continuation is predicted
MOST_HARMONICS = 25  # largest number of harmonics of a mean cycle
# A return of the motion counts as a reversal if it exceeds this fraction of the whole stroke.
TURN = 0.1
ALIKE = 0.02  # relative difference of stroke below which cycles have the same amplitude
# fewest cycles of one amplitude, because the first cycle still depends on earlier motion
FEWEST = 3
AT_REST = 0.02  # A loop begins at y = 0 if it begins within this fraction of the whole stroke.
TINY = 1e-300


def enclosed_area(y: ArrayLike, force: ArrayLike) -> Reals:
    r"""Return the energy that a loop dissipates, its area [J/kg]; positive if force opposes motion.

    $$E = \oint F\,\mathrm{d}y = \pi\sum_n n\,\mathrm{Im}(F_n \bar Y_n)$$

    with Y_n, F_n the Fourier coefficients of displacement [m] and force [N/kg] over a cycle, of
    shape (time,) or (repeat, time). Noise in the two channels adds no bias when it is independent,
    and band-limited loops come out exact.
    """
    y, force = channel(y, "y"), channel(force, "force")
    same_length(y=y, force=force)
    num_samples = y.shape[-1]
    if num_samples < 8:
        raise DataError(f"A cycle must have at least 8 samples, but it has {num_samples}.")
    y_k, f_k = (2 / num_samples * np.fft.rfft(x) for x in (y, force))
    k = np.arange(y_k.shape[-1])
    if num_samples % 2 == 0:
        k[-1] = 0  # The sine at the Nyquist frequency cannot be observed.
    return np.pi * np.sum(k * (f_k * y_k.conj()).imag, axis=-1)


def mean_cycles(x: Reals, fs: float, omega: float, num_points: int) -> Reals:
    """Return each channel's mean cycle (channel, time), at omega t from 0 to 2 pi, end excluded.

    It is a fit of harmonics over all cycles, so samples need not fall on the same phases in each
    one.
    """
    # `omega` may still be zero here; it is rejected further below in this function.
    carried = int(0.9 * np.pi * fs / omega) if omega > 0 else 1
    tones = Tones(omega, max(1, min(MOST_HARMONICS, carried)))
    check_tones(tones, fs, x.shape[-1])
    phase = 2 * np.pi * np.arange(num_points) / num_points
    turn = np.exp(1j * np.outer(np.arange(1, tones.num_harmonics + 1), phase))
    return (sine_fit(x, np.arange(x.shape[-1]) / fs, tones).amplitudes @ turn).real


def integrate(x: ArrayLike, fs: float, band: tuple[float, float]) -> Reals:
    r"""Integrate over time in a band, without drift and mean: X(omega) / (j omega).

    Outside the band the gain falls to zero over a fifth of each edge. The record is continued by
    linear prediction: steady or decaying tones are accurate to about 1e-3, worst at the ends.
    Samples have the shape (time,) or (repeat, time); the band [Hz] must start above zero.
    """
    if not band[0] > 0:
        raise ConfigError(
            f"Argument `band` must start above zero to integrate, but it starts at {band[0]:g} Hz.",
            why="Division by j omega turns the offset of a sensor into a drift.",
        )
    return _in_band(x, fs, band, lambda omega: 1 / (1j * omega))


def differentiate(x: ArrayLike, fs: float, band: tuple[float, float]) -> Reals:
    """Differentiate over time in a band: j omega X(omega); the upper edge limits the noise."""
    return _in_band(x, fs, band, lambda omega: 1j * omega)


def _in_band(
    x: ArrayLike, fs: float, band: tuple[float, float], factor: Callable[[Reals], NDArray[Any]]
) -> Reals:
    """Multiply a record's spectrum by factor(omega) inside the band."""
    x, fs = channel(x, "x"), sampling(fs)
    low, high = passband(band, fs / 2)
    num_samples = x.shape[-1]
    if 0 < low * num_samples / fs < 1 - 1e-9:
        raise DataError(
            f"The record must hold a period of the lowest frequency, {1 / low:.4g} s, but it lasts "
            f"{num_samples / fs:.4g} s.",
            remedy="Raise the band's lower edge, or measure longer.",
        )
    reach = int(4 * fs / low) if low > 0 else num_samples
    extended = continued(x, reach)
    omega = 2 * np.pi * np.fft.rfftfreq(extended.shape[-1], 1 / fs)
    gain = np.zeros(omega.shape, complex)
    gain[1:] = factor(omega[1:]) * _gain(omega[1:] / (2 * np.pi), low, high)
    filtered = np.fft.irfft(np.fft.rfft(extended) * gain, extended.shape[-1])
    return filtered[..., reach : reach + num_samples]


def _gain(f: Reals, low: float, high: float) -> Reals:
    """Return a gain of one inside a band, which falls as a raised cosine outside it."""
    below = np.clip((low - f) / (ROLL_OFF * low), 0, 1) if low > 0 else np.zeros_like(f)
    above = np.clip((f - high) / (ROLL_OFF * high), 0, 1)
    return np.cos(np.pi / 2 * below) ** 2 * np.cos(np.pi / 2 * above) ** 2


def continued(x: Reals, reach: int) -> Reals:
    """Extend samples (..., time) by `reach` predicted ones at both ends, fading to the mean."""
    mean = x.mean(axis=-1, keepdims=True)
    fade = np.cos(np.linspace(0, np.pi / 2, reach)) ** 2
    rows = (x - mean).reshape(-1, x.shape[-1])
    extended = [
        np.concatenate(
            [(fade * _predicted(row[::-1], reach))[::-1], row, fade * _predicted(row, reach)]
        )
        for row in rows
    ]
    return np.reshape(extended, (*x.shape[:-1], -1)) + mean


def _predicted(x: Reals, num_samples: int) -> Reals:
    """Predict the continuation of samples as an autoregressive process."""
    order = min(ORDER, len(x) // 3)
    coefficients = _burg(x[-RECENT:], order)
    state = signal.lfiltic([1.0], coefficients, x[: -order - 1 : -1])
    return signal.lfilter([1.0], coefficients, np.zeros(num_samples), zi=state)[0]


def _burg(x: Reals, order: int) -> Reals:
    """Compute coefficients of a stable autoregressive model, sum_i a_i x[n - i] = e[n], by Burg."""
    # J. P. Burg, Maximum entropy spectral analysis, PhD thesis, Stanford (1975).
    forward, backward = x[1:], x[:-1]
    a = np.ones(1)
    for _ in range(order):
        power = forward @ forward + backward @ backward
        k = -2 * (forward @ backward) / power if power > 0 else 0.0
        a = np.append(a, 0.0)
        a = a + k * a[::-1]
        forward, backward = (forward + k * backward)[1:], (backward + k * forward)[:-1]
    return a


class Cycle(NamedTuple):
    """A cycle between two turning points or passages: samples, stroke and rms of the force."""

    samples: slice
    stroke: float
    force: float

    @property
    def num_samples(self) -> int:
        """The number of samples of the cycle, both ends included."""
        return self.samples.stop - self.samples.start


class CycleReading(NamedTuple):
    """Amplitude, stiffness and losses determined from one cycle of a force loop.

    Attributes:
        amplitude: Half of the stroke, a [m].
        stiffness: Secant stiffness k between the turning points [N/m].
        work: Work W that the cycle dissipates [J].
        damping: Equivalent damping ratio zeta_eq [-].
        retained: Stiffness, divided by that of the first cycle of equal amplitude [-].
        repeated: Whether another cycle has the same amplitude.
    """

    amplitude: float
    stiffness: float
    work: float
    damping: float
    retained: float
    repeated: bool


def cycles_of(loop: ForcedLoop) -> list[Cycle]:
    """Return the whole cycles of a loop, each from one upper turning point to the next."""
    y = loop.displacement
    least = TURN * np.ptp(y)
    turns, rising, place = [], True, 0
    for i in range(len(y)):
        if (y[i] > y[place]) == rising and y[i] != y[place]:
            place = i
        elif abs(y[i] - y[place]) > least:
            turns += [place] if rising else []
            rising, place = not rising, i
    return [_cycle(loop, first, last) for first, last in pairwise(turns)]


def _cycle(loop: ForcedLoop, first: int, last: int) -> Cycle:
    """Return a force loop's cycle between two samples, both included."""
    samples = slice(first, last + 1)
    stroke, force = np.ptp(loop.displacement[samples]), np.std(loop.force[samples])
    return Cycle(samples, float(stroke), float(force))


def passages(y: Reals) -> list[int]:
    """Return the samples at which a displacement passes its middle, up and down in alternation.

    The middle is y = 0 if the motion goes to both sides of it. A record that begins or ends at the
    middle does so with a passage.
    """
    reach, ends = float(np.ptp(y)), (float(np.min(y)), float(np.max(y)))
    goes_both_ways = min(-ends[0], ends[1]) > TURN * reach
    away = y - (0.0 if goes_both_ways else 0.5 * sum(ends))
    far, crossings = AT_REST * reach, []
    side = last = 0.0
    place = 0
    for i, (x, sign) in enumerate(zip(away, np.sign(away), strict=True)):
        if sign not in (0.0, last):
            last, place = sign, i
        if abs(x) > far and sign != side:
            side = sign
            crossings.append(place)
    begins = [] if abs(away[0]) > far else [0]
    closes = [] if not crossings or abs(away[-1]) > far else [len(y) - 1]
    return [*begins, *crossings[1:], *closes]


def readings_of_cycles(loop: ForcedLoop) -> list[CycleReading]:
    """Return amplitude, stiffness and losses of every whole cycle of a loop, in order."""
    readings: list[CycleReading] = []
    first: dict[int, float] = {}
    # A cycle lasts from one upward passage of the middle to the next.
    ends = passages(loop.displacement)
    cycles = [_cycle(loop, *pair) for pair in zip(ends[:-2:2], ends[2::2], strict=False)]
    groups = _amplitudes(cycles)
    for cycle, group in zip(cycles, groups, strict=True):
        y, force = loop.displacement[cycle.samples], loop.force[cycle.samples]
        (bottom, top), (below, above) = _turning_points(loop, cycle)
        stiffness = float((above - below) / (top - bottom))
        work = float(np.trapezoid(np.append(force, force[0]), np.append(y, y[0])))
        amplitude = 0.5 * cycle.stroke
        first.setdefault(group, stiffness)
        damping = work / (2 * np.pi * stiffness * amplitude**2) if stiffness else np.nan
        retained = stiffness / first[group] if first[group] else np.nan
        is_repeated = groups.count(group) > 1
        readings.append(CycleReading(amplitude, stiffness, work, damping, retained, is_repeated))
    return readings


def _amplitudes(cycles: Sequence[Cycle]) -> list[int]:
    """Return a group number for every cycle; cycles of equal stroke have the same number."""
    strokes: list[float] = []
    numbers = []
    for cycle in cycles:
        matching = [i for i, stroke in enumerate(strokes) if abs(cycle.stroke / stroke - 1) < ALIKE]
        strokes += [] if matching else [cycle.stroke]
        numbers.append(matching[0] if matching else len(strokes) - 1)
    return numbers


def begins_unmoved(loop: ForcedLoop) -> bool:
    """Return whether a loop begins at zero displacement, where an unmoved joint has no force."""
    y = loop.displacement
    return not loop.is_part and bool(abs(y[0]) <= AT_REST * np.ptp(y))


def lopsided(loop: ForcedLoop) -> float:
    r"""Return the median of $(F^+ - F^-) / (F^+ + F^-)$ with the two peak forces F of each cycle.

    If a loop begins with an unmoved joint, its force there is subtracted, since it must be zero.
    """
    sides = [_centre(loop, cycle) for cycle in cycles_of(loop)]
    if not sides:
        return 0.0
    centre, half = np.transpose(sides)
    offset = loop.force[0] if begins_unmoved(loop) else 0.0
    return float(np.median((centre - offset) / np.maximum(half, TINY)))


def of_one_amplitude(cycles: Sequence[Cycle]) -> list[list[Cycle]]:
    """Return the groups of three or more consecutive cycles of nearly equal stroke."""
    groups: list[list[Cycle]] = []
    for cycle in cycles:
        if groups and abs(cycle.stroke / groups[-1][0].stroke - 1) < ALIKE:
            groups[-1].append(cycle)
        else:
            groups.append([cycle])
    return [group for group in groups if len(group) >= FEWEST]


def _centre(loop: ForcedLoop, cycle: Cycle) -> tuple[float, float]:
    """Return the mean force of a cycle at zero displacement, and half the range of the force."""
    (bottom, top), (below, above) = _turning_points(loop, cycle)
    stiffness = (above - below) / (top - bottom)
    middle = 0.5 * (above + below - stiffness * (top + bottom))
    return float(middle), 0.5 * abs(float(above - below))


def _turning_points(loop: ForcedLoop, cycle: Cycle) -> tuple[Reals, Reals]:
    """Return the smallest and largest displacement of a cycle, and the forces at both."""
    y, force = loop.displacement[cycle.samples], loop.force[cycle.samples]
    bottom, top = int(np.argmin(y)), int(np.argmax(y))
    return y[[bottom, top]], force[[bottom, top]]
