r"""The statement on a reading: its distance from the reference, and a change of the joint.

A change of readings is stated as one of torque, too, where a population of joints says how they go
with it. Readings y of joints at other torques T change by $g = dy/d\ln T$, one g a draw of the
population. The mean of n readings behind a change lies by d from that of $n_0$ references of
covariance S. Then $x = \ln(T'/T)$, expected within a factor of e or so, is by weighted least
squares

$$p(x \mid d) \propto N(x; 0, 1) \sum_s \Bigl(1 + \frac{q_s(x)}{n_0 - 1}\Bigr)^{-n_0/2}, \qquad
  q_s(x) = (d - g_s x)^T \Bigl[\Bigl(\frac1n + \frac1{n_0}\Bigr) S\Bigr]^{-1} (d - g_s x)$$

with Student's t in the normal's place, for S is known from $n_0$ readings. The trend is a straight
one in ln T.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import t as student

from jbw.report.messages import watch
from jbw.watch.change_point import after_change, known_from, run_length
from jbw.watch.hotelling import (
    ReferenceReadings,
    distance,
    excess_noise,
    reference_of,
    tail,
    threshold,
)

PLACES = np.linspace(-4.0, 4.0, 8001)  # of x: four standard deviations of what is expected
QUANTILES = (0.005, 0.5, 0.995)
UNEXPLAINED = 0.01  # probability of what the best torque leaves, below which none explains it
LEVEL = 0.99  # of intervals


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


class Change(NamedTuple):
    """The change since the reference, estimated from the readings after the change."""

    first: int  # number of the first reading behind it, counted over the watched from 1
    frequency: tuple[float, float, float]  # [Hz], with its 99 % interval
    damping: tuple[float, float, float]  # as a part of it
    direction: str
    torque: TorqueChange | None = None  # that it is like, by a population


class Statement(NamedTuple):
    """The statement on the last watched reading: T^2, probabilities, alarm and change."""

    squared: float  # T^2
    threshold: float  # of T^2
    tail: float  # probability of so large a T^2 without a change
    unchanged: float  # probability that no change came since the reference
    alarm: str  # empty, "reading", "drift", or "reading and drift"
    change: Change | None  # of an alarm


def state(
    references: Float[np.ndarray, "reference p"],
    watched: Float[np.ndarray, "n p"],
    false_alarms: float,
    *,
    noise_covariance: Float[np.ndarray, "p p"] | None = None,
    reference_noise: Float[np.ndarray, "p p"] | None = None,
    trend: Trend | None = None,
) -> Statement:
    """Return the statement on the last watched reading, alone and with the readings before it.

    Of an unchanged joint a reading by itself alarms at the rate r, `false_alarms`, and their run
    among n readings with a probability of r / (1 - r)^(n + 1) at most, as the hazard is r, too.
    That bound is far: with 20 references and r = 0.01 a record alarms by either at the rate 1.00 r
    at first, at 0.94 r after thirty, and of sequences of thirty 21 % alarm somewhere.

    Args:
        references: Readings without change.
        watched: All readings since then, in their order.
        false_alarms: Rate of false alarms.
        noise_covariance: Covariance of the last reading by its own noise.
        reference_noise: Covariance of the references by their own noise.
        trend: How readings go with torque, where a population says so.
    """
    reference = reference_of(references)
    num, p = references.shape
    excess = (
        None
        if noise_covariance is None or reference_noise is None
        else excess_noise(noise_covariance, reference_noise)
    )
    squared = float(distance(watched[-1], reference, excess))
    far = float(tail(np.array(squared), p, num))
    run = run_length(watched, after_change(reference), false_alarms, start=known_from(reference))
    unchanged = float(run.unchanged[-1])
    alarms = [
        name
        for name, on in (("reading", far < false_alarms), ("drift", unchanged < false_alarms))
        if on
    ]
    change = None
    if alarms:
        # Runs of one reading or more that began behind the reference; the last stands for none,
        # and a drift is dated by the likeliest.
        length = int(np.argmax(run.probability[1:-1])) + 1
        behind = watched[-length:]
        change = change_of(reference, behind, len(watched) - length + 1)
        if trend is not None:
            away = behind.mean(axis=0) - reference.mean
            change = change._replace(torque=torque_after(away, reference, length, trend))
    return Statement(
        squared, threshold(false_alarms, p, num), far, unchanged, " and ".join(alarms), change
    )


def change_of(reference: ReferenceReadings, behind: Float[np.ndarray, "n p"], first: int) -> Change:
    """Return the change of frequency and damping against the reference, by Student's t."""
    away = behind.mean(axis=0) - reference.mean
    sd = np.sqrt(np.diag(reference.covariance) * (1 / len(behind) + 1 / reference.num))
    reach = student.ppf((1 + LEVEL) / 2, reference.num - 1) * sd
    low, middle, high = (away - reach)[:2], away[:2], (away + reach)[:2]
    frequency = (float(middle[0]), float(low[0]), float(high[0]))
    middle_d, low_d, high_d = (float(np.expm1(change[1])) for change in (middle, low, high))
    return Change(first, frequency, (middle_d, low_d, high_d), _direction(low, high))


def _direction(low: Float[np.ndarray, " 2"], high: Float[np.ndarray, " 2"]) -> str:
    """Return the direction of a change that 99 % intervals show, such as looser.

    Loosening lowers the frequency and raises the damping.
    """
    looser = [high[0] < 0, low[1] > 0]
    tighter = [low[0] > 0, high[1] < 0]
    if any(looser) and not any(tighter):
        return "looser"
    if any(tighter) and not any(looser):
        return "tighter, or another temperature"
    return "changed otherwise"


def sentence(statement: Statement, names: Sequence[str], num_reference: int) -> str:
    """Return a statement in words; `names` are those of the watched records."""
    numbers = watch.distances(
        statement.squared, statement.threshold, num_reference, statement.unchanged
    )
    change = statement.change
    if change is None:
        return watch.no_alarm(numbers)
    torque = "" if change.torque is None else words_of(change.torque)
    changes = watch.changes(change.frequency, change.damping, torque)
    first = names[change.first - 1]
    return watch.alarm(statement.alarm, names[-1], first, change.direction, changes, numbers)


def as_plain(statement: Statement) -> dict[str, Any]:
    """Return a statement as a line of the log has it."""
    plain, change = statement._asdict(), statement.change
    if change is None:
        return plain
    torque = {} if change.torque is None else {"torque": change.torque._asdict()}
    return plain | {"change": {k: v for k, v in change._asdict().items() if v is not None} | torque}


def torque_after(
    away: Float[np.ndarray, " p"], reference: ReferenceReadings, num: int, trend: Trend
) -> TorqueChange:
    """Return the torque that readings behind a change are like.

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
    """Return a change of torque as the end of a sentence."""
    after = change.after, change.low, change.high
    return watch.torque_change(
        change.before, after, within_fleet=change.inside, is_explained=change.explained
    )
