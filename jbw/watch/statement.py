r"""The statement on a monitored record: its distance from the reference, and a change of the joint.

Where a population of joints provides a trend with torque, a change of readings is also stated as a
change of torque. Readings y of joints at other torques T change by $g = dy/d\ln T$, with one g per
draw of the population. The mean of n readings after a change differs by d from that of $n_0$
references of covariance S. Then $x = \ln(T'/T)$, whose prior standard deviation is a factor of e,
has by weighted least squares the density

$$p(x \mid d) \propto N(x; 0, 1) \sum_s \Bigl(1 + \frac{q_s(x)}{n_0 - 1}\Bigr)^{-n_0/2}, \qquad
  q_s(x) = (d - g_s x)^T \Bigl[\Bigl(\frac1n + \frac1{n_0}\Bigr) S\Bigr]^{-1} (d - g_s x)$$

with Student's t in place of the normal, since S is estimated from $n_0$ readings. The trend is
linear in ln T.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import t as student

from jbw.report.messages import watch
from jbw.watch.detection import (
    ReferenceReadings,
    after_change,
    distance,
    excess_noise,
    known_from,
    reference_of,
    run_length,
    tail,
    threshold,
)

# values of x = ln(T'/T) at which densities are computed, up to four prior standard deviations
PLACES = np.linspace(-4.0, 4.0, 8001)
QUANTILES = (0.005, 0.5, 0.995)
# No torque explains a change if, even for the best torque, the remaining change is less probable
# than this.
UNEXPLAINED = 0.01
LEVEL = 0.99  # probability of intervals


class Trend(NamedTuple):
    """The trend of frequency and damping at fixed amplitudes with the torque of the joint.

    Attributes:
        torque: Torque of the monitored joint before any change [N m].
        slopes: Slopes of a reading's values on ln T, one row per draw of the population.
        least: Smallest torque of the population's units [N m].
        most: Largest torque of the population's units [N m].
    """

    torque: float
    slopes: Float[np.ndarray, "draw p"]
    least: float
    most: float


class TorqueChange(NamedTuple):
    """A change of frequency and damping, stated as a change of torque [N m]."""

    before: float
    after: float  # median of the torque after the change
    low: float  # lower end of the 99 % interval of the torque after the change
    high: float
    explained: bool  # whether some torque explains the change of both frequency and damping
    inside: bool  # whether the median lies within the range of the population's torques


class Change(NamedTuple):
    """The change of frequency and damping since the reference, estimated from the later records."""

    first: int  # number of the first changed record, counted from 1 after the references
    frequency: tuple[float, float, float]  # change of the frequency [Hz], with its 99 % interval
    # relative change of the damping ratio, with its 99 % interval
    damping: tuple[float, float, float]
    direction: str
    # change of torque that explains the changes of frequency and damping, if a population is given
    torque: TorqueChange | None = None


class Statement(NamedTuple):
    """The statement on the latest record: T^2, probabilities, alarm and estimated change."""

    squared: float  # Hotelling's T^2 of the record
    threshold: float  # value of T^2 above which there is an alarm
    tail: float  # probability that an unchanged joint has at least this T^2
    unchanged: float  # probability that no change occurred since the reference
    alarm: str  # "reading" (this record), "drift" (the sequence), "reading and drift", or empty
    change: Change | None  # estimated change, if there is an alarm


def state(
    references: Float[np.ndarray, "reference p"],
    watched: Float[np.ndarray, "n p"],
    false_alarms: float,
    *,
    noise_covariance: Float[np.ndarray, "p p"] | None = None,
    reference_noise: Float[np.ndarray, "p p"] | None = None,
    trend: Trend | None = None,
) -> Statement:
    """Test the latest record, alone and together with earlier ones, for a change of the joint.

    Without a change, a single reading alarms at the rate r, `false_alarms`. The sequence alarms
    among n readings with a probability of r / (1 - r)^(n + 1) at most, as the hazard is r, too.
    That bound is loose: with 20 references and r = 0.01 a record alarms by either test at the rate
    1.00 r at first, and at 0.94 r after thirty; 21 % of sequences of thirty alarm somewhere.

    Args:
        references: Readings without change, one row each.
        watched: All readings since then, in order.
        false_alarms: Rate of false alarms per reading.
        noise_covariance: Covariance of the last reading from its own noise.
        reference_noise: Covariance of the references from their own noise.
        trend: Trend of readings with torque, where a population provides it.
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
        # Entry k of `run.probability` is the probability that k records were measured since the
        # change; the last entry is the probability of no change. The most probable k therefore
        # shows at which record the change occurred.
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
    """Estimate the change of frequency and damping since the reference, with intervals."""
    away = behind.mean(axis=0) - reference.mean
    sd = np.sqrt(np.diag(reference.covariance) * (1 / len(behind) + 1 / reference.num))
    reach = student.ppf((1 + LEVEL) / 2, reference.num - 1) * sd
    low, middle, high = (away - reach)[:2], away[:2], (away + reach)[:2]
    frequency = (float(middle[0]), float(low[0]), float(high[0]))
    middle_d, low_d, high_d = (float(np.expm1(change[1])) for change in (middle, low, high))
    return Change(first, frequency, (middle_d, low_d, high_d), _direction(low, high))


def _direction(low: Float[np.ndarray, " 2"], high: Float[np.ndarray, " 2"]) -> str:
    """Return a change's direction, such as "looser", from intervals of frequency and damping.

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
    """Return the sentence on a monitored record: alarm, change and numbers.

    `names` are those of the watched records.
    """
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
    """Convert the statement on a record to plain values for the log."""
    plain, change = statement._asdict(), statement.change
    if change is None:
        return plain
    torque = {} if change.torque is None else {"torque": change.torque._asdict()}
    return plain | {"change": {k: v for k, v in change._asdict().items() if v is not None} | torque}


def torque_after(
    away: Float[np.ndarray, " p"], reference: ReferenceReadings, num: int, trend: Trend
) -> TorqueChange:
    """Return the torque that explains a change of frequency and damping, with its 99 % interval.

    Args:
        away: Mean of the readings minus that of the references.
        reference: Readings without change.
        num: Number of readings after the change.
        trend: Trend of readings with torque.
    """
    weight = np.linalg.inv(reference.covariance * (1 / num + 1 / reference.num))
    slopes, freedom = trend.slopes, reference.num - 1
    squared = np.einsum("si,ij,sj->s", slopes, weight, slopes)[:, None]
    along = (slopes @ weight @ away)[:, None]
    residual_square = away @ weight @ away - (2 * along - squared * PLACES) * PLACES
    density = np.mean((1 + residual_square / freedom) ** (-(freedom + 1) / 2), axis=0)
    mass = np.cumsum(density * np.exp(-(PLACES**2) / 2))
    low, middle, high = trend.torque * np.exp(np.interp(QUANTILES, mass / mass[-1], PLACES))
    # `tail` expects T^2 of one new record, whose covariance is (1 + 1/n_0) S.
    rest = tail(residual_square.min() * (1 + 1 / reference.num), len(away), reference.num)
    return TorqueChange(
        trend.torque, float(middle), float(low), float(high),
        bool(rest > UNEXPLAINED), bool(trend.least <= middle <= trend.most),
    )  # fmt: skip


def words_of(change: TorqueChange) -> str:
    """Return the clause on the torque that explains a change, to end a sentence."""
    after = change.after, change.low, change.high
    return watch.torque_change(
        change.before, after, within_fleet=change.inside, is_explained=change.explained
    )
