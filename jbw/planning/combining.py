"""Which tests to make together: the greatest expected information gain a second, step by step."""

from collections.abc import Callable, Sequence

import numpy as np

from jbw.planning.beliefs import Beliefs
from jbw.planning.information import Matrices, covariance, wanted_gain, worst_decile
from jbw.planning.plan import Chosen, Combination, Wish, expected, undetermined
from jbw.planning.prospects import Prospect


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
