"""A load cell whose zero is wrong or drifts along the record: $c_0 + c_1 t$."""

from collections.abc import Iterator

import numpy as np

from jbw.measurement.channels import Reals
from jbw.measurement.curves import ForcedLoop
from jbw.measurement.faults.hypothesis import Hypothesis
from jbw.measurement.faults.loop_residual import LoopCause, LoopResidual
from jbw.measurement.loops import begins_unmoved
from jbw.report.messages import loop_faults as messages

# A joint counts as at rest while it moves less than this fraction of the whole stroke.
STILL = 1e-3


class ZeroOfLoadCell(Hypothesis):
    """The fault that a load cell's zero is offset or drifts."""

    name = "zero of load cell"

    def in_loop(self, residual: LoopResidual) -> Iterator[LoopCause]:
        """Yield a wrong zero of the load cell as a possible cause of a loop fit's residual."""
        if not residual.zero.shape[1]:
            return
        found, half_range = residual.fit(*residual.zero.T), 0.5 * np.ptp(residual.loop.force)
        offset, drift = np.pad(found.beside, (2 - len(found.beside), 0)) / half_range
        yield LoopCause(found.square, messages.off_centre(float(offset), float(drift)))


def at_rest(loop: ForcedLoop) -> Reals:
    """Return the force before the motion starts, which must be zero for every law."""
    y = loop.displacement
    if not begins_unmoved(y):
        return loop.force[:0]
    return loop.force[: int(np.argmax(np.abs(y - y[0]) > STILL * np.ptp(y)))]


def loaded(rest: Reals, force: Reals) -> Iterator[LoopCause]:
    """Yield a load cell's offset as a cause, estimated from the force before the motion."""
    text = messages.off_centre(float(np.mean(rest) / (0.5 * np.ptp(force))), 0.0)
    yield LoopCause(len(rest) * float(np.var(rest)), text)
