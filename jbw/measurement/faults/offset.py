"""A constant offset of a response: a structure that starts from rest has no such motion."""

from collections.abc import Iterator

import numpy as np

from jbw.measurement.channels import Reals
from jbw.measurement.faults.fault import Fault, doubt
from jbw.measurement.faults.hypothesis import Hypothesis
from jbw.measurement.faults.suspect import Misfit, Suspect, in_time
from jbw.measurement.records import Record
from jbw.report.messages import response_faults as messages
from jbw.report.messages.message import FaultText

# largest mean of a response, divided by its standard deviation; more is an offset of the channel
OFFSET = 1.0


class Offset(Hypothesis):
    """The fault that responses have a constant offset."""

    name = "offset of the response"

    def suspects(self, misfit: Misfit) -> Iterator[Suspect]:
        """Yield columns of a constant offset for each data group compared sample by sample."""
        groups = in_time(misfit.spectra)
        units = zip(groups.items(), np.eye(len(groups)), strict=True)
        columns = {n: np.tile(unit, (len(s.values), 1)) for (n, s), unit in units}

        def text(offsets: Reals) -> FaultText:
            shares = np.abs(offsets) / [np.std(s.values) for s in groups.values()]
            largest = int(np.argmax(shares))
            return messages.offset(float(shares[largest]), f" of {list(groups)[largest]}")

        if groups:
            yield Suspect(columns, text)


def offset(record: Record) -> Iterator[Fault]:
    """Yield a warning if the mean of a response exceeds its standard deviation."""
    x = record.channels[record.response]
    if abs(np.mean(x)) > OFFSET * np.std(x):
        yield doubt(record.response, *messages.offset(abs(np.mean(x)) / np.std(x)))
