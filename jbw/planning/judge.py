"""Candidates judged: repeats for the wished CV, one row a test, and what to combine."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from jbw.inference.fit.identifiability import weak_direction
from jbw.planning.beliefs import Beliefs
from jbw.planning.information import (
    Matrices,
    covariance,
    information_gain,
    modes,
    repeats_needed,
    spread,
    wanted_gain,
    worst_decile,
)
from jbw.planning.plan import Chosen, Combination, Expected, Row, Wish
from jbw.planning.prospects import Prospect

STATUSES = ("ok", "too few", "not predicted", "not feasible")


def row(prospect: Prospect, beliefs: Beliefs, wish: Wish) -> Row:
    """A candidate judged: repeats, spread, gain and limits.

    Args:
        prospect: The candidate at every joint.
        beliefs: What is known before it.
        wish: What is wanted.
    """
    candidate, information = prospect.candidate, prospect.information
    wanted = [beliefs.names.index(name) for name in wish.wanted]
    found = modes(beliefs.precision, information)
    repeats = repeats_needed(found, wanted, wish.cv, wish.max_repeats)
    made = repeats or wish.max_repeats
    known = np.isfinite(prospect.y_peak)
    largest = float(np.max(prospect.y_peak[known], initial=0.0)) if known.any() else float("nan")
    exceeded = _exceeded(candidate.level, largest, wish)
    lost = (
        [f"no response found at {prospect.num_lost} of {len(known)} joints"]
        if prospect.num_lost
        else []
    )
    weak = undetermined(beliefs, beliefs.precision + made * information, wanted)
    return Row(
        test=str(candidate),
        level=candidate.level,
        y_peak=float(np.median(prospect.y_peak[known])) if known.any() else float("nan"),
        y_peak_largest=largest,
        repeats=repeats,
        seconds_each=candidate.seconds,
        seconds=None if repeats is None else repeats * candidate.seconds,
        cv=expected(spread(found, made), beliefs, wish),
        information_gain=float(np.mean(information_gain(beliefs.precision, information))),
        status=_status(exceeded, lost, repeats),
        notes=(*exceeded, *lost, *([] if weak is None else [weak])),
    )


def _exceeded(level: float, y_peak: float, wish: Wish) -> list[str]:
    """The limits that a test would break."""
    told = []
    if y_peak > wish.max_displacement:
        told.append(f"peak displacement {y_peak:.3g} m exceeds {wish.max_displacement:g} m")
    if level > wish.max_input:
        told.append(f"input exceeds {wish.max_input:g} {wish.input_unit}")
    return told


def _status(exceeded: list[str], lost: list[str], repeats: int | None) -> str:
    if exceeded:
        return "not feasible"
    if lost:
        return "not predicted"
    return "too few" if repeats is None else "ok"


def expected(
    spreads: Float[np.ndarray, "joint parameter"], beliefs: Beliefs, wish: Wish
) -> dict[str, Expected]:
    """Median and worst decile over joints of the spread of the wanted parameters."""
    worst, middle = worst_decile(spreads), np.median(spreads, axis=0)
    return {
        name: Expected(float(middle[i]), float(worst[i]))
        for i, name in enumerate(beliefs.names)
        if name in wish.wanted
    }


def undetermined(beliefs: Beliefs, precision: Matrices, wanted: Sequence[int]) -> str | None:
    """Which combination of parameters is all that the tests determine; None where all are.

    Told at the joint whose wanted parameters are known as well as at half of the joints.

    Args:
        beliefs: The joints, and the box that the tests are measured against.
        precision: Information after the tests, joint by joint.
        wanted: Positions of the wanted parameters.
    """
    left = covariance(precision)
    poorest = np.max(np.diagonal(left, axis1=1, axis2=2)[:, list(wanted)], axis=1)
    i = int(np.argsort(poorest)[len(poorest) // 2])
    mean = {name: float(beliefs.joints[name][i]) for name in beliefs.names}
    units = np.outer(beliefs.scale[i], beliefs.scale[i])
    found = weak_direction(mean, units * left[i], beliefs.box)
    return None if found is None else found.text


def ordered(rows: Sequence[Row]) -> tuple[Row, ...]:
    """Rows by status, then by measuring time, then by what they tell."""

    def place(one: Row) -> tuple[int, float, float]:
        seconds = one.seconds_each * (one.repeats or 1)
        return STATUSES.index(one.status), seconds, -one.information_gain

    return tuple(sorted(rows, key=place))


def combine(prospects: Sequence[Prospect], beliefs: Beliefs, wish: Wish) -> Combination:
    """Repeats of candidates, one at a time, until the wish is met, and then without the needless.

    Each step adds the repeat that gains most about the wanted parameters for a second of
    measuring, on an average over the joints. What no longer is needed at the end, because a later
    test told more, is taken away again, the longest first.

    Args:
        prospects: The candidates within the limits.
        beliefs: What is known before.
        wish: What is wanted; as many repeats in all as it admits of one test.
    """
    wanted = [beliefs.names.index(name) for name in wish.wanted]
    counts = np.zeros(len(prospects), int)
    start = np.broadcast_to(beliefs.precision, (beliefs.num_joints, *beliefs.precision.shape))

    def told(counts: np.ndarray) -> Matrices:
        return start + sum(n * p.information for n, p in zip(counts, prospects, strict=True))

    while prospects and counts.sum() < wish.max_repeats and not _met(told(counts), wanted, wish):
        known = told(counts)
        rates = [
            float(np.mean(wanted_gain(known, p.information, wanted))) / p.candidate.seconds
            for p in prospects
        ]
        counts[int(np.argmax(rates))] += 1
    met = _met(told(counts), wanted, wish)
    if met:
        counts = _without_needless(counts, prospects, lambda n: _met(told(n), wanted, wish))
    weak = undetermined(beliefs, told(counts), wanted)
    return Combination(
        tests=tuple(
            Chosen(str(p.candidate), p.candidate.level, int(n))
            for n, p in zip(counts, prospects, strict=True)
            if n
        ),
        seconds=float(sum(n * p.candidate.seconds for n, p in zip(counts, prospects, strict=True))),
        cv=expected(_spread(told(counts)), beliefs, wish),
        met=met,
        notes=() if weak is None else (weak,),
    )


def _without_needless(
    counts: np.ndarray, prospects: Sequence[Prospect], met: Callable[[np.ndarray], bool]
) -> np.ndarray:
    """The counts without repeats that the wish does not need, the longest tests first."""
    for i in sorted(range(len(counts)), key=lambda i: -prospects[i].candidate.seconds):
        while counts[i]:
            fewer = counts - (np.arange(len(counts)) == i)
            if not met(fewer):
                break
            counts = fewer
    return counts


def _spread(precision: Matrices) -> np.ndarray:
    return np.sqrt(np.diagonal(covariance(precision), axis1=-2, axis2=-1))


def _met(precision: Matrices, wanted: list[int], wish: Wish) -> bool:
    return bool(np.all(worst_decile(_spread(precision))[wanted] <= wish.cv))
