r"""Features of force loops under prescribed displacement that the joint's law may lack.

The first is a joint that is stronger to one side. The second is free travel: each stroke becomes
stiffer towards its end, where slip alone makes it softer, and the mean of both strokes at each
displacement has kinks. The mean is fitted by the best of

$$a + b\,y + c\,y^3, \quad a + b\,y + c\,y^5, \quad
  a + b\,y + c\,\mathrm{sgn}(y)\,(|y| - g)_+$$
"""

from collections.abc import Iterator, Sequence

import numpy as np

from jbw.measurement.channels import Reals
from jbw.measurement.curves import ForcedLoop
from jbw.measurement.faults.fault import Fault, doubt
from jbw.measurement.loops import cycles_of, lopsided
from jbw.report.messages import loop_faults as messages

LOPSIDED = 0.25  # difference of the peak forces in both directions, divided by their sum
FREE = ("gap_series", "stop")  # laws with contacts
POINTS = 40  # number of points of the mean of the loading and the unloading stroke
END = POINTS // 8  # number of values at the end of a stroke from which its slope is determined
# A stroke stiffens if the slope at its end exceeds its smallest slope by this factor.
TWICE = 1.5
# smallest ratio of the contact's stiffness to that of the free travel; with less there is no gap
STIFFER = 1.0
GAPS = np.linspace(0.04, 0.9, 44)  # half the free travel, divided by the amplitude
BETTER = 0.4  # largest residual sum of squares with a gap, divided by that with a smooth spring


def one_sided(loop: ForcedLoop) -> Iterator[Fault]:
    """Yield a warning if a joint's peak force is clearly larger in one direction."""
    side = lopsided(loop)
    if abs(side) > LOPSIDED:
        ratio = (1 + abs(side)) / (1 - abs(side))
        yield doubt("restoring_force", *messages.lopsided(ratio, positive=side > 0))


def travels_freely(loop: ForcedLoop, laws: Sequence[str]) -> Iterator[Fault]:
    """Yield a warning if a joint travels freely between two contacts but its laws have no gap."""
    cycles = cycles_of(loop)
    if not cycles or set(laws) & set(FREE):
        return
    largest = max(cycles, key=lambda cycle: cycle.stroke)
    gap = _gap_of(loop.displacement[largest.samples], loop.force[largest.samples])
    if gap is None:
        return
    listed = ", ".join(f'"{name}"' for name in (*(n for n in laws if n != "bouc_wen"), FREE[0]))
    yield doubt("restoring_force", *messages.free_travel(gap, largest.stroke, listed))


def _gap_of(y: Reals, force: Reals) -> float | None:
    """Return half the free travel in a cycle [m]; None if a smooth spring fits equally well."""
    lowest = int(np.argmin(y))
    centre, reach = 0.5 * (y.max() + y.min()), 0.5 * np.ptp(y)
    if lowest < POINTS // 4 or len(y) - lowest < POINTS // 4:
        return None
    x = np.linspace(-0.97, 0.97, POINTS)
    strokes = [
        np.interp(x, (y[part] - centre) / reach, force[part])
        for part in (slice(lowest, None), slice(lowest, None, -1))
    ]
    if not all(_stiffens(stroke) for stroke in (strokes[0], -strokes[1][::-1])):
        return None
    middle = np.mean(strokes, axis=0)

    def fitted(bend: Reals) -> tuple[float, Reals]:
        columns = np.stack([np.ones(POINTS), x, bend], axis=1)
        values = np.linalg.lstsq(columns, middle)[0]
        return float(np.sum((middle - columns @ values) ** 2)), values

    smooth = min(fitted(x**power)[0] for power in (3, 5))
    contacts = [(*fitted(np.sign(x) * np.maximum(np.abs(x) - g, 0)), g) for g in GAPS]
    residual, (_, free, contact), gap = min(contacts, key=lambda fit: fit[0])
    if residual > BETTER * smooth or contact < STIFFER * abs(free):
        return None
    return float(gap * reach)


def _stiffens(stroke: Reals) -> bool:
    """Return whether a stroke stiffens at its end, given forces at even steps of displacement."""
    slopes = stroke[END:] - stroke[:-END]
    return bool(slopes[-1] > TWICE * np.min(slopes[:-END]))
