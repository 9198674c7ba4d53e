r"""A force after a charge amplifier's high-pass, which subtracts $\frac1T\int F\,\mathrm{d}t$."""

from collections.abc import Iterator

import numpy as np

from jbw.measurement.faults.hypothesis import Hypothesis
from jbw.measurement.faults.loop_residual import LoopCause, LoopResidual
from jbw.report.messages import loop_faults as messages


class HighPass(Hypothesis):
    """The fault that a force was measured through a charge amplifier's high-pass filter."""

    name = "high-pass of the force"

    def in_loop(self, residual: LoopResidual) -> Iterator[LoopCause]:
        """Yield a high-pass filter of the force as a possible cause of a loop fit's residual."""
        force, fs = residual.loop.force, residual.loop.fs
        integral = np.append(0.0, np.cumsum(0.5 * (force[1:] + force[:-1]) / fs))
        found = residual.fit(-integral)
        rate = float(found.beside[0])
        if rate > 0:
            yield LoopCause(found.square, messages.high_passed(1 / rate))
