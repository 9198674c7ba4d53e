"""What is stated of a reading: how it lies to the reference, whether the joint has changed."""

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
from jbw.watch.torque import TorqueChange, Trend, torque_after, words_of

LEVEL = 0.99  # of intervals


class Change(NamedTuple):
    """What changed since the reference, by the readings behind the change."""

    first: int  # number of the first reading behind it, counted over the watched from 1
    frequency: tuple[float, float, float]  # [Hz], with its 99 % interval
    damping: tuple[float, float, float]  # as a part of it
    direction: str
    torque: TorqueChange | None = None  # that it is like, by a population


class Statement(NamedTuple):
    """What is stated of the last of the watched readings."""

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
    """What is stated of the last watched reading, by itself and together with those before it.

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
    """Frequency and damping behind a change less those of the reference, by Student's t."""
    away = behind.mean(axis=0) - reference.mean
    sd = np.sqrt(np.diag(reference.covariance) * (1 / len(behind) + 1 / reference.num))
    reach = student.ppf((1 + LEVEL) / 2, reference.num - 1) * sd
    low, middle, high = (away - reach)[:2], away[:2], (away + reach)[:2]
    frequency = (float(middle[0]), float(low[0]), float(high[0]))
    middle_d, low_d, high_d = (float(np.expm1(change[1])) for change in (middle, low, high))
    return Change(first, frequency, (middle_d, low_d, high_d), _direction(low, high))


def _direction(low: Float[np.ndarray, " 2"], high: Float[np.ndarray, " 2"]) -> str:
    """Loosening lowers the frequency and raises the damping; what is seen, by 99 % intervals."""
    looser = [high[0] < 0, low[1] > 0]
    tighter = [low[0] > 0, high[1] < 0]
    if any(looser) and not any(tighter):
        return "looser"
    if any(tighter) and not any(looser):
        return "tighter, or another temperature"
    return "changed otherwise"


def sentence(statement: Statement, names: Sequence[str], num_reference: int) -> str:
    """A statement in words; `names` are those of the watched records."""
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
    """A statement as a line of the log has it."""
    plain, change = statement._asdict(), statement.change
    if change is None:
        return plain
    torque = {} if change.torque is None else {"torque": change.torque._asdict()}
    return plain | {"change": {k: v for k, v in change._asdict().items() if v is not None} | torque}
