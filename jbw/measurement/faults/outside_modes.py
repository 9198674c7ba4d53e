r"""The response of modes outside the band: $X = (R - M / \omega^2)\,U$."""

from collections.abc import Iterator

import numpy as np

from jbw.measurement.faults.hypothesis import Hypothesis
from jbw.measurement.faults.suspect import Misfit, Suspect, as_columns
from jbw.report.messages import causes as messages


class OutsideModes(Hypothesis):
    """The fault that modes outside the band add a compliance and a mass, common to all tests."""

    name = "modes outside the band"

    def suspects(self, misfit: Misfit) -> Iterator[Suspect]:
        """Yield columns of a compliance and a mass that represent modes outside the band."""
        columns = {}
        for label, spectrum in misfit.spectra.items():
            stiff, squares = spectrum.factor * spectrum.source, spectrum.omega**2
            mass = np.divide(-stiff, squares, out=np.zeros_like(stiff), where=squares > 0)
            columns[label] = as_columns(spectrum.row(stiff), spectrum.row(mass))
        yield Suspect(columns, lambda terms: messages.residual_term(terms[0]))
