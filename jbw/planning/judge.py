r"""Candidates judged: what repeats would tell, how many the wished CV takes, and what to combine.

Parameters enter as relative changes, so that standard deviations are coefficients of variation.
"""

from bisect import bisect_left
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import eigh

from jbw.inference.fit.identifiability import weak_direction
from jbw.planning.beliefs import Beliefs
from jbw.planning.plan import CandidateRow, Chosen, Combination, Expected, Wish
from jbw.planning.prospects import Prospect
from jbw.report.messages import planning

STATUSES = ("ok", "too few", "not predicted", "not feasible")
Matrices = Float[np.ndarray, "... parameter parameter"]


class InformationModes(NamedTuple):
    """Prior and information of one repeat, made diagonal together."""

    values: Float[np.ndarray, "joint mode"]  # information f_k along mode k, in units of the prior's
    shares: Float[np.ndarray, "joint parameter mode"]  # prior variance w_ik^2 along mode k


def modes(precision: Matrices, information: Matrices) -> InformationModes:
    """Modes F w_k = f_k P w_k, w_k^T P w_k = 1 of a prior P and the information F, by joint."""
    values, vectors = zip(
        *(eigh(fisher_matrix, precision) for fisher_matrix in information), strict=True
    )
    return InformationModes(np.maximum(values, 0.0), np.square(vectors))


def spread(eigenmodes: InformationModes, repeats: float) -> Float[np.ndarray, "joint parameter"]:
    """Coefficients of variation, CV_i^2 = [(P + R F)^-1]_ii = sum_k w_ik^2 / (1 + R f_k)."""
    return np.sqrt(
        np.sum(eigenmodes.shares / (1.0 + repeats * eigenmodes.values[..., None, :]), axis=-1)
    )


def covariance(precision: Matrices) -> Matrices:
    """Inverse of an information matrix, its parameters brought to one scale first."""
    scale = 1 / np.sqrt(np.diagonal(precision, axis1=-2, axis2=-1))
    both = scale[..., :, None] * scale[..., None, :]
    return both * np.linalg.inv(both * precision)


def worst_decile(values: Float[np.ndarray, " joint *n"]) -> Float[np.ndarray, "*n"]:
    """The least value that nine joints in ten do not exceed."""
    return np.quantile(values, 0.9, axis=0, method="inverted_cdf")


def repeats_needed(
    eigenmodes: InformationModes, positions: list[int], cv: float, most: int
) -> int | None:
    """Fewest repeats after which nine joints in ten meet the CV; None where `most` do not."""

    def enough(repeats: int) -> bool:
        return bool(np.all(worst_decile(spread(eigenmodes, repeats))[positions] <= cv))

    # The spread falls with every repeat.
    repeats = 1 + bisect_left(range(1, most + 1), True, key=enough)
    return repeats if repeats <= most else None


def information_gain(
    precision: Matrices, information: Matrices, positions: Sequence[int] | None = None
) -> Float[np.ndarray, "*joint"]:
    r"""Expected information gain of a test, where the posterior is near Gaussian.

    $$I_w = \tfrac12 \left(\log\det \Sigma_{ww} - \log\det \Sigma'_{ww}\right), \qquad
      \Sigma = P^{-1}, \quad \Sigma' = (P + F)^{-1}$$

    P is the information that there is already, F that of the test. The gain [nats] is about the
    parameters at the `positions`, the others unknown beside them; about all when None.
    """
    chosen = list(range(precision.shape[-1]) if positions is None else positions)
    before, after = (
        np.linalg.slogdet(covariance(p)[..., chosen, :][..., chosen])[1]
        for p in (precision, precision + information)
    )
    return 0.5 * (before - after)


def row(prospect: Prospect, beliefs: Beliefs, wish: Wish) -> CandidateRow:
    """A candidate judged: repeats, spread, gain and limits."""
    candidate, information = prospect.candidate, prospect.information
    positions = [beliefs.names.index(name) for name in wish.wanted]
    eigenmodes = modes(beliefs.precision, information)
    repeats = repeats_needed(eigenmodes, positions, wish.cv, wish.max_repeats)
    planned_repeats = repeats or wish.max_repeats
    y_peak = prospect.y_peak[np.isfinite(prospect.y_peak)]
    y_peak = y_peak if y_peak.size else np.array([np.nan])
    largest = float(np.max(y_peak))
    exceeded, lost = [], []
    status = "too few" if repeats is None else "ok"
    if largest > wish.max_displacement:
        exceeded.append(planning.too_far(largest, wish.max_displacement))
    if candidate.level > wish.max_input:
        exceeded.append(planning.too_strong(wish.max_input, wish.input_unit))
    if prospect.num_lost:
        lost = [planning.no_response(prospect.num_lost, beliefs.num_joints)]
        status = "not predicted"
    if exceeded:
        status = "not feasible"
    return CandidateRow(
        test=str(candidate),
        level=candidate.level,
        y_peak=float(np.median(y_peak)),
        y_peak_largest=largest,
        repeats=repeats,
        seconds_each=candidate.seconds,
        seconds=None if repeats is None else repeats * candidate.seconds,
        cv=expected(spread(eigenmodes, planned_repeats), beliefs, wish),
        information_gain=float(np.mean(information_gain(beliefs.precision, information))),
        status=status,
        notes=(
            *exceeded,
            *lost,
            *_undetermined(beliefs, beliefs.precision + planned_repeats * information, positions),
        ),
    )


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


def _undetermined(
    beliefs: Beliefs, precision: Matrices, positions: Sequence[int]
) -> tuple[str, ...]:
    """Which combination of parameters is all that the tests determine; none where all are."""
    # Told at the joint whose wanted parameters are known as well as at half of the joints.
    remaining = covariance(precision)
    poorest = np.max(np.diagonal(remaining, axis1=1, axis2=2)[:, list(positions)], axis=1)
    i = int(np.argsort(poorest)[len(poorest) // 2])
    mean = {name: float(beliefs.joints[name][i]) for name in beliefs.names}
    units = np.outer(beliefs.scale[i], beliefs.scale[i])
    direction = weak_direction(mean, units * remaining[i], beliefs.box)
    return () if direction is None else (direction.text,)


def ordered(rows: Sequence[CandidateRow]) -> tuple[CandidateRow, ...]:
    """Rows by status, then by measuring time, then by what they tell."""

    def place(candidate: CandidateRow) -> tuple[int, float, float]:
        seconds = candidate.seconds_each * (candidate.repeats or 1)
        return STATUSES.index(candidate.status), seconds, -candidate.information_gain

    return tuple(sorted(rows, key=place))


def combine(prospects: Sequence[Prospect], beliefs: Beliefs, wish: Wish) -> Combination:
    """Repeats of candidates, one at a time, until the wish is met."""
    # Each step adds the repeat that gains most about the wanted parameters for a second of
    # measuring, on an average over the joints. What no longer is needed at the end, because a later
    # test told more, is taken away again, the longest first.
    positions = [beliefs.names.index(name) for name in wish.wanted]
    seconds = np.array([prospect.candidate.seconds for prospect in prospects])
    counts = np.zeros(len(prospects), int)
    start = np.broadcast_to(beliefs.precision, (beliefs.num_joints, *beliefs.precision.shape))

    def precision_after(counts: np.ndarray) -> Matrices:
        return start + sum(n * p.information for n, p in zip(counts, prospects, strict=True))

    def spread_of(counts: np.ndarray) -> Float[np.ndarray, "joint parameter"]:
        return np.sqrt(np.diagonal(covariance(precision_after(counts)), axis1=-2, axis2=-1))

    def met(counts: np.ndarray) -> bool:
        return bool(np.all(worst_decile(spread_of(counts))[positions] <= wish.cv))

    while prospects and counts.sum() < wish.max_repeats and not met(counts):
        precision = precision_after(counts)
        gains = [np.mean(information_gain(precision, p.information, positions)) for p in prospects]
        counts[int(np.argmax(gains / seconds))] += 1
    is_met = met(counts)
    for i in np.argsort(-seconds, kind="stable") if is_met else ():
        fewer = counts - (np.arange(len(counts)) == i)
        while counts[i] and met(fewer):
            counts, fewer = fewer, fewer - (np.arange(len(counts)) == i)
    return Combination(
        tests=tuple(
            Chosen(str(p.candidate), p.candidate.level, int(n))
            for n, p in zip(counts, prospects, strict=True)
            if n
        ),
        seconds=float(counts @ seconds),
        cv=expected(spread_of(counts), beliefs, wish),
        met=is_met,
        notes=_undetermined(beliefs, precision_after(counts), positions),
    )
