"""The faults of a force loop that explain the residual of a fit by friction sliders and springs.

A cause is named if sliders leave more than 1 % of the rms of the force beyond noise, and the cause
explains 85 % of its sum of squares. Effects that a campaign states, a drifting zero or a
wearing law, are fitted together with the sliders from the beginning.
"""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from jbw.measurement.channels import Reals, noise_of
from jbw.measurement.curves import ForcedLoop, forced_loop
from jbw.measurement.faults.fault import Fault, doubt
from jbw.measurement.faults.hypotheses import HYPOTHESES
from jbw.measurement.faults.load_cell import ZeroOfLoadCell, at_rest, loaded
from jbw.measurement.faults.loop_residual import LoopCause, LoopResidual, path_of
from jbw.measurement.loops import begins_unmoved
from jbw.measurement.readings.loop import MOST_SAMPLES, Columns, LoopBasis, basis_of
from jbw.measurement.records import LOAD_CELLS, Record

# largest residual of a sound loop, in excess of noise, relative to the rms of the force
LEFT = 0.01
OFF = 0.02  # largest force before the motion, relative to the rms of the force
# factor by which the residual of sliders may exceed the noise's sum of squares by chance
NOISE = 1.2
EXPLAINS = 0.85  # fraction of the residual in excess of noise that a cause must explain
FEWEST = 64  # fewest samples of a loop
WEARING = ("bwbn", "bwbn_pinching")  # laws under which every cycle changes the joint


def loop_causes(
    record: Record, delay: float, load_cell: str = "exact", laws: Sequence[str] = ()
) -> Iterator[Fault]:
    """Yield a wrong zero of the load cell, and the one cause of a loop's remaining residual.

    Args:
        record: A record of kind `loop`.
        delay: Stated lag of its force [s].
        load_cell: Stated behaviour of the zero of the load cell.
        laws: Stated laws of the joint.
    """
    whole = forced_loop(record, delay)
    every = -(-len(whole.force) // MOST_SAMPLES)
    loop = ForcedLoop(
        whole.fs / every, whole.displacement[::every], whole.force[::every], whole.begins
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
    """Return the columns of stated effects, and those of a load cell's zero that was not stated."""
    y, basis = loop.displacement, basis_of(loop.displacement)
    known = LOAD_CELLS.index(load_cell)
    if not begins_unmoved(y):
        # Sliders that are fully stuck at the start contribute a constant force.
        known = max(known, 1)
    springs, zero = np.split(basis.springs, [basis.springs.shape[1] - 2 + known], axis=1)
    if set(laws) & set(WEARING):
        springs = np.column_stack([springs, *(path_of(loop) * loop.force)])
    return LoopBasis(basis.losses, springs), zero
