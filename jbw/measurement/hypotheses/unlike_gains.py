"""Repeats whose response over the drive has another sign or size than that of most."""

from collections.abc import Iterator, Sequence

import numpy as np

from jbw.measurement.checks.faults import Fault, doubt
from jbw.report.messages import clock_faults as messages

LARGER = 1.5  # times the median, or smaller by as much: no joint changes a modal mass so


def unlike_gains(
    gains: Sequence[tuple[str, float]], role: str, source: str
) -> Iterator[tuple[str, Fault]]:
    """Yield repeats by name, with the doubt that a channel has another sign or unit there.

    Args:
        gains: Name of every repeat and gain of its mode; NaN where none was read.
        role: Of the response.
        source: Role of the drive.
    """
    known = [(name, gain) for name, gain in gains if np.isfinite(gain) and gain != 0.0]
    if len(known) < 2:
        return
    size = float(np.median([abs(gain) for _, gain in known]))
    signs = [np.sign(gain) for _, gain in known]
    usual = np.sign(sum(signs)) or signs[0]
    for name, gain in known:
        ratio = abs(gain) / size
        if np.sign(gain) != usual:
            yield name, doubt(role, *messages.other_sign(name, source))
        elif not 1 / LARGER < ratio < LARGER:
            yield name, doubt(role, *messages.other_gain(name, ratio, source))
