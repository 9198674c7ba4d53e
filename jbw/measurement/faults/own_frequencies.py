"""Tests with separate natural frequencies and damping, for example on different days."""

from collections.abc import Iterator

import numpy as np

from jbw.measurement.channels import Reals
from jbw.measurement.faults.hypothesis import Hypothesis
from jbw.measurement.faults.suspect import Misfit, Suspect, as_columns
from jbw.report.messages import causes as messages
from jbw.report.messages.message import FaultText


class OwnFrequencies(Hypothesis):
    """The fault that each test has a separate natural frequency and damping ratio."""

    name = "natural frequency of tests"

    def suspects(self, misfit: Misfit) -> Iterator[Suspect]:
        """Yield columns that state how separate frequencies and damping change the data."""
        slopes, count = misfit.slopes, len(misfit.slopes)
        if len(misfit.spectra) < 2 or not slopes:
            return
        columns = {}
        for place, label in enumerate(misfit.spectra):
            own = as_columns(*(-slope[label] for slope in slopes.values()))
            others = count * place, count * (len(misfit.spectra) - 1 - place)
            columns[label] = np.pad(own, ((0, 0), others))
        unit = misfit.theta["omega_n"] if "omega_n" in slopes else 1.0

        def text(offsets: Reals) -> FaultText:
            return messages.natural_frequencies(float(np.std(offsets[::count]) / unit))

        yield Suspect(columns, text)
