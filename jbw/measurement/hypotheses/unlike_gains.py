"""Repeats whose response over drive differs in sign or size from most, or from a modal mass."""

from collections.abc import Iterator, Sequence

import numpy as np

from jbw.measurement.checks.faults import Fault, doubt
from jbw.report.messages import clock_faults as messages
from jbw.report.messages.record_faults import base_motion, negative_gain

# Distance from -1, the gain of a base's acceleration for one mode, read to 4 % or better.
BASE = 0.1
LARGER = 1.5  # ratio to the median; no joint changes a modal mass that much


def unlike_gains(
    gains: Sequence[tuple[str, float]], role: str, source: str
) -> Iterator[tuple[str, Fault]]:
    """Yield repeats by name, each with a warning that a channel there has another sign or unit.

    A force that is measured at the mode's own point drives it with a positive gain, one over a
    modal mass.

    Args:
        gains: Name of each repeat and gain of its mode; NaN if none was read.
        role: Role of the response.
        source: Role of the drive.
    """
    known = [(name, gain) for name, gain in gains if np.isfinite(gain) and gain != 0.0]
    if not known:
        return
    if all(gain < 0 for _, gain in known):
        yield from ((name, turned_over(role, gain)) for name, gain in known)
        return
    size = float(np.median([abs(gain) for _, gain in known]))
    signs = [np.sign(gain) for _, gain in known]
    usual = np.sign(sum(signs)) or signs[0]
    for name, gain in known:
        ratio = abs(gain) / size
        if np.sign(gain) != usual:
            yield name, doubt(role, *messages.other_sign(source))
        elif not 1 / LARGER < ratio < LARGER:
            yield name, doubt(role, *messages.other_gain(ratio, source))


def turned_over(role: str, gain: float) -> Fault:
    """Return a warning that the response moves against its drive, from its gain [1/kg]."""
    is_base = role == "acceleration" and abs(gain + 1) < BASE
    return doubt(role, *(base_motion(gain) if is_base else negative_gain(role)))
