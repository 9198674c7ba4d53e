r"""Response curves under a force: peaks, widths and jumps, with the amplitude as parameter.

Under a force amplitude A per unit mass, the frequencies with the amplitude Y are the roots of

$$G(x) = (K - x)^2 + (c\,\omega + D)^2 = (A/Y)^2, \qquad x = \omega^2$$

G has its minimum at $x_m = K - c^2/2 - cD/(2\omega_m)$, where the curve of amplitude Y has its
peak. About this point

$$G(x) = G(x_m) + (x - x_m)^2 \left[1 - \frac{cD}{\omega_m(\omega + \omega_m)^2}\right]$$

holds exactly, so that both roots follow without a singular step where they meet. Peaks and folds
are searched in a table of the loops, then corrected with the loops at these points themselves.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jbw.errors import ModelError
from jbw.forced.equivalent import EquivalentLoops, EquivalentMotion, Values
from jbw.forced.roots import bracketed_root
from jbw.forced.table import LoopTable, tabulated

# numbers of amplitudes in the table in which a peak is searched: first a coarse, then a fine one
COARSE, FINE = 16, 96
POINTS = 160  # number of points on each side of a curve's peak
# number of iterations for the frequency; each reduces the error by a factor of about zeta^2
ROUNDS = 4
# largest number of iterations with exact loops, which correct a result that comes from the table
MOST_ROUNDS = 12
# limits at which iterations stop: relative change of level or frequency, and slope at a fold
CLOSE, FLAT = 1e-11, 1e-6
# number of times the first table is extended, each time to four times the largest amplitude
MOST_EXTENSIONS = 6
# curve parameter t at half power, where the amplitude is Y_peak / cosh(t)
HALF = np.arccosh(np.sqrt(2.0))
# Step of the curve parameter with which the tangent at a fold is computed by differences.
SURE = 1e-6


@dataclass(frozen=True, eq=False)
class Peaks:
    """The highest points of response curves, of shape (draw, level).

    Attributes:
        level: Force amplitude A [N/kg].
        y: Displacement amplitude [m].
        omega: Frequency [rad/s].
        isolated: Whether the curve has a branch at larger amplitudes that is not connected to the
            main branch: a second motion, which a slow sweep from rest never reaches.
        table: Equivalent loops of every draw up to the peaks and a little beyond.
    """

    level: Values
    y: Values
    omega: Values
    isolated: NDArray[np.bool_]
    table: LoopTable


@dataclass(frozen=True, eq=False)
class Resonance:
    """Peaks, widths and jumps of response curves, of shape (draw, level).

    Attributes:
        peak: The highest points.
        half_power: Frequencies below and above the peak at Y_peak / sqrt 2, of shape (draw, level,
            2) [rad/s]; NaN if the curve folds between them.
        jump_up: Frequency at which a slow sweep jumps to a larger amplitude [rad/s]; NaN if none.
        jump_down: Frequency at which a slow sweep jumps to a smaller amplitude [rad/s]; NaN if
            none.
        y_up: Amplitude at which the jump up begins [m].
        y_down: Amplitude at which the jump down begins [m].
    """

    peak: Peaks
    half_power: Values
    jump_up: Values
    jump_down: Values
    y_up: Values
    y_down: Values

    @property
    def width(self) -> Values:
        """The half-power width [rad/s]; NaN if the curve folds."""
        return self.half_power[..., 1] - self.half_power[..., 0]

    @property
    def quality(self) -> Values:
        """The quality factor Q: peak frequency / half-power width; NaN if the curve folds."""
        return self.peak.omega / self.width


@dataclass(frozen=True, eq=False)
class ForcedCurve:
    """Points along response curves from low to high frequency, of shape (draw, *any).

    Attributes:
        y: Displacement amplitude [m].
        omega: Frequency [rad/s]; 0 if the amplitude is below the static amplitude.
        phase: Phase of the displacement relative to the force [rad], from 0 to -pi.
        rise: Slope dA/dY Y/A at a fixed frequency of the force that holds the point, by its
            amplitude: positive where the motion is stable, zero at a fold.
    """

    y: Values
    omega: Values
    phase: Values
    rise: Values

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Whether the motion is stable at each point."""
        return self.rise > 0.0


def least_omega(loops: EquivalentLoops) -> Values:
    """Return the frequency [rad/s] of the peak of a response curve that has a given peak amplitude.

    The function G has its minimum there. The frequency is NaN where the equivalent stiffness
    permits no resonance.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        omega = np.sqrt(loops.stiffness)
        for _ in range(ROUNDS):
            lowered = 0.5 * loops.viscous * (loops.viscous + loops.loss / omega)
            omega = np.sqrt(loops.stiffness - lowered)
    return omega


def force_ratio(loops: EquivalentLoops, omega: Values) -> NDArray[np.complex128]:
    """Return the complex ratio of force to displacement, F_1 / Y [1/s^2]."""
    return loops.stiffness - omega**2 + 1j * (loops.viscous * omega + loops.loss)


def peak_level(loops: EquivalentLoops, y: Values) -> Values:
    """Return the force amplitude [N/kg] whose response curve peaks at the amplitude y [m]."""
    return y * np.abs(force_ratio(loops, least_omega(loops)))


def curve_points(loops: EquivalentLoops, level: Values, y: Values, side: Values) -> ForcedCurve:
    r"""Return points of response curves at given amplitudes y, on one side of the peak.

    The slope of the force at a fixed frequency is

    $$\frac{Y}{A}\frac{dA}{dY} = \frac{(K - x)(K - x + Y K') +
      (c\omega + D)(c\omega + D + Y(c'\omega + D'))}{(K - x)^2 + (c\omega + D)^2}$$

    Args:
        loops: Equivalent stiffness and loss at y.
        level: Force amplitudes A [N/kg].
        y: Displacement amplitudes [m], not larger than those of the peaks.
        side: -1 below the peak, +1 above it.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        omega_m = least_omega(loops)
        excess = (level / y) ** 2 - np.abs(force_ratio(loops, omega_m)) ** 2
        away = side * np.sqrt(np.maximum(excess, 0.0))
        omega = np.sqrt(np.maximum(omega_m**2 + away, 0.0))
        for _ in range(ROUNDS):
            curvature = loops.viscous * loops.loss / (omega_m * (omega + omega_m) ** 2)
            omega = np.sqrt(np.maximum(omega_m**2 + away / np.sqrt(1.0 - curvature), 0.0))
        ratio = force_ratio(loops, omega)
        loss_by_y = loops.loss_by_y + omega * loops.viscous_by_y
        grown = ratio + y * (loops.stiffness_by_y + 1j * loss_by_y)
        rise = np.real(ratio * grown.conj()) / np.abs(ratio) ** 2
    return ForcedCurve(y, omega, -np.angle(ratio), rise)


def peaks(motion: EquivalentMotion, level: Values) -> Peaks:
    """Return the highest point of each response curve, on the branch from small amplitudes.

    Args:
        motion: The draws of the joint.
        level: Force amplitudes A of shape (draw, level) [N/kg].

    Raises:
        ModelError: A curve has no peak: the damping is too heavy, or the joint loses its stiffness.
    """
    level = np.broadcast_to(level, (len(motion.omega_n), np.shape(level)[-1]))
    # No curve has its peak below this amplitude, unless its damping exceeds half of the critical
    # damping.
    low = 0.5 * np.min(level, axis=1, keepdims=True) / motion.omega_n**2
    highest = np.max(level, axis=1, keepdims=True)
    span = 64.0
    for _ in range(MOST_EXTENSIONS):
        span *= 4.0
        coarse = tabulated(motion, low, 0.5 * span * highest / motion.omega_n**2, COARSE)
        needed = _needed(coarse)
        if not np.any(needed[:, -1:] < highest):
            break
    first, _ = _crossing(needed, level)
    high = np.max(_at(coarse.y, first), axis=1, keepdims=True)
    table = tabulated(motion, low, 1.05 * high, FINE)
    cell, found = _crossing(_needed(table), level)
    _require_peak(found, level)
    ends = (_at(table.y, cell - 1), _at(table.y, cell))
    y = bracketed_root(lambda y: peak_level(table.loops(y), y) - level, *ends)
    nodes = np.arange(COARSE) > first[..., None]
    isolated = np.any(nodes & (needed[:, None] < level[..., None]), axis=-1)
    return Peaks(level, *_corrected(motion, level, y, least_omega(table.loops(y))), isolated, table)


def _corrected(
    motion: EquivalentMotion, level: Values, y: Values, omega: Values
) -> tuple[Values, Values]:
    """Refine amplitude and frequency of the peaks with exact loops, from approximate values."""
    for _ in range(MOST_ROUNDS):
        loops = motion.loops(y, omega)
        before, omega = omega, least_omega(loops)
        reached = peak_level(loops, y)
        y = y * (1.0 + (level / reached - 1.0) / curve_points(loops, reached, y, 0.0 * y).rise)
        changes = np.maximum(np.abs(level / reached - 1.0), np.abs(omega / before - 1.0))
        if not np.any(changes > CLOSE):
            break
    return y, omega


def _needed(table: LoopTable) -> Values:
    """Return the force amplitude [N/kg] for a peak at each table node, of shape (draw, node)."""
    return peak_level(table.loops(table.y), table.y)


def _crossing(needed: Values, level: Values) -> tuple[NDArray[np.int_], NDArray[np.bool_]]:
    """Return the first table node whose peak needs a given force or more, and whether it exists."""
    below = needed[:, None] < level[..., None]
    first = np.argmax(~below, axis=-1)
    found = below[..., 0] & ~below[..., -1] & np.isfinite(_at(needed, first))
    return first, found


def _at(values: NDArray, index: NDArray) -> NDArray:
    if values.ndim == index.ndim:
        return np.take_along_axis(values, index, -1)
    return np.take_along_axis(values, index[..., None], -1)[..., 0]


def _require_peak(found: NDArray[np.bool_], level: Values) -> None:
    if not np.all(found):
        raise ModelError(
            f"The response at a force amplitude of {level[~found][0]:.3g} N/kg must have a peak, "
            f"but has no peak at {np.sum(~found)} of {found.size} pairs of draw and level.",
            why="The damping is above 50 %, the joint loses its stiffness at this level, or "
            "another mode is too near.",
            remedy="Use a lower level, or simulate the motion by `jbw.simulate`.",
        )


def along(peak: Peaks, place: Values) -> ForcedCurve:
    """Return points of response curves from the table, at parameters t with Y = Y_peak / cosh t."""
    y, level = (x.reshape(*x.shape, *(1,) * (place.ndim - x.ndim)) for x in (peak.y, peak.level))
    y = y / np.cosh(place)
    return curve_points(peak.table.loops(y), level, y, np.sign(place))


def places(motion: EquivalentMotion, peak: Peaks, band: tuple[float, float]) -> Values:
    """Return values of the curve parameter t that cover a band of frequencies [rad/s]."""
    far = np.max([np.abs(motion.omega_n**2 - end**2) for end in band], axis=0)
    ends = np.arccosh(np.maximum(2.0 * peak.y * far / peak.level, 4.0))
    return ends[..., None] * np.linspace(-1.0, 1.0, 2 * POINTS + 1)


def resonance(motion: EquivalentMotion, level: Values) -> Resonance:
    """Return peak, half-power width and jumps of response curves.

    Args:
        motion: The draws of the joint.
        level: Force amplitudes A of shape (draw, level) [N/kg].

    Raises:
        ModelError: A curve has no peak.
    """
    peak = peaks(motion, level)
    reach = np.arccosh(np.maximum(np.minimum(peak.y / peak.table.y[:, :1], 30.0), 4.0))
    place = reach[..., None] * np.linspace(-1.0, 1.0, 2 * POINTS + 1)
    rise = along(peak, place).rise
    folds = [_fold(motion, peak, place, rise, last=last) for last in (False, True)]
    first, last = folds
    is_up = first.y < last.y  # The jump up to the larger amplitude starts at the smaller amplitude.
    up = [np.where(is_up, *pair) for pair in ((first.omega, last.omega), (first.y, last.y))]
    down = [np.where(is_up, *pair) for pair in ((last.omega, first.omega), (last.y, first.y))]
    half = np.broadcast_to(HALF * np.array([-1.0, 1.0]), (*peak.y.shape, 2))
    half_power = exact_points(motion, peak, half).omega
    folded = np.any((np.abs(place) <= HALF) & (rise < 0.0), axis=-1, keepdims=True)
    return Resonance(peak, np.where(folded, np.nan, half_power), up[0], down[0], up[1], down[1])


def exact_points(motion: EquivalentMotion, peak: Peaks, place: Values) -> ForcedCurve:
    """Return points of response curves from exact loops, for parameters t with Y = Y_peak / cosh t.

    With several harmonics a frequency is accurate to 5e-7 for 0 < |t| < 1e-4, where both sides of a
    peak meet, and to round-off elsewhere.
    """
    point = along(peak, place)
    level = peak.level.reshape(*peak.level.shape, *(1,) * (place.ndim - peak.level.ndim))
    # If the loops depend on the frequency, each round uses the frequency of the previous one.
    for _ in range(MOST_ROUNDS if motion.feels_frequency else 1):
        before = point.omega
        loops = motion.loops(point.y, before)
        point = curve_points(loops, level, point.y, np.sign(place))
        if not np.any(np.abs(point.omega / before - 1.0) > CLOSE):
            break
    return point


def _fold(
    motion: EquivalentMotion, peak: Peaks, place: Values, rise: Values, *, last: bool
) -> ForcedCurve:
    """Return the first or the last fold of each curve; NaN if it has none."""
    changes = np.signbit(rise[..., 1:]) != np.signbit(rise[..., :-1])
    count = changes.shape[-1]
    index = count - 1 - np.argmax(changes[..., ::-1], -1) if last else np.argmax(changes, -1)
    has_fold = np.any(changes, axis=-1)
    ends = [np.where(has_fold, _at(place, index + i), np.nan) for i in range(2)]
    root = bracketed_root(lambda t: along(peak, t).rise, ends[0], ends[1])
    tangent = along(peak, root + SURE).rise - along(peak, root - SURE).rise
    point = exact_points(motion, peak, root)
    for _ in range(MOST_ROUNDS):
        if not np.any(np.abs(point.rise) > FLAT):
            break
        root = root - 2.0 * SURE * point.rise / tangent
        point = exact_points(motion, peak, root)
    return point
