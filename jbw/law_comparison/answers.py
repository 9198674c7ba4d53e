r"""The results of a comparison of laws: the best law, and the laws distinguished from it.

$$\Delta = \sum_r (\mathrm{elpd}_r - \mathrm{elpd}^{\,0}_r), \qquad
  \mathrm{se} = \sqrt{n}\ \mathrm{sd}_r(\mathrm{elpd}_r - \mathrm{elpd}^{\,0}_r)$$

Reference:
    Vehtari, Gelman and Gabry (2017), Statistics and Computing 27, 1413; for the weights, Yao,
    Vehtari, Simpson and Gelman (2018), Bayesian Analysis 13, 917.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.inference.posterior.verdict import GOOD_KHAT
from jbw.report.messages import laws

FEWEST_RUNS = 5  # number of runs from which on the standard error of differences is reliable
APART = 2.0  # number of standard errors by which the scores of distinguished laws differ
# A score with poor weights may be off by this multiple of its difference to the score of fits.
OFF = 3.0
# difference of log evidence that distinguishes laws, if there are too few runs for scores
NATS = 5.0
# Laws predict a target equally well if their error is at most this multiple of the least one.
AS_GOOD = 1.1
# targets of predictions for which laws have separate errors: stronger tests, other kinds of test
TARGETS = (laws.OUTWARD, laws.ACROSS)
# An error up to this multiple of the standard deviation of the repeats' mean is close to noise.
NEAR_FLOOR = 1.2

Row = Mapping[str, Any]


def compare_rows(rows: dict[str, dict[str, Any]], scores: Mapping[str, np.ndarray]) -> None:
    """Add differences to the best law, weight and result to the row of each law."""
    by_runs = bool(scores) and len(next(iter(scores.values()))) >= FEWEST_RUNS
    best = _best(rows, scores, by_runs=by_runs)
    apart = differences(scores, best) if scores else {}
    weights = stacking(scores) if by_runs else {}
    for name, row in rows.items():
        difference, error = apart.get(name, (None, None))
        row["elpd_difference"] = difference
        row["elpd_difference_se"] = error if error is not None and np.isfinite(error) else None
        row["weight"] = weights.get(name)
        pair = row["log_evidence"], rows[best]["log_evidence"]
        row["log_evidence_difference"] = None if None in pair else pair[0] - pair[1]
        row["answer"] = "best" if name == best else _answer(row, rows[best], by_runs=by_runs)


def _best(rows: Mapping[str, Row], scores: Mapping[str, np.ndarray], *, by_runs: bool) -> str:
    """Return the name of the best law: by score, by evidence, or by error.

    A law with good importance weights is preferred, unless another law's score is higher by more
    than its possible error.
    """
    if by_runs:
        scored = {name: float(np.sum(x)) - _may_be_off(rows[name]) for name, x in scores.items()}
    else:
        evidence = {name: row["log_evidence"] for name, row in rows.items()}
        scored = {name: value for name, value in evidence.items() if value is not None}
    scored = {name: score for name, score in scored.items() if not rows[name]["hopeless"]}
    if not scored:
        return min(rows, key=lambda name: rows[name]["error"])
    sure = [name for name in scored if not _is_rough(rows[name], by_runs=by_runs)]
    return max(scored if by_runs else sure or scored, key=lambda name: scored[name])


def _may_be_off(row: Row) -> float:
    """Return the possible error of a law's score, where its importance weights are poor [nats]."""
    return OFF * row["elpd_doubt"] if _is_rough(row, by_runs=True) else 0.0


def _is_rough(row: Row, *, by_runs: bool) -> bool:
    """Return whether the importance weights behind a law's score are poor."""
    khat = row["khat" if by_runs else "khat_evidence"]
    return khat is not None and not khat <= GOOD_KHAT


def _answer(row: Row, best: Row, *, by_runs: bool) -> str:
    """Return a law's result compared with the best: worse, not told apart or not judged.

    A law with poor importance weights is not judged, unless its score is lower by more than its
    possible error, or the law does not fit at all (`hopeless`) and so is worse in any case.

    A law with a rough score is not judged, unless it lies farther behind than its possible error,
    or is hopeless and thus worse in any case.
    """
    behind = _behind_by_runs if by_runs else _behind_by_evidence
    if row["hopeless"] or behind(row, best):
        return "worse"
    rough = any(_is_rough(law, by_runs=by_runs) for law in (row, best))
    return "not judged" if rough else "not told apart"


def _behind_by_runs(row: Row, best: Row) -> bool:
    """Return whether a law's score is lower by more than its standard and possible errors."""
    off = _may_be_off(row) + _may_be_off(best)
    return -row["elpd_difference"] - off > APART * (row["elpd_difference_se"] or 0.0)


def _behind_by_evidence(row: Row, best: Row) -> bool:
    """Return whether a law's evidence is clearly lower for both widths of the priors."""
    if any(_is_rough(law, by_runs=False) for law in (row, best)):
        return False
    pairs = [(row[key], best[key]) for key in ("log_evidence", "log_evidence_wide")]
    return all(None not in pair and pair[0] < pair[1] - NATS for pair in pairs)


def differences(scores: Mapping[str, Float[np.ndarray, " run"]], reference: str) -> dict[str, Any]:
    """Return the sum of each law's score differences to a reference, and its standard error."""
    sums = {}
    for name, of_runs in scores.items():
        apart = of_runs - scores[reference]
        error = np.sqrt(len(apart)) * np.std(apart, ddof=1) if len(apart) > 1 else np.nan
        sums[name] = (float(np.sum(apart)), float(error))
    return sums


def stacking(scores: Mapping[str, Float[np.ndarray, " run"]]) -> dict[str, float]:
    """Return the weights of the laws whose mixture would have predicted the left-out runs best.

    These weights serve prediction and are no probabilities of truth: laws that predict alike share
    their weight.
    """
    from arviz_stats.loo.compare import compare
    from arviz_stats.utils import ELPDData

    if len(scores) == 1:
        return dict.fromkeys(scores, 1.0)
    # Scores are taken relative to the best law of each run: this leaves the weights unchanged, and
    # no exponential overflows.
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


def errors_on(rows: Mapping[str, Row], target: str) -> dict[str, float]:
    """Return laws' measured errors at the highest level, or on the worst kind of unfitted test."""
    if target == laws.OUTWARD:
        errors = {name: row.get("error_highest") for name, row in rows.items()}
    else:
        across = {name: row.get("error_across") or {} for name, row in rows.items()}
        errors = {name: max(kinds.values(), default=None) for name, kinds in across.items()}
    return {name: error for name, error in errors.items() if error is not None}


def weights_for(rows: Mapping[str, Row], target: str) -> dict[str, float]:
    """Return each law's share in predictions of a target, largest first; empty if unknown.

    Within the fitted amplitudes, the shares are the weights of the comparison. Outward and across
    kinds, laws whose error there is at most 1.1 times the least one share by the same weights. If
    none of these has a weight, the law with the least error predicts alone.
    """
    if target == laws.WITHIN:
        return {name: row["weight"] for name, row in rows.items() if row["weight"]}
    known = errors_on(rows, target)
    if len(known) < 2:
        return {}
    least = min(known, key=lambda name: known[name])
    close = {
        name: rows[name]["weight"] or 0.0
        for name, error in known.items()
        if error <= AS_GOOD * known[least]
    }
    total = sum(close.values())
    if not total:
        return {least: 1.0}
    shares = {name: weight / total for name, weight in close.items() if weight}
    return dict(sorted(shares.items(), key=lambda share: -share[1]))


def statements(record: Row) -> list[str]:
    """Return the sentences on a comparison of laws."""
    rows, count = record["laws"], len(record["runs"])
    best = _names(rows, "best")[0]
    return [
        laws.best_by_predictions(best, count)
        if rows[best]["weight"] is not None
        else laws.best_by_evidence(best, count, FEWEST_RUNS),
        *_of_answers(rows, best),
        *_of_errors(record, best),
        *_of_targets(rows, best),
        *_of_parameters(rows),
        *_of_rough_scores(rows),
        *_of_unseen(rows),
        *_of_offsets(best, record["shared_runs"]),
        *_of_widths(rows),
    ]


def _of_answers(rows: Mapping[str, Row], best: str) -> Iterator[str]:
    """Yield sentences on laws that are distinguished from the best, and on laws not judged."""
    if near := _names(rows, "not told apart"):
        yield laws.equivalent(near)
    if worse := _names(rows, "worse"):
        yield laws.worse(worse)
    for name, row in rows.items():
        if row["hopeless"] and name != best:
            behind = rows[best]["log_likelihood"] - row["log_likelihood"]
            yield laws.by_fit_alone(name, row["error"], best, rows[best]["error"], behind)
    if rough := _names(rows, "not judged"):
        yield laws.not_judged(rough, best, GOOD_KHAT)


def _of_targets(rows: Mapping[str, Row], best: str) -> Iterator[str]:
    """Yield sentences on laws that predict stronger or other tests better than the best law."""
    for target in TARGETS:
        shares = weights_for(rows, target)
        if shares and best not in shares:
            errors = errors_on(rows, target)
            least = errors[next(iter(shares))]
            yield laws.predicted_by(target, list(shares), least, best, errors.get(best))


def _of_errors(record: Row, best: str) -> Iterator[str]:
    """Yield sentences on the best law's error, next to repeats and a linear oscillator."""
    if (floor := record["floor"]) is not None and floor > 0:
        error = record["laws"][best]["error"]
        yield laws.against_repeats(best, error, floor, near=error / floor < NEAR_FLOOR)
    if lines := list(record["lines"].values()):
        yield laws.linear_by_session(record["line"], min(lines), max(lines))


def _of_parameters(rows: Mapping[str, Row]) -> Iterator[str]:
    """Yield sentences on parameters at bounds and reached thresholds, except of worse laws."""
    for name, row in rows.items():
        if row["answer"] == "worse":
            continue
        yield from (laws.of_law(name, sentence) for sentence in row.get("widened", ()))
        if row["at_bound"]:
            yield laws.at_bound(name, row["at_bound"])
        several = len(row["laws"]) > 1
        yield from (f"{name}: {text}" if several else text for text in row["reached"])


def _of_rough_scores(rows: Mapping[str, Row]) -> Iterator[str]:
    """Yield sentences on laws whose scores or evidence depend on few draws."""
    sentences = {"khat": laws.unreliable_scores, "khat_evidence": laws.unreliable_evidence}
    for key, sentence in sentences.items():
        if rough := [name for name, row in rows.items() if (row[key] or 0.0) > GOOD_KHAT]:
            yield sentence(rough, GOOD_KHAT)


def _of_unseen(rows: Mapping[str, Row]) -> Iterator[str]:
    """Yield sentences on which law predicts held-out tests best, by amplitude or kind of test.

    Tests within the fitted amplitudes, beyond them, and of other kinds are stated separately.

    Within and beyond refer to the largest fitted motion.
    """
    sentences = {"error_held_out": laws.best_within, "error_beyond": laws.best_beyond}
    for key, sentence in sentences.items():
        errors = {name: row[key] for name, row in rows.items() if row.get(key) is not None}
        if errors:
            least = min(errors, key=lambda name: errors[name])
            yield sentence(least, errors[least])
    across = {name: row["error_across"] for name, row in rows.items() if row.get("error_across")}
    for kind in next(iter(across.values()), {}):
        least = min(across, key=lambda name: across[name][kind])
        yield laws.best_across(least, kind, across[least][kind])


def _of_offsets(best: str, shared: Row | None) -> Iterator[str]:
    """Yield the sentence on the best law's fit if all sessions had the same omega_n and zeta."""
    if shared is None:
        return
    moved = [
        laws.moved(name, (row["without"], row["without_sd"]), (row["with"], row["with_sd"]))
        for name, row in shared["parameters"].items()
    ]
    errors = shared["errors"]
    least = min(errors, key=lambda name: errors[name])
    with_offsets, without = shared["error"]
    yield laws.without_offsets(best, without, with_offsets, moved, least, errors[least])


def _of_widths(rows: Mapping[str, Row]) -> Iterator[str]:
    """Yield sentences on how much the evidence depends on the priors."""
    pairs = {name: (row["log_evidence"], row["log_evidence_wide"]) for name, row in rows.items()}
    if changes := {name: pair[1] - pair[0] for name, pair in pairs.items() if None not in pair}:
        yield laws.wider_priors(changes)
    if lacking := [name for name, pair in pairs.items() if pair[1] is None is not pair[0]]:
        yield laws.no_wider_evidence(lacking)


def _names(rows: Mapping[str, Row], answer: str) -> list[str]:
    return [name for name, row in rows.items() if row["answer"] == answer]
