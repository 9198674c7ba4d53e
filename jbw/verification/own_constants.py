r"""Predictions with residual constants that are fitted to each test separately.

$$\min_{U, L} \sum \bigl(y - \hat y - (U + L/\omega^2)\,u\bigr)^2$$

The fit integrates these constants out, and no other test determines them: they are two numbers of
every record, like its level. The joint is judged by the remaining residual.
"""

import numpy as np
from jaxtyping import Float

from jbw.observables.records import Records
from jbw.observables.residual_terms import has_own, own_columns
from jbw.observables.samples import in_band
from jbw.oscillator.modes.parameters import has_further_modes
from jbw.verification.predictive_basis import Basis

Time = Float[np.ndarray, " time"]
Draws = Float[np.ndarray, "draw time"]
Others = dict[str, Time]


def completed(basis: Basis, data: Records, model: Draws, others: Others) -> tuple[Draws, Others]:
    """Add residual constants, fitted to the test itself, to all predicted responses of a test.

    The constants are fitted in the test's band.
    """
    if not has_own(data.residuals, several_modes=has_further_modes(basis.posterior)):
        return model, others
    force = np.asarray(data.source)[:, data.skipped :]
    (columns,) = own_columns(force, data.fs, data.response, None)
    columns_in_band = in_band(columns, data.lines)
    size = np.linalg.norm(columns_in_band, axis=1)[:, None]

    def added(response: Time) -> Time:
        """Return the response of constants U and L, fitted to measured minus predicted values."""
        residual = np.asarray(data.mean[0]) - in_band(response, data.lines)
        return np.linalg.lstsq((columns_in_band / size).T, residual)[0] @ (columns / size)

    model = model + added(np.median(model, axis=0))
    return model, {name: response + added(response) for name, response in others.items()}
