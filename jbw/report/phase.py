"""Phases in degrees that do not jump by a turn where nothing happens."""

from typing import Any

import numpy as np
from jaxtyping import Float

TURN = 360.0


def wrap_degrees(phase: Any) -> Float[np.ndarray, "..."]:
    """Return phases [rad] in degrees within [-270, 90), so that a receptance does not jump."""
    return (np.degrees(phase) + 270.0) % TURN - 270.0


def wrap_band(phase: Any) -> Float[np.ndarray, "quantile freq"]:
    """Return a phase band [rad] in degrees, each frequency turned as a whole by its median."""
    degrees = np.degrees(phase)
    return degrees + (wrap_degrees(np.asarray(phase)[1]) - degrees[1])


def unwrapped_band(phase: Any) -> Float[np.ndarray, "quantile freq"]:
    """Return a phase band [rad] in degrees, its median continuous and centred within half a turn.

    A velocity's phase then runs from 90 to -90 degrees, a force's from 0 to 180.
    """
    degrees = np.degrees(phase)
    middle = np.unwrap(degrees[1], period=TURN)
    centre = 0.5 * (np.nanmax(middle) + np.nanmin(middle))
    return degrees - degrees[1] + middle - TURN * np.round(centre / TURN)


def beside(phase: Any, degrees: Float[np.ndarray, " freq"]) -> Float[np.ndarray, "... freq"]:
    """Return phases [rad] in degrees, each within half a turn of the curve `degrees`."""
    away = np.degrees(phase) - degrees
    return degrees + (away + TURN / 2) % TURN - TURN / 2
