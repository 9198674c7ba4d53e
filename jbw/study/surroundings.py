r"""What the modes outside a band come to in a campaign's own units, in a sentence.

About the joint's own mode both residual terms are one real constant: as an inertance

$$c = -g\,(\omega_n^2 U + L)$$

that of a rigid body, 1/M, where it is positive; else the modes above give the structure a
compliance $-c / \omega_n^2$.
"""

from collections.abc import Mapping

import numpy as np
import xarray as xr

from jbw.inference.posterior.summary import QUANTILES
from jbw.observables.residual_terms import LOWER, UPPER
from jbw.quantities import gain_unit, per
from jbw.report.messages import study as messages
from jbw.report.text import interval


def constants_sentence(posterior: xr.Dataset, held: Mapping[str, float], source: str) -> str | None:
    """One real constant with its 99 % interval, and what it is of; None where there is none.

    `source` is the unit of what drives the tests.
    """
    constants = {**held, **{str(name): draws.values for name, draws in posterior.items()}}
    if not {UPPER, LOWER} & constants.keys() or not {"gain", "omega_n"} <= constants.keys():
        return None
    stiff = np.asarray(constants["omega_n"]) ** 2
    inertance = -constants["gain"] * (stiff * constants.get(UPPER, 0.0) + constants.get(LOWER, 0.0))
    if np.median(inertance) > 0:
        unit = gain_unit(source).replace("N/kg", "m/s^2")
        return messages.rigid_body(_spread(inertance), unit)
    return messages.compliance(_spread(-inertance / stiff), per("m", source))


def _spread(draws: np.ndarray) -> str:
    return interval(*np.quantile(draws, QUANTILES))
