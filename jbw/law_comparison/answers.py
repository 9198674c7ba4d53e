r"""The results of a comparison of laws: the best law, and the laws distinguished from it.

$$\Delta = \sum_r (\mathrm{elpd}_r - \mathrm{elpd}^{\,0}_r), \qquad
  \mathrm{se} = \sqrt{n}\ \mathrm{sd}_r(\mathrm{elpd}_r - \mathrm{elpd}^{\,0}_r)$$

Reference:
    Vehtari, Gelman and Gabry (2017), Statistics and Computing 27, 1413; for the weights, Yao,
    Vehtari, Simpson and Gelman (2018), Bayesian Analysis 13, 917.
"""

from collections.abc import Iterator, Mapping

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.inference.posterior.verdict import GOOD_KHAT
from jbw.report.messages import laws
from jbw.results.laws import StoredLaw, StoredLaws, StoredSharedRuns

# smallest number of runs for which the standard error of a difference of scores is reliable
FEWEST_RUNS = 5
APART = 2.0  # Laws are distinguished if their scores differ by this number of standard errors.
# possible error of a score with poor importance weights, as a multiple of the difference between
# this score and the score from fits
OFF = 3.0
# Difference of log evidence [nats] that distinguishes two laws if there are too few runs for
# scores.
NATS = 5.0
# Laws predict equally well if their errors are at most this multiple of the smallest error.
AS_GOOD = 1.1
# targets of prediction beyond the fitted tests: stronger tests, other kinds of test
TARGETS = (laws.OUTWARD, laws.ACROSS)
# An error below this multiple of the standard error of the repeats' mean is close to noise.
NEAR_FLOOR = 1.2

Rows = Mapping[str, StoredLaw]


def compared_rows(rows: Rows, scores: Mapping[str, np.ndarray]) -> dict[str, StoredLaw]:
    """Return the table row of each law: difference to the best law, weight, and answer."""
    by_runs = bool(scores) and len(next(iter(scores.values()))) >= FEWEST_RUNS
    best = _best(rows, scores, by_runs=by_runs)
    apart = differences(scores, best) if scores else {}
    weights = stacking(scores) if by_runs else {}
    compared = {}
    for name, row in rows.items():
        difference, error = apart.get(name, (None, None))
        row = row.replaced(
            elpd_difference=difference,
            elpd_difference_se=error if error is not None and np.isfinite(error) else None,
            weight=weights.get(name),
            log_evidence_difference=_less(row.log_evidence, rows[best].log_evidence),
        )
        answer = "best" if name == best else _answer(row, rows[best], by_runs=by_runs)
        compared[name] = row.replaced(answer=answer)
    return compared


def _less(number: float | None, other: float | None) -> float | None:
    return None if number is None or other is None else number - other


def _best(rows: Rows, scores: Mapping[str, np.ndarray], *, by_runs: bool) -> str:
    """Return the name of the best law: by score, by evidence, or by error.

    A law with good importance weights is preferred, unless another law's score is higher by more
    than its possible error.
    """
    if by_runs:
        scored = {name: float(np.sum(x)) - _may_be_off(rows[name]) for name, x in scores.items()}
    else:
        evidence = {name: row.log_evidence for name, row in rows.items()}
        scored = {name: value for name, value in evidence.items() if value is not None}
    scored = {name: score for name, score in scored.items() if not rows[name].hopeless}
    if not scored:
        return min(rows, key=lambda name: rows[name].error)
    sure = [name for name in scored if not _is_rough(rows[name], by_runs=by_runs)]
    return max(scored if by_runs else sure or scored, key=lambda name: scored[name])


def _may_be_off(row: StoredLaw) -> float:
    """Return the possible error of a score [nats] that poor importance weights cause."""
    return OFF * (row.elpd_doubt or 0.0) if _is_rough(row, by_runs=True) else 0.0


def _is_rough(row: StoredLaw, *, by_runs: bool) -> bool:
    """Return whether the score of a law comes from poor importance weights."""
    khat = row.khat if by_runs else row.khat_evidence
    return khat is not None and not khat <= GOOD_KHAT


def _answer(row: StoredLaw, best: StoredLaw, *, by_runs: bool) -> str:
    """Return the comparison of a law with the best law: worse, not distinguished, or not judged.

    A law with a rough score is not judged, unless it lies farther behind than its possible error,
    or is hopeless and thus worse in any case.
    """
    behind = _behind_by_runs if by_runs else _behind_by_evidence
    if row.hopeless or behind(row, best):
        return "worse"
    rough = any(_is_rough(law, by_runs=by_runs) for law in (row, best))
    return "not judged" if rough else "not told apart"


def _behind_by_runs(row: StoredLaw, best: StoredLaw) -> bool:
    """Return whether a law's score is below the best law's by more than both scores' errors."""
    off = _may_be_off(row) + _may_be_off(best)
    behind = -(row.elpd_difference or 0.0)
    return behind - off > APART * (row.elpd_difference_se or 0.0)


def _behind_by_evidence(row: StoredLaw, best: StoredLaw) -> bool:
    """Return whether the best law's evidence is clearly higher, with both usual and wide priors."""
    if any(_is_rough(law, by_runs=False) for law in (row, best)):
        return False
    differences = (
        _less(row.log_evidence, best.log_evidence),
        _less(row.log_evidence_wide, best.log_evidence_wide),
    )
    return all(difference is not None and difference < -NATS for difference in differences)


def differences(
    scores: Mapping[str, Float[np.ndarray, " run"]], reference: str
) -> dict[str, tuple[float, float]]:
    """Return each law's score minus a reference, summed over runs, with its standard error."""
    sums = {}
    for name, of_runs in scores.items():
        apart = of_runs - scores[reference]
        error = np.sqrt(len(apart)) * np.std(apart, ddof=1) if len(apart) > 1 else np.nan
        sums[name] = (float(np.sum(apart)), float(error))
    return sums


def stacking(scores: Mapping[str, Float[np.ndarray, " run"]]) -> dict[str, float]:
    """Return the weights of the laws whose mixture predicts the held-out runs best.

    These weights serve prediction and are no probabilities of truth: laws that predict alike share
    their weight.
    """
    from arviz_stats.loo.compare import compare
    from arviz_stats.utils import ELPDData

    if len(scores) == 1:
        return dict.fromkeys(scores, 1.0)
    # Scores are taken relative to the best law of each run, because the exponential then cannot
    # overflow and the weights stay the same.
    best = np.max(list(scores.values()), axis=0)
    scores = {name: of_runs - best for name, of_runs in scores.items()}
    elpd = {
        name: ELPDData(
            elpd=float(np.sum(x)), se=0.0, p=0.0, n_samples=1, n_data_points=len(x),
            scale="log", warning=False, good_k=0.7,
            elpd_i=xr.DataArray(x, dims="run"), pareto_k=xr.DataArray(0.0 * x, dims="run"),
        )
        for name, x in scores.items()
    }  # fmt: skip
    weights = compare(elpd, method="stacking")["weight"]
    return {str(name): float(weight) for name, weight in weights.items()}


def errors_on(rows: Rows, target: str) -> dict[str, float]:
    """Return each law's prediction error: for the highest level, or for the worst kind of test."""
    errors = {
        name: row.error_highest if target == laws.OUTWARD else row.error_of_worst_kind
        for name, row in rows.items()
    }
    return {name: error for name, error in errors.items() if error is not None}


def weights_for(rows: Rows, target: str) -> dict[str, float]:
    """Return each law's weight in predictions of stronger tests or other kinds; empty if unknown.

    Within the fitted amplitudes, the shares are the weights of the comparison. For stronger tests
    and for other kinds, only laws whose error is at most 1.1 times the smallest error get a share,
    in proportion to the same weights. If none of these laws has a weight, the law with the smallest
    error predicts alone.
    """
    if target == laws.WITHIN:
        return {name: row.weight for name, row in rows.items() if row.weight}
    known = errors_on(rows, target)
    if len(known) < 2:
        return {}
    least = min(known, key=lambda name: known[name])
    close = {
        name: rows[name].weight or 0.0
        for name, error in known.items()
        if error <= AS_GOOD * known[least]
    }
    total = sum(close.values())
    if not total:
        return {least: 1.0}
    shares = {name: weight / total for name, weight in close.items() if weight}
    return dict(sorted(shares.items(), key=lambda share: -share[1]))


def statements(record: StoredLaws) -> list[str]:
    """Return the sentences on a comparison of laws."""
    rows, count = record.laws, len(record.runs)
    (best,) = record.answered("best")
    return [
        laws.best_by_predictions(best, count)
        if rows[best].weight is not None
        else laws.best_by_evidence(best, count, FEWEST_RUNS),
        *_of_answers(record, best),
        *_of_errors(record, best),
        *_of_targets(rows, best),
        *_of_parameters(rows),
        *_of_rough_scores(rows),
        *_of_unseen(rows),
        *_of_offsets(best, record.shared_runs),
        *_of_widths(rows),
    ]


def _of_answers(record: StoredLaws, best: str) -> Iterator[str]:
    """Yield sentences on which laws are as good as the best law, worse, or not judged."""
    if near := record.answered("not told apart"):
        yield laws.equivalent(near)
    if worse := record.answered("worse"):
        yield laws.worse(worse)
    best_row = record.laws[best]
    for name, row in record.laws.items():
        if row.hopeless and name != best:
            behind = best_row.log_likelihood - row.log_likelihood
            yield laws.by_fit_alone(name, row.error, best, best_row.error, behind)
    if rough := record.answered("not judged"):
        yield laws.not_judged(rough, best, GOOD_KHAT)


def _of_targets(rows: Rows, best: str) -> Iterator[str]:
    """Yield a sentence if another law predicts stronger tests, or tests of other kinds, better."""
    for target in TARGETS:
        shares = weights_for(rows, target)
        if shares and best not in shares:
            errors = errors_on(rows, target)
            least = errors[next(iter(shares))]
            yield laws.predicted_by(target, list(shares), least, best, errors.get(best))


def _of_errors(record: StoredLaws, best: str) -> Iterator[str]:
    """Yield sentences that compare the best law's error with repeats and linear oscillators."""
    if record.floor is not None and record.floor > 0:
        error = record.laws[best].error
        near = error / record.floor < NEAR_FLOOR
        yield laws.against_repeats(best, error, record.floor, near=near)
    if record.line is not None and (lines := record.lines.values()):
        yield laws.linear_by_session(record.line, min(lines), max(lines))


def _of_parameters(rows: Rows) -> Iterator[str]:
    """Yield sentences on prior bounds and on thresholds for laws not worse than the best law."""
    for name, row in rows.items():
        if row.answer == "worse":
            continue
        yield from (laws.of_law(name, sentence) for sentence in row.widened)
        if row.at_bound:
            yield laws.at_bound(name, row.at_bound)
        several = len(row.laws) > 1
        yield from (f"{name}: {text}" if several else text for text in row.reached)


def _of_rough_scores(rows: Rows) -> Iterator[str]:
    """Yield sentences on laws with few effective draws for their scores or evidence."""
    sentences = {"khat": laws.unreliable_scores, "khat_evidence": laws.unreliable_evidence}
    for key, sentence in sentences.items():
        if rough := [n for n, row in rows.items() if (getattr(row, key) or 0.0) > GOOD_KHAT]:
            yield sentence(rough, GOOD_KHAT)


def _of_unseen(rows: Rows) -> Iterator[str]:
    """Yield sentences on which law predicts each type of held-out test best.

    Within and beyond refer to the largest fitted motion.
    """
    sentences = {"error_held_out": laws.best_within, "error_beyond": laws.best_beyond}
    for key, sentence in sentences.items():
        every = {name: getattr(row, key) for name, row in rows.items()}
        errors = {name: error for name, error in every.items() if error is not None}
        if errors:
            least = min(errors, key=lambda name: errors[name])
            yield sentence(least, errors[least])
    across = {name: row.error_across for name, row in rows.items() if row.error_across}
    for kind in next(iter(across.values()), {}):
        least = min(across, key=lambda name: across[name][kind])
        yield laws.best_across(least, kind, across[least][kind])


def _of_offsets(best: str, shared: StoredSharedRuns | None) -> Iterator[str]:
    """Yield the sentence on the best law if omega_n and zeta are equal in all runs."""
    if shared is None:
        return
    moved = [
        laws.moved(name, (row.without, row.without_sd), (row.with_offsets, row.with_sd))
        for name, row in shared.parameters.items()
    ]
    least = min(shared.errors, key=shared.errors.__getitem__)
    with_offsets, without = shared.error
    yield laws.without_offsets(best, without, with_offsets, moved, least, shared.errors[least])


def _of_widths(rows: Rows) -> Iterator[str]:
    """Yield sentences on how wider priors change the evidence."""
    widened = {name: _less(row.log_evidence_wide, row.log_evidence) for name, row in rows.items()}
    if changes := {name: change for name, change in widened.items() if change is not None}:
        yield laws.wider_priors(changes)
    judged = (name for name, row in rows.items() if row.log_evidence is not None)
    if lacking := [name for name in judged if rows[name].log_evidence_wide is None]:
        yield laws.no_wider_evidence(lacking)
