r"""What a test's own residual constants add to its prediction, read off the test itself.

$$\min_{U, L} \sum \bigl(y - \hat y - (U + L/\omega^2)\,u\bigr)^2$$

The fit integrates them out, and no other test knows them: they are two numbers of every record, as
its level is. The joint is judged by what is left beside them.
"""

import numpy as np
from jaxtyping import Float

from jbw.measurement.records import Test
from jbw.observables.residual_terms import own_columns
from jbw.observables.samples import in_band, lines_of
from jbw.oscillator.modes.parameters import has_further_modes
from jbw.verification.predictive_basis import Basis


def has_own_constants(basis: Basis, test: Test) -> bool:
    """Whether a test's constants are its own: as it states, or as all are of several modes."""
    of_modes = test.residuals == "auto" and has_further_modes(basis.posterior)
    return test.residuals == "own" or of_modes


def with_own_constants(
    model: Float[np.ndarray, "draw time"],
    measured: Float[np.ndarray, " time"],
    test: Test,
    start: int = 0,
) -> Float[np.ndarray, "draw time"]:
    """Responses with the U and L by which their median comes nearest to what was measured.

    From a first sample on, in the test's band, under the input of its first record.
    """
    record = test.records[0]
    force = record.channels[record.source][start : len(measured)]
    lines = lines_of(test.band_hz or (), len(force), record.fs)
    (columns,) = own_columns(force[None], record.fs, record.response, None)
    left = (measured - np.median(model, axis=0))[start:]
    kept = in_band(columns, lines)
    size = np.linalg.norm(kept, axis=1)[:, None]
    found = np.linalg.lstsq((kept / size).T, in_band(left, lines))[0]
    added = np.pad(found @ (columns / size), (start, 0))
    return model + added
