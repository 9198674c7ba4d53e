r"""Faults of force loops, and features of the joint that a law may lack.

A cause is named if sliders leave more than 1 % of the rms of the force beyond noise, and the cause
explains 85 % of its sum of squares. Effects that a campaign states, a drifting zero or a
wearing law, are fitted together with the sliders from the beginning.

One feature is a joint that is stronger to one side. Another is free travel: each stroke becomes
stiffer towards its end, where slip alone makes it softer, and the mean of both strokes at each
displacement has kinks. The mean is fitted by the best of

$$a + b\,y + c\,y^3, \quad a + b\,y + c\,y^5, \quad
  a + b\,y + c\,\mathrm{sgn}(y)\,(|y| - g)_+$$
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from jbw.measurement.channels import Reals, noise_of
from jbw.measurement.curves import FORCES, ForcedLoop, forced_loop
from jbw.measurement.faults.channels import held_for
from jbw.measurement.faults.fault import Fault, doubt
from jbw.measurement.faults.hypotheses import HYPOTHESES
from jbw.measurement.faults.loop_hypotheses import ZeroOfLoadCell, at_rest, loaded
from jbw.measurement.faults.loop_residual import LoopCause, LoopResidual, path_of
from jbw.measurement.loops import begins_unmoved, cycles_of, lopsided
from jbw.measurement.readings.loop import MOST_SAMPLES, Columns, LoopBasis, basis_of
from jbw.measurement.records import LOAD_CELLS, Record
from jbw.report.messages import loop_faults as messages

LOPSIDED = 0.25  # difference of the peak forces in both directions, divided by their sum
FREE = ("gap_series", "stop")  # laws with contacts
POINTS = 40  # number of points of the mean of the loading and the unloading stroke
END = POINTS // 8  # number of values at the end of a stroke from which its slope is determined
# A stroke stiffens if the slope at its end exceeds its smallest slope by this factor.
TWICE = 1.5
# smallest ratio of the contact's stiffness to that of the free travel; a smaller ratio shows that
# there is no gap
STIFFER = 1.0
GAPS = np.linspace(0.04, 0.9, 44)  # half the free travel, divided by the amplitude
BETTER = 0.4  # largest residual sum of squares with a gap, divided by that with a smooth spring
# largest residual of a sound loop, in excess of noise, relative to the rms of the force
LEFT = 0.01
OFF = 0.02  # largest force before the motion, relative to the rms of the force
# factor by which the residual of sliders may exceed the noise's sum of squares by chance
NOISE = 1.2
EXPLAINS = 0.85  # fraction of the residual in excess of noise that a cause must explain
FEWEST = 64  # fewest samples of a loop
WEARING = ("bwbn", "bwbn_pinching")  # laws under which every cycle changes the joint


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


def loop_causes(
    record: Record, delay: float, load_cell: str = "exact", laws: Sequence[str] = ()
) -> Iterator[Fault]:
    """Yield a wrong zero of the load cell, and the likeliest cause of a loop's remaining residual.

    Args:
        record: A record of kind `loop`.
        delay: Stated lag of its force [s].
        load_cell: Stated behaviour of the zero of the load cell.
        laws: Stated laws of the joint.
    """
    record, lag_s = _each_once(record)
    whole = forced_loop(record, delay - lag_s if delay else 0.0)
    every = -(-len(whole.force) // MOST_SAMPLES)
    loop = whole._replace(
        fs=whole.fs / every, displacement=whole.displacement[::every], force=whole.force[::every]
    )
    force = loop.force
    if len(force) < FEWEST or not np.ptp(loop.displacement) or not np.ptp(force):
        return
    residual = LoopResidual(loop, *_bases(loop, load_cell, laws), record, delay, every)
    found = [*_named(force, force, residual.fit().square, ZeroOfLoadCell().in_loop(residual))]
    if not found and load_cell == "exact":
        rest = at_rest(whole)
        found = [*_named(whole.force, rest, float(rest @ rest), loaded(rest, whole.force), OFF)]
    yield from found
    residual = residual.with_zero()
    others = (cause for one in HYPOTHESES for cause in one.in_loop(residual))
    yield from _named(force, force, residual.fit().square, others)


def _each_once(record: Record) -> tuple[Record, float]:
    """Return a record without repeated values of the force, and the lag of the repetition [s].

    The force is correct at the first of several equal samples.
    """
    force = next(record.channels[role] for role in FORCES if role in record.channels)
    each, first = held_for(force)
    if each == 1:
        return record, 0.0
    channels = {role: x[first::each] for role, x in record.channels.items()}
    return replace(record, fs=record.fs / each, channels=channels), (each - 1) / 2 / record.fs


def _named(
    force: Reals, part: Reals, square: float, tried: Iterable[LoopCause], least: float = LEFT
) -> Iterator[Fault]:
    """Yield the fault that explains most of a residual, if it explains enough of it."""
    noise = noise_of(force) ** 2 * len(part)
    if square - NOISE * noise < least**2 * len(part) * np.var(force) or len(part) < FEWEST:
        return
    most = noise + (1 - EXPLAINS) * (square - noise)
    causes = [cause for cause in tried if cause.square < most]
    if causes:
        best = min(causes, key=lambda cause: cause.square)
        yield doubt(best.role, *best.text)


def _bases(loop: ForcedLoop, load_cell: str, laws: Sequence[str]) -> tuple[LoopBasis, Columns]:
    """Return columns of stated effects, and of zero errors of the load cell that are not stated."""
    basis = basis_of(loop.displacement)
    known = LOAD_CELLS.index(load_cell)
    if not begins_unmoved(loop):
        # If a loop begins after other motion, sliders that stay stuck add a constant force.
        known = max(known, 1)
    springs, zero = np.split(basis.springs, [basis.springs.shape[1] - 2 + known], axis=1)
    if set(laws) & set(WEARING):
        springs = np.column_stack([springs, *(path_of(loop) * loop.force)])
    return LoopBasis(basis.losses, springs), zero
