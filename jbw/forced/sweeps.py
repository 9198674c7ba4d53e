"""Slow sweeps across a band, and the force that holds an amplitude."""

import numpy as np
from numpy.typing import NDArray

from jbw.forced.curves import ForcedCurve, Peaks, along, places
from jbw.forced.equivalent import EquivalentMotion, Values, wide
from jbw.forced.roots import bracketed_root

# iterations of the search between two points of a curve; the error is then 1e-7 of the amplitude
ROUNDS = 8
# lower limit of the relative slope of force over amplitude in a correction; near a fold the slope
# approaches zero
LEAST_RISE = 0.1
Complexes = NDArray[np.complex128]


def whole_curve(motion: EquivalentMotion, peak: Peaks, band: tuple[float, float]) -> ForcedCurve:
    """Return points along response curves across a band [rad/s], (draw, level, point)."""
    return along(peak, places(motion, peak, band))


def swept(motion: EquivalentMotion, peak: Peaks, omega: Values, *, upward: bool) -> Complexes:
    """Return the complex displacement [m] in a slow sweep, relative to the phase of the force.

    An upward sweep stays on its branch until the branch ends: at each frequency it takes the first
    point of the curve, from its low end, that reaches the frequency. A downward sweep takes the
    last one.

    Args:
        motion: The draws of the joint.
        peak: Peaks of the curves, of shape (draw, level).
        omega: Frequencies in rising order [rad/s].
        upward: Whether the frequency rises.

    Returns:
        Shape (draw, level, frequency).
    """
    place = places(motion, peak, (float(omega[0]), float(omega[-1])))
    reached = along(peak, place).omega
    if upward:
        cell = np.sum(np.maximum.accumulate(reached, -1)[..., None] < omega, axis=-2) - 1
    else:
        least = np.minimum.accumulate(reached[..., ::-1], -1)[..., ::-1]
        cell = np.sum(least[..., None] <= omega, axis=-2) - 1
    cell = np.clip(cell, 0, place.shape[-1] - 2)
    ends = (np.take_along_axis(place, cell + i, -1) for i in range(2))
    root = bracketed_root(lambda t: along(peak, t).omega - omega, *ends, rounds=ROUNDS)
    point = along(peak, root)
    if not motion.feels_frequency:
        return np.asarray(point.y * np.exp(1j * point.phase), complex)
    # The table has loops at the resonance frequency. If a law depends on the frequency, the loop at
    # the excitation frequency corrects the amplitude.
    ratio = held_ratio(motion, point.y, np.broadcast_to(omega, point.y.shape))
    missing = peak.level[..., None] / (point.y * np.abs(ratio)) - 1.0
    y = point.y * (1.0 + missing / np.maximum(point.rise, LEAST_RISE))
    return np.asarray(y * np.exp(-1j * np.angle(ratio)), complex)


def held_ratio(motion: EquivalentMotion, y: Values, omega: Values) -> Complexes:
    """Return the complex ratio force / displacement at amplitude y and omega [1/s^2]."""
    stiffness, loss = motion.values(y, omega)
    return stiffness - omega**2 + 1j * (wide(motion.viscous, y) * omega + loss)


def level_that_holds(motion: EquivalentMotion, y: Values, omega: Values) -> Values:
    """Return the force amplitude [N/kg] that holds the displacement amplitude y at omega.

    This is response control, or notching: where a sweep's level is larger, it is lowered to this
    one.
    """
    return y * np.abs(held_ratio(motion, y, omega))


def base_gain(
    ratio: Complexes, omega: Values, participation: float = 1.0, shape: float = 1.0
) -> Complexes:
    r"""Return the ratio of a point's absolute acceleration to the acceleration of the base.

    $$\frac{a}{a_b} = 1 + \frac{p\,s\,\omega^2}{F_1/Z}$$

    Damper and joint act on the motion z relative to the base, which -p a_b drives. The curves are
    therefore those of the force amplitude p a_b.

    Args:
        ratio: Force amplitude over relative displacement amplitude, complex [1/s^2].
        omega: Frequency [rad/s].
        participation: Participation p of the mode in the motion of the base.
        shape: Motion s of the point in the mode.
    """
    return 1.0 + participation * shape * omega**2 / ratio
