"""A test beside what is predicted of it: what every kind of test hands back."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jbw.measurement.records import Test
from jbw.verification.bands import band
from jbw.verification.draws import Draws, References
from jbw.verification.noise import Noise
from jbw.verification.predictive_basis import Basis


class Predicted(NamedTuple):
    """A test beside its prediction.

    Attributes:
        dataset: Measured values and bands.
        peak: Peak displacement of every draw [m]; None where the test does not tell it.
        noise: Noise of one repeat.
    """

    dataset: xr.Dataset
    peak: NDArray[np.float64] | None
    noise: Noise

    def extrapolation(self, basis: Basis) -> float | None:
        """Upper edge of the peak displacement over the largest that was fitted, where known."""
        if self.peak is None or basis.y_peak <= 0:
            return None
        return float(band(self.peak)[-1]) / basis.y_peak


@dataclass(frozen=True)
class Source:
    """What is carried through the model, and with what it is compared.

    Attributes:
        basis: The run.
        draws: Parameters of the joint and gain.
        references: Oscillators without hysteresis that are carried beside them, by name.
        noise: Whether the noise is part of the bands, where it is known.
        bare: Noise of bands whose noise is not known: 0 counts what lies in the band of the
            parameters alone, None counts nothing.
        seed: Of what is drawn on the way.
    """

    basis: Basis
    draws: Draws
    references: References = field(default_factory=dict)
    noise: bool = True
    bare: float | None = None
    seed: int = 0

    def std(self, known: Noise, num_repeats: float = 1.0) -> float | None:
        """Noise of the mean of some repeats for the bands; None where they have none."""
        if not self.noise or known.std is None:
            return self.bare
        return known.std / float(np.sqrt(num_repeats))


def is_measured(test: Test) -> bool:
    """Whether a test has a response, or is only planned."""
    record = test.records[0]
    return bool(np.any(np.isfinite(record.channels[record.response])))
