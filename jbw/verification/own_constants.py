r"""What a test's own residual constants add to its prediction, read off the test itself.

$$\min_{U, L} \sum \bigl(y - \hat y - (U + L/\omega^2)\,u\bigr)^2$$

The fit integrates them out, and no other test knows them: they are two numbers of every record, as
its level is. The joint is judged by what is left beside them.
"""

import numpy as np
from jaxtyping import Float

from jbw.measurement.records import Test
from jbw.observables.residual_terms import has_own, own_columns
from jbw.observables.samples import in_band, lines_of
from jbw.oscillator.modes.parameters import has_further_modes
from jbw.verification.predictive_basis import Basis

Time = Float[np.ndarray, " time"]
Draws = Float[np.ndarray, "draw time"]
Others = dict[str, Time]


def completed(
    basis: Basis, test: Test, measured: Time, model: Draws, others: Others, start: int = 0
) -> tuple[Draws, Others]:
    """Responses of a model and of oscillators beside it, with a test's own constants if it has any.

    From a first sample on, in the test's band, under the input of its first record.
    """
    if not has_own(test.residuals, several_modes=has_further_modes(basis.posterior)):
        return model, others
    record = test.records[0]
    force = record.channels[record.source][start : len(measured)]
    lines = lines_of(test.band_hz or (), len(force), record.fs)
    (columns,) = own_columns(force[None], record.fs, record.response, None)
    columns_in_band = in_band(columns, lines)
    size = np.linalg.norm(columns_in_band, axis=1)[:, None]

    def added(response: Time) -> Time:
        """By the U and L that bring a response nearest to what was measured."""
        residual = in_band((measured - response)[start:], lines)
        coefficients = np.linalg.lstsq((columns_in_band / size).T, residual)[0]
        return np.pad(coefficients @ (columns / size), (start, 0))

    model = model + added(np.median(model, axis=0))
    return model, {name: response + added(response) for name, response in others.items()}
