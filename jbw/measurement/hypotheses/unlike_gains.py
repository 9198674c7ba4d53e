"""Repeats whose response over the drive has a sign or size unlike that of most, or of a mass."""

from collections.abc import Iterator, Sequence

import numpy as np

from jbw.measurement.checks.faults import Fault, doubt
from jbw.report.messages import clock_faults as messages
from jbw.report.messages.record_faults import base_motion, negative_gain

BASE = 0.1  # from -1: gains of a base's acceleration, -1 of one mode, are read to 4 % and better
LARGER = 1.5  # times the median, or smaller by as much: no joint changes a modal mass so


def unlike_gains(
    gains: Sequence[tuple[str, float]], role: str, source: str
) -> Iterator[tuple[str, Fault]]:
    """Yield repeats by name, with the doubt that a channel has another sign or unit there.

    A force drives the mode that it is measured with by a positive gain, one over a modal mass.

    Args:
        gains: Name of every repeat and gain of its mode; NaN where none was read.
        role: Of the response.
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
    """Return the doubt of a response that moves against its drive, by a gain [1/kg]."""
    is_base = role == "acceleration" and abs(gain + 1) < BASE
    return doubt(role, *(base_motion(gain) if is_base else negative_gain(role)))
