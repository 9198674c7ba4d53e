r"""What a comparison of laws answers: which is best, which are told apart from it, in words.

$$\Delta = \sum_r (\mathrm{elpd}_r - \mathrm{elpd}^{\,0}_r), \qquad
  \mathrm{se} = \sqrt{n}\ \mathrm{sd}_r(\mathrm{elpd}_r - \mathrm{elpd}^{\,0}_r)$$

Reference:
    Vehtari, Gelman and Gabry (2017), Statistics and Computing 27, 1413; for the weights, Yao,
    Vehtari, Simpson and Gelman (2018), Bayesian Analysis 13, 917.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.inference.posterior.verdict import GOOD_KHAT

FEWEST_RUNS = 5  # from which differences have a standard error that can be believed
APART = 2.0  # standard errors of a difference from which laws are told apart
OFF = 3.0  # times what the scores of points and of fits differ by: a rough score may be off by that
NATS = 5.0  # of evidence from which a law is told apart where runs are too few
NEAR_FLOOR = 1.2  # times the scatter of the mean of repeats

Row = Mapping[str, Any]


def compare_rows(rows: dict[str, dict[str, Any]], scores: Mapping[str, np.ndarray]) -> None:
    """Add to the row of each law its differences to the best, its weight and its answer."""
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
    """The law of the highest score, of the most evidence, or of the smallest error.

    One whose weights can be trusted, where there is one, unless the score of another is above it
    by more than that may be off by.
    """
    if by_runs:
        known = {name: float(np.sum(own)) - _may_be_off(rows[name]) for name, own in scores.items()}
    else:
        found = {name: row["log_evidence"] for name, row in rows.items()}
        known = {name: own for name, own in found.items() if own is not None}
    known = {name: own for name, own in known.items() if not rows[name]["hopeless"]}
    if not known:
        return min(rows, key=lambda name: rows[name]["error"])
    sure = [name for name in known if not _is_rough(rows[name], by_runs=by_runs)]
    return max(known if by_runs else sure or known, key=lambda name: known[name])


def _may_be_off(row: Row) -> float:
    """What a score of runs left out may be off by where its weights are poor [nats]."""
    return OFF * row["elpd_doubt"] if _is_rough(row, by_runs=True) else 0.0


def _is_rough(row: Row, *, by_runs: bool) -> bool:
    """Whether the weights that a law's score was found by cannot be trusted."""
    khat = row["khat" if by_runs else "khat_evidence"]
    return khat is not None and not khat <= GOOD_KHAT


def _answer(row: Row, best: Row, *, by_runs: bool) -> str:
    """Whether a law is told apart from the best; by evidence under both widths of the priors.

    By a score that is rough none is judged, but a law that lies farther behind than that may be
    off, and a hopeless one, which is worse whatever its score.
    """
    behind = _behind_by_runs if by_runs else _behind_by_evidence
    if row["hopeless"] or behind(row, best):
        return "worse"
    rough = any(_is_rough(one, by_runs=by_runs) for one in (row, best))
    return "not judged" if rough else "not told apart"


def _behind_by_runs(row: Row, best: Row) -> bool:
    """Whether a score lies behind by more than it scatters over runs, and than it may be off."""
    off = _may_be_off(row) + _may_be_off(best)
    return -row["elpd_difference"] - off > APART * (row["elpd_difference_se"] or 0.0)


def _behind_by_evidence(row: Row, best: Row) -> bool:
    """Whether the evidence lies behind, whichever width the priors have."""
    if any(_is_rough(one, by_runs=False) for one in (row, best)):
        return False
    pairs = [(row[key], best[key]) for key in ("log_evidence", "log_evidence_wide")]
    return all(None not in pair and pair[0] < pair[1] - NATS for pair in pairs)


def differences(scores: Mapping[str, Float[np.ndarray, " run"]], reference: str) -> dict[str, Any]:
    """Sum of the differences of every law's scores to the reference's, and its standard error."""
    found = {}
    for name, own in scores.items():
        apart = own - scores[reference]
        error = np.sqrt(len(apart)) * np.std(apart, ddof=1) if len(apart) > 1 else np.nan
        found[name] = (float(np.sum(apart)), float(error))
    return found


def stacking(scores: Mapping[str, Float[np.ndarray, " run"]]) -> dict[str, float]:
    """Weights of the laws whose mixture would have predicted the left-out runs best.

    They are for prediction, and no probabilities of truth: laws that predict alike share theirs.
    """
    from arviz_stats.loo.compare import compare
    from arviz_stats.utils import ELPDData

    if len(scores) == 1:
        return dict.fromkeys(scores, 1.0)
    # Each run over its best law: the weights are the same, and no exponential overflows.
    best = np.max(list(scores.values()), axis=0)
    scores = {name: own - best for name, own in scores.items()}
    each = {
        name: ELPDData(
            elpd=float(np.sum(own)), se=0.0, p=0.0, n_samples=1, n_data_points=len(own),
            scale="log", warning=False, good_k=0.7,
            elpd_i=xr.DataArray(own, dims="run"), pareto_k=xr.DataArray(0.0 * own, dims="run"),
        )
        for name, own in scores.items()
    }  # fmt: skip
    found = compare(each, method="stacking")
    return {str(name): float(weight) for name, weight in found["weight"].items()}


def statements(record: Row) -> list[str]:
    """What the comparison says, a sentence each."""
    rows, count = record["laws"], len(record["runs"])
    best = _names(rows, "best")[0]
    if rows[best]["weight"] is not None:
        said = [f"Best is {best}, by what each law predicts of {count} runs that it has not seen."]
    else:
        said = [
            f"{count} run{'s' if count != 1 else ''} are too few to compare predictions, "
            f"{FEWEST_RUNS} are needed: best is {best} by the evidence alone, which rests on the "
            "priors."
        ]
    if near := _names(rows, "not told apart"):
        said.append(f"Not told apart from it: {', '.join(near)}.")
    if worse := _names(rows, "worse"):
        said.append(f"Told apart, and worse: {', '.join(worse)}.")
    said += [
        f"{name} is judged by its fit alone: RMS error {100 * row['error']:.2g} %, of {best} "
        f"{100 * rows[best]['error']:.2g} %; its largest log likelihood is "
        f"{rows[best]['log_likelihood'] - row['log_likelihood']:.0f} lower."
        for name, row in rows.items()
        if row["hopeless"] and name != best
    ]
    if rough := _names(rows, "not judged"):
        said.append(
            f"Not judged: {', '.join(rough)}, whose score or that of {best} is rough (k-hat above "
            f"{GOOD_KHAT:g}); draw more, or restrict the priors."
        )
    if (floor := record["floor"]) is not None and floor > 0:
        error = rows[best]["error"]
        said.append(
            f"RMS error of {best}: {100 * error:.2g} % of the response; standard error of the mean "
            f"of the repeats: {100 * floor:.2g} %{_near(error / floor)}."
        )
    if lines := list(record["lines"].values()):
        said.append(
            "RMS error of a linear oscillator fitted to each run alone: "
            f"{100 * record['line']:.2g} %, from {100 * min(lines):.2g} to "
            f"{100 * max(lines):.2g} %."
        )
    for name, row in rows.items():
        if row["answer"] == "worse":
            continue
        if row["at_bound"]:
            said.append(f"{name}: {', '.join(row['at_bound'])} at a bound of the prior.")
        said += row["reached"] if len(row["laws"]) < 2 else [f"{name}: {x}" for x in row["reached"]]
    for key, what in (("khat", "Scores of runs left out are"), ("khat_evidence", "Evidence is")):
        if rough := [name for name, row in rows.items() if (row[key] or 0.0) > GOOD_KHAT]:
            said.append(f"{what} rough under {', '.join(rough)} (k-hat above {GOOD_KHAT:g}).")
    said += _of_unseen(rows)
    return [*said, *_of_offsets(best, record["shared_runs"]), *_of_widths(rows)]


def _of_unseen(rows: Mapping[str, Row]) -> list[str]:
    """Which laws predict best what nobody fitted, within the motion fitted and beyond, in words."""
    said = []
    for key, where in (
        ("error_held_out", "Tests held out, within the motion fitted"),
        ("error_beyond", "Tests beyond the motion fitted"),
    ):
        known = {name: row[key] for name, row in rows.items() if row.get(key) is not None}
        if known:
            least = min(known, key=lambda name: known[name])
            said.append(f"{where}: {least} predicts them best, to {100 * known[least]:.2g} %.")
    across = {name: row["error_across"] for name, row in rows.items() if row.get("error_across")}
    for kind in next(iter(across.values()), {}):
        least = min(across, key=lambda name: across[name][kind])
        error = 100 * across[least][kind]
        said.append(
            f"Across kinds: {least} predicts {kind} from the other tests best, to {error:.2g} %."
        )
    return said


def _of_offsets(best: str, shared: Row | None) -> list[str]:
    """What the best law would be if the runs shared omega_n and zeta, in words."""
    if shared is None:
        return []
    moved = [
        f"{name} {row['without']:.3g} +- {row['without_sd']:.1g} in place of {row['with']:.3g} "
        f"+- {row['with_sd']:.1g}"
        for name, row in shared["parameters"].items()
    ]
    least = min(shared["errors"], key=lambda name: shared["errors"][name])
    with_, without = (100 * error for error in shared["error"])
    said = (
        f"Runs have offsets, which trade with softening. Without them the RMS error of {best} "
        f"would be {without:.2g} % in place of {with_:.2g} %, with {', '.join(moved)}"
    )
    if least == best:
        return [f"{said}; no law would have a smaller one."]
    return [f"{said}; {least} would have the smallest, {100 * shared['errors'][least]:.2g} %."]


def _of_widths(rows: Mapping[str, Row]) -> list[str]:
    """How much the evidence hangs on the priors, in words."""
    widths = ("log_evidence", "log_evidence_wide")
    known = {name: [row[key] for key in widths] for name, row in rows.items()}
    moved = [f"{n} {pair[1] - pair[0]:+.1f}" for n, pair in known.items() if None not in pair]
    open_ = [name for name, pair in known.items() if pair[0] is not None and pair[1] is None]
    said = []
    if moved:
        said.append(
            "Priors of the laws' own parameters twice as wide move the log evidence by "
            f"{', '.join(moved)} (-0.7 a parameter that the data narrow; more "
            "where they push against a bound)."
        )
    if open_:
        said.append(f"Under such priors that of {', '.join(open_)} could not be integrated.")
    return said


def _near(ratio: float) -> str:
    return "; the data ask for no better law" if ratio < NEAR_FLOOR else ""


def _names(rows: Mapping[str, Row], answer: str) -> list[str]:
    return [name for name, row in rows.items() if row["answer"] == answer]
