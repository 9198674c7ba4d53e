"""The residual of a force loop that is fitted by friction sliders and springs."""

from typing import NamedTuple

import numpy as np

from jbw.measurement.channels import Reals
from jbw.measurement.curves import ForcedLoop
from jbw.measurement.readings.loop import Columns, LoopBasis, LoopFit, fit_loop
from jbw.measurement.records import Record
from jbw.report.messages.message import FaultText


class LoopResidual(NamedTuple):
    """A force loop, the columns for a fit of a loop without faults, and its record.

    Attributes:
        loop: Displacement and force, at every `every`-th sample of the record.
        basis: Columns of sliders, springs and stated effects.
        zero: Columns of unstated parts of the load cell's zero.
        record: The whole record.
        delay_s: Stated lag of the force [s].
        every: Distance of the samples of `loop`, in samples of the record.
    """

    loop: ForcedLoop
    basis: LoopBasis
    zero: Columns
    record: Record
    delay_s: float
    every: int

    def with_zero(self) -> "LoopResidual":
        """Return a copy in which the fit without faults also includes the load cell's zero."""
        basis = LoopBasis(self.basis.losses, np.column_stack([self.basis.springs, self.zero]))
        return self._replace(basis=basis, zero=self.zero[:, :0])

    def fit(self, *columns: Reals) -> LoopFit:
        """Fit the force by sliders, springs and the given additional columns."""
        return fit_loop(self.basis, self.loop.force, columns)


class LoopCause(NamedTuple):
    """The residual sum of squares of a loop fit that includes a fault, with the fault's text."""

    square: float
    text: FaultText
    role: str = "restoring_force"


def path_of(loop: ForcedLoop) -> Columns:
    """Return the travelled path relative to its total length, and its square, one row each."""
    path = np.append(0.0, np.cumsum(np.abs(np.diff(loop.displacement))))
    return np.stack([path / path[-1], (path / path[-1]) ** 2])
