r"""How much a fleet tells before it is measured, by how many assemblies at how many torques.

With n units at ln torques t about their mean, in units of the scatter tau and for records whose own
error is small beside it:

$$\mathrm{sd}\,b_1 = \Big(\sum (t - \bar t)^2\Big)^{-1/2}, \qquad
  b_1 \pm t_{n-2}\,\mathrm{sd}\,b_1, \qquad y_{new} \pm t_{n-2}\sqrt{1 + 1/n}$$
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from jbw.errors import ConfigError

DESIGNS = ((3, 1), (3, 2), (3, 3), (4, 2), (5, 1), (5, 3))
LEVEL = 0.995  # quantile of both ends of a 99 % interval


class FleetDesign(NamedTuple):
    """What one design tells, in units of the scatter between units.

    Attributes:
        levels: Torques, evenly on logarithms.
        assemblies: At each of them.
        slope_sd: Standard deviation of the slope on ln torque.
        slope: Half of the slope's 99 % interval.
        new_unit: Half of the 99 % interval of a further assembly at the middle torque.
    """

    levels: int
    assemblies: int
    slope_sd: float
    slope: float
    new_unit: float


def fleet_designs(
    torque: tuple[float, float], designs: Iterable[tuple[int, int]] = DESIGNS
) -> list[FleetDesign]:
    """Each design between the least and the largest torque [N m].

    Raises:
        ConfigError: Torques that are no range, or a design of fewer than three units.
    """
    low, high = torque
    if not 0.0 < low < high < np.inf:
        raise ConfigError(
            f"Torques must go from one above zero to a larger one, but are {low:g} to {high:g} N m."
        )
    return [_design(np.log(low), np.log(high), *size) for size in designs]


def _design(low: float, high: float, levels: int, assemblies: int) -> FleetDesign:
    num = levels * assemblies
    if levels < 2 or num < 3:
        raise ConfigError(
            f"A design needs two torques and three units, but {levels} x {assemblies} was asked."
        )
    at = np.repeat(np.linspace(low, high, levels), assemblies)
    slope_sd = float(1.0 / np.sqrt(np.sum((at - at.mean()) ** 2)))
    times = float(student.ppf(LEVEL, num - 2))
    return FleetDesign(
        levels, assemblies, slope_sd, times * slope_sd, times * float(np.sqrt(1.0 + 1.0 / num))
    )
