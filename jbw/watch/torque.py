r"""A change of readings as one of torque, by what a population of joints says of its trend.

Readings y of joints at other torques T change by $g = dy/d\ln T$, one g a draw of the population.
The mean of n readings behind a change lies by d from that of $n_0$ references of covariance S. Then
$x = \ln(T'/T)$, expected within a factor of e or so, is by weighted least squares

$$p(x \mid d) \propto N(x; 0, 1) \sum_s \Bigl(1 + \frac{q_s(x)}{n_0 - 1}\Bigr)^{-n_0/2}, \qquad
  q_s(x) = (d - g_s x)^T \Bigl[\Bigl(\frac1n + \frac1{n_0}\Bigr) S\Bigr]^{-1} (d - g_s x)$$

with Student's t in the normal's place, for S is known from $n_0$ readings. The trend is a straight
one in ln T.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jbw.report.messages import watch
from jbw.watch.hotelling import ReferenceReadings, tail

PLACES = np.linspace(-4.0, 4.0, 8001)  # of x: four standard deviations of what is expected
QUANTILES = (0.005, 0.5, 0.995)
UNEXPLAINED = 0.01  # probability of what the best torque leaves, below which none explains it


class Trend(NamedTuple):
    """How readings at fixed amplitudes go with torque.

    Attributes:
        torque: Of the watched joint before any change [N m].
        slopes: Of a reading's values on ln T, a row a draw of the population.
        least: Smallest torque that the population knows [N m].
        most: Largest.
    """

    torque: float
    slopes: Float[np.ndarray, "draw p"]
    least: float
    most: float


class TorqueChange(NamedTuple):
    """A change of readings as one of torque [N m]."""

    before: float
    after: float  # median
    low: float  # 99 % interval
    high: float
    explained: bool  # whether frequency and damping changed as with some torque
    inside: bool  # whether the median lies between the torques that the population knows


def torque_after(
    away: Float[np.ndarray, " p"], reference: ReferenceReadings, num: int, trend: Trend
) -> TorqueChange:
    """The torque that readings behind a change are like.

    Args:
        away: Their mean less that of the references.
        reference: Readings without change.
        num: How many they are.
        trend: How readings go with torque.
    """
    weight = np.linalg.inv(reference.covariance * (1 / num + 1 / reference.num))
    slopes, freedom = trend.slopes, reference.num - 1
    squared = np.einsum("si,ij,sj->s", slopes, weight, slopes)[:, None]
    along = (slopes @ weight @ away)[:, None]
    residual_square = away @ weight @ away - (2 * along - squared * PLACES) * PLACES
    density = np.mean((1 + residual_square / freedom) ** (-(freedom + 1) / 2), axis=0)
    mass = np.cumsum(density * np.exp(-(PLACES**2) / 2))
    low, middle, high = trend.torque * np.exp(np.interp(QUANTILES, mass / mass[-1], PLACES))
    # `tail` is that of one further reading, whose covariance is (1 + 1/n_0) S.
    rest = tail(residual_square.min() * (1 + 1 / reference.num), len(away), reference.num)
    return TorqueChange(
        trend.torque, float(middle), float(low), float(high),
        bool(rest > UNEXPLAINED), bool(trend.least <= middle <= trend.most),
    )  # fmt: skip


def words_of(change: TorqueChange) -> str:
    """A change of torque as the end of a sentence."""
    after = change.after, change.low, change.high
    return watch.torque_change(
        change.before, after, within_fleet=change.inside, is_explained=change.explained
    )
