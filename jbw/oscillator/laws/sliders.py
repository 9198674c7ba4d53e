r"""Masing laws approximated by parallel sliders, for programs without other hysteresis.

A slider of stiffness k and slip s represents the part of the density $-F_b''$ between two edges,

$$k = \ell'(b) - \ell'(a), \qquad k s = \Bigl[x\,\ell' - \ell\Bigr]_a^b$$

by the lag $\ell = K x - F_b$ of the virgin curve: exact for a bin with any density inside.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from jbw.oscillator.laws.masing import Masing

COUNT = 60
# Edges of the bins of slip limits are evenly spaced numbers to this power, because otherwise the
# energy would be tens of per cent too small at a hundredth of the largest slip.
GRADING = 4


class Sliders(NamedTuple):
    """Elastic-plastic elements in parallel with each other and with a spring.

    Attributes:
        stiffness: Stiffness of each slider [1/s^2].
        slip: Displacement at which each slips [m].
        spring: Stiffness of all that does not slip within the reach [1/s^2].
    """

    stiffness: NDArray[np.float64]
    slip: NDArray[np.float64]
    spring: float


def sliders_of(law: Masing, reach: float, count: int = COUNT) -> Sliders:
    """Return the sliders that slip within a displacement, and a spring for the rest.

    Args:
        law: A Masing law with scalar parameters.
        reach: The displacement [m].
        count: Number of sliders; a kink of the virgin curve within the reach adds one.
    """
    kink = law.kink()
    most = reach if kink is None else min(reach, float(kink.y))
    edges = most * np.linspace(0.0, 1.0, count + 1) ** GRADING
    if most < reach:
        # A separate slider represents the kink of the virgin curve, if it has one.
        edges = np.append(edges[:-1], [most * (1.0 - 1e-12), most])
    lag, slope = (np.asarray(x) for x in law.lag(jnp.asarray(edges)))
    stiffness, moment = np.diff(slope), np.diff(edges * slope - lag)
    some = stiffness > 0.0
    slip = moment[some] / stiffness[some]
    return Sliders(stiffness[some], slip, float(law.stiffness() - slope[-1]))


def lost_by(sliders: Sliders, y_peak: ArrayLike) -> NDArray[np.float64]:
    """Return the energy loss per cycle, the sum of 4 k s (Y - s) over slipping sliders [J/kg]."""
    over = np.maximum(np.asarray(y_peak)[..., None] - sliders.slip, 0.0)
    return np.sum(4.0 * sliders.stiffness * sliders.slip * over, axis=-1)
