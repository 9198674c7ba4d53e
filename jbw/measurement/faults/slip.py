"""A displacement gauge that slips once: the measured motion jumps, the force does not."""

from collections.abc import Iterator

import numpy as np

from jbw.measurement.faults.hypothesis import Hypothesis
from jbw.measurement.faults.loop_residual import LoopCause, LoopResidual
from jbw.measurement.readings.loop import basis_of, fit_loop
from jbw.measurement.spans import kept_part, start_of
from jbw.report.messages import loop_faults as messages

SLIPS = 3  # number of times at which the gauge may have slipped that are tried
# The usual step of the motion is the median over this number of steps on either side.
NEIGHBOURS = 2


class Slip(Hypothesis):
    """The fault that a displacement gauge slipped: time and size of the slip."""

    name = "slip of the gauge"

    def in_loop(self, residual: LoopResidual) -> Iterator[LoopCause]:
        """Yield slips of the gauge at the times at which a step of the motion is most unusual."""
        loop, record, every = residual.loop, residual.record, residual.every
        steps = np.diff(loop.displacement)
        around = np.lib.stride_tricks.sliding_window_view(steps, 2 * NEIGHBOURS + 1)
        unlike = steps[NEIGHBOURS:-NEIGHBOURS] - np.median(around, axis=1)
        before = loop.begins - start_of(record)  # A stated delay may exclude the first samples.
        skipped = round(before * record.fs) if before else 0
        for place in np.argsort(np.abs(unlike))[-SLIPS:].tolist():
            first = place + NEIGHBOURS + 1  # first sample after the slip
            motion = loop.displacement.copy()
            motion[first:] -= unlike[place]
            found = fit_loop(basis_of(motion), loop.force)
            spoilt = np.zeros(len(record.channels["displacement"]), bool)
            last = skipped + first * every
            spoilt[last - every + 1 : last + 1] = True
            at, keep = before + first / loop.fs, kept_part(record, spoilt)
            text = messages.slipped(float(unlike[place]), at, keep)
            yield LoopCause(found.square, text, "displacement")
