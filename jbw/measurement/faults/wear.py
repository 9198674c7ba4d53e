"""A joint that wears along its path s: $F = F_0 + (w_1 s + w_2 s^2) F$, F_0 without wear."""

from collections.abc import Iterator

import numpy as np

from jbw.measurement.faults.hypothesis import Hypothesis
from jbw.measurement.faults.loop_residual import LoopCause, LoopResidual, path_of
from jbw.measurement.loops import cycles_of, of_one_amplitude
from jbw.measurement.spans import span_line
from jbw.report.messages import loop_faults as messages


class Wear(Hypothesis):
    """The change of a joint's force by wear, with the travelled path and its square."""

    name = "wear of the joint"

    def in_loop(self, residual: LoopResidual) -> Iterator[LoopCause]:
        """Yield wear with the travelled path as a possible cause of a loop fit's residual."""
        loop = residual.loop
        if not (groups := of_one_amplitude(cycles_of(loop))):
            return
        path = path_of(loop)
        found = residual.fit(*(path * loop.force))
        strength = 1 / (1 - found.beside @ path)
        changes = [
            float(np.median(strength[last.samples]) / np.median(strength[second.samples]) - 1)
            for _, second, *_, last in groups
        ]
        change, cycles = max(zip(changes, groups, strict=True), key=lambda pair: abs(pair[0]))
        ends = cycles[-2].samples.start / loop.fs, cycles[-1].samples.stop / loop.fs
        keep, amplitude = span_line(*ends, loop.begins), 0.5 * cycles[-1].stroke
        text = messages.degrading(amplitude, len(cycles), abs(change), keep, falls=change < 0)
        yield LoopCause(found.square, text)
