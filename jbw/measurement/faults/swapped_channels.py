"""Input and response that are exchanged: the input has the resonance."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from jbw.measurement.faults.fault import Fault, doubt
from jbw.measurement.faults.hypothesis import Hypothesis
from jbw.measurement.faults.suspect import Cause, Misfit, stiffness
from jbw.measurement.spectra import FRF
from jbw.report.messages import record_faults as messages

# number of segments: small, but large enough for a resonance to stand out of the spectra
SEGMENTS = 8
FLOOR = 1e-4  # Lines below this fraction of the largest density are outside the excitation.
# An input whose spectrum is more peaked than the response's by this factor looks like a response.
PEAKED = 10.0


class SwappedChannels(Hypothesis):
    """The fault that input and response of a test are exchanged."""

    name = "swapped channels"

    def suspects(self, misfit: Misfit) -> Iterator[Cause]:
        """Yield, for each test, how well the mode predicts the input from the response."""
        for label in misfit.missed:
            spectrum, norm = misfit.spectra[label], np.linalg.norm
            modelled = spectrum.factor * spectrum.measured / stiffness(misfit.theta, spectrum.omega)
            along = np.vdot(modelled, spectrum.source).real / np.vdot(modelled, modelled).real
            residual = norm(spectrum.source - along * modelled) / norm(spectrum.source)
            if along != 0:
                explained = 1 - (residual / misfit.error(label)) ** 2
                yield Cause(messages.swapped(f" of {label}"), float(explained), label)


def peaked_input(source: str, estimate: FRF) -> Iterator[Fault]:
    """Yield a warning if an input's spectrum is far more peaked than the response's spectrum."""
    lines = carried(estimate)
    if lines.sum() < SEGMENTS:
        return
    spectra = (estimate.input_spectrum[lines], estimate.output_spectrum[lines])
    of_input, of_response = (float(x.max() / np.median(x)) for x in spectra)
    if of_input >= PEAKED * of_response:
        yield doubt(source, *messages.swapped(ratio=of_input / of_response))


def carried(estimate: FRF) -> NDArray[np.bool_]:
    """Return a mask of the lines at which both input and response have power."""
    force, response = estimate.input_spectrum, estimate.output_spectrum
    return (force > FLOOR * force.max()) & (response > FLOOR * response.max())
