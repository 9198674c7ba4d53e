"""`jbw.compare_laws`: which law of the joint do the data of a campaign ask for, and how surely?"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from jbw.campaign.load import Campaign, force_per_unit
from jbw.identification import evidence
from jbw.identification.assemble import Report, measured
from jbw.identification.evidence import APART, FEWEST_RUNS, Candidate, LeftOut, name_of
from jbw.identification.joint import sample_joint
from jbw.inference.posterior.summary import evenly_spaced, scalars
from jbw.inference.samplers.chunked_run import no_checkpoint
from jbw.inference.space.box import require_float64
from jbw.observables.dataset import Dataset, largest_displacement
from jbw.oscillator.laws import LAWS, laws_named
from jbw.report.laws import laws_figure
from jbw.study.store import write_figure, write_json
from jbw.verification.backbone import HERTZ, RATIO, curves
from jbw.verification.bands import QUANTILES, band
from jbw.verification.predicted import carry

logger = logging.getLogger("jbw")

# What is tried unless laws are named, where the register has them: none, elastic, a smooth pair
# that loses energy, and the hysteretic ones alone and beside an elastic one.
USUAL = (
    "", "cubic", "quadratic + quadratic_damping", "bouc_wen", "bouc_wen + cubic", "bouc_wen_nu",
    "iwan4", "iwan4 + cubic", "masing_power + cubic", "jenkins_3",
)  # fmt: skip
NUM_DRAWS = 50  # that the curves' bands are made of
NUM_AMPLITUDES = 40
NATS = 5.0  # of evidence from which a law is told apart where runs are too few
TWICE = float(np.log(2.0))  # what doubling the width of one prior costs


@dataclass(frozen=True)
class LawComparison:
    """Result of `compare_laws`."""

    candidates: dict[str, Candidate]  # by name, fitted to one dataset
    tree: xr.DataTree  # scores by run and law, and curves against amplitude
    record: dict[str, Any]  # all numbers in plain values, as `laws.json` holds them


def compare_laws(
    campaign: Campaign,
    laws: Sequence[str | Sequence[str]] | None = None,
    *,
    seed: int | None = None,
    report: Report = logger.info,
) -> LawComparison:
    r"""Try laws of the joint on one campaign, and say which of them the data tell apart.

    Args:
        campaign: From `jbw.load_campaign` or the virtual rig; its own laws are tried too.
        laws: Each a name, several joined by + or in a sequence; those that are usual when None.
        seed: Seed of everything random; the campaign's when None.
        report: Called with one sentence at every stage.

    Returns:
        Of every law the error of its fit, the error of what it predicts of runs that it has not
        seen, the log score of these with its difference to the best and its standard error, the
        weight by which it enters a mixture that predicts, and the log evidence. `record` says in
        words what is told apart and what is not.

    Raises:
        ConfigError: An unknown law, or none that can be fitted.
        DataError: A campaign with nothing to fit.
    """
    require_float64()
    sets = list(dict.fromkeys([*_chosen(laws), campaign.laws] if laws is None else _chosen(laws)))
    settings = campaign.settings
    seen = measured(
        campaign.tests, settings, laws=campaign.laws, gain=force_per_unit(campaign), report=report
    )
    keys = jax.random.split(jax.random.key(settings.seed if seed is None else seed), 3)
    found, refused = evidence.candidates(keys[0], seen, sets, report)
    named = {name_of(one.laws): one for one in found}
    data = found[0].fitted.data
    runs, left = evidence.runs_of(data), {}
    if len(runs) > 1:
        for i, (name, one) in enumerate(named.items()):
            report(f"{name}: each of {len(runs)} runs predicted from the others")
            left[name] = evidence.left_out(jax.random.fold_in(keys[1], i), one)
    draws = {}
    for i, (name, one) in enumerate(named.items()):
        report(f"{name}: posterior and evidence")
        key = jax.random.fold_in(keys[2], i)
        draws[name] = sample_joint(key, one.fitted, settings, no_checkpoint, name)
    rows = {name: _row(one, left.get(name), draws[name]) for name, one in named.items()}
    scores = {name: np.array(list(one.elpd.values())) for name, one in left.items()}
    _compare(rows, scores)
    y_peak = max(_largest(one) for one in found)
    highest = _highest(campaign, runs)
    for name, one in left.items():
        rows[name]["error_highest"] = one.error.get(highest) if highest else None
    record = {
        "campaign": campaign.name,
        "runs": list(runs),
        "highest": highest,
        "floor": evidence.floor_of(data),
        "laws": rows,
        "refused": {name_of(laws): reason for laws, reason in refused.items()},
    }
    record["statements"] = statements(record)
    tree = xr.DataTree.from_dict(
        {
            "/scores": _scores(left, runs),
            "/curves": _curves(named, draws, y_peak),
            **{f"/posterior/{name}": one["posterior"].to_dataset() for name, one in draws.items()},
        }
    )
    return LawComparison(named, tree, record)


def _chosen(laws: Sequence[str | Sequence[str]] | None) -> list[tuple[str, ...]]:
    """Sets of laws by what names them; of the usual ones those that the register has."""
    if laws is None:
        usual = [_parts(one) for one in USUAL]
        return [one for one in usual if all(_known(name) for name in one)]
    sets = [_parts(one) if isinstance(one, str) else tuple(one) for one in laws]
    for one in sets:
        laws_named(one)
    return sets


def _parts(name: str) -> tuple[str, ...]:
    """Names of laws that + joins; none of a linear structure."""
    parts = [part.strip() for part in name.split("+")]
    return tuple(part for part in parts if part not in ("", "linear"))


def _known(name: str) -> bool:
    return name in LAWS or name.rpartition("_")[0] in LAWS


def _largest(one: Candidate) -> float:
    values = {**one.fitted.data.held, **one.fitted.fit.theta}
    return largest_displacement(one.fitted.data, float(values.get("omega_n", 1.0)))


def _highest(campaign: Campaign, runs: Sequence[str]) -> str | None:
    """The run of the highest level of the first kind of test that has levels."""
    levels: dict[str, dict[str, float]] = {}
    for test in campaign.tests:
        own = [run for run in runs if run == test.name or run.startswith(f"{test.name} ")]
        if test.level is not None and own:
            levels.setdefault(test.kind, {})[own[0]] = test.level
    first = next(iter(levels.values()), {})
    return max(first, key=lambda run: first[run]) if len(first) > 1 else None


def _row(one: Candidate, left: LeftOut | None, tree: xr.DataTree) -> dict[str, Any]:
    """Numbers of one law, plain values."""
    names = one.fitted.box.names
    posterior, count = tree["posterior"].to_dataset(), len(_own(one))
    known = tree.attrs.get("log_evidence")
    return {
        "laws": list(one.laws),
        "num_parameters": len(names),
        "error": one.error,
        "error_left_out": None if left is None else _rms(left.error),
        "error_highest": None,
        "elpd": None if left is None else float(sum(left.elpd.values())),
        "khat": None if left is None else left.khat,
        "log_evidence": known,
        "log_evidence_error": tree.attrs.get("log_evidence_error"),
        "log_evidence_wide": None if known is None else known - count * TWICE,
        "at_bound": list(one.at_bound),
        "sampler": tree.attrs.get("sampler"),
        "parameters": {
            str(name): {"mean": float(posterior[name].mean()), "sd": float(posterior[name].std())}
            for name in names
        },
    }


def _own(one: Candidate) -> list[str]:
    """Parameters of the laws alone, among those that are inferred."""
    own = {name for law in laws_named(one.laws) for name in law.names()}
    return [name for name in one.fitted.box.names if name in own]


def _rms(errors: Mapping[str, float]) -> float:
    return float(np.sqrt(np.mean(np.square(list(errors.values())))))


def _compare(rows: dict[str, dict[str, Any]], scores: Mapping[str, np.ndarray]) -> None:
    """Differences to the best law, weights, and whether each law is told apart from it."""
    evidences = {name: row["log_evidence"] for name, row in rows.items()}
    known = {name: value for name, value in evidences.items() if value is not None}
    by_runs = len(scores) == len(rows) and len(next(iter(scores.values()))) >= FEWEST_RUNS
    if by_runs:
        best = max(scores, key=lambda name: float(np.sum(scores[name])))
    else:
        best = (
            max(known, key=lambda name: known[name])
            if known
            else min(rows, key=lambda name: rows[name]["error"])
        )
    differences = evidence.differences(scores, best) if scores else {}
    weights = evidence.stacking(scores) if by_runs else {}
    for name, row in rows.items():
        difference, error = differences.get(name, (None, None))
        row["elpd_difference"] = difference
        row["elpd_difference_se"] = error if error is not None and np.isfinite(error) else None
        row["weight"] = weights.get(name)
        of_evidence = known[name] - known[best] if name in known and best in known else None
        row["log_evidence_difference"] = of_evidence
        if name == best:
            row["answer"] = "best"
        elif by_runs and difference is not None:
            apart = -difference > APART * (error or 0.0)
            row["answer"] = "worse" if apart else "not told apart"
        else:
            apart = of_evidence is not None and of_evidence < -NATS
            row["answer"] = "worse" if apart else "not told apart"


def statements(record: Mapping[str, Any]) -> list[str]:
    """What the comparison says, in words."""
    rows, count = record["laws"], len(record["runs"])
    best = next(name for name, row in rows.items() if row["answer"] == "best")
    near = [name for name, row in rows.items() if row["answer"] == "not told apart"]
    worse = [name for name, row in rows.items() if row["answer"] == "worse"]
    by_runs = rows[best]["weight"] is not None
    how = (
        f"by what each predicts of {count} runs that it has not seen"
        if by_runs
        else f"by the evidence alone: {count} run{'s' if count != 1 else ''} left out in turn "
        f"are too few, {FEWEST_RUNS} are needed"
    )
    said = [f"Best is {best}, {how}."]
    if near:
        said.append(f"Not told apart from it: {', '.join(near)}.")
    if worse:
        said.append(f"Told apart, and worse: {', '.join(worse)}.")
    if (floor := record["floor"]) is not None:
        ratio = rows[best]["error"] / floor if floor > 0 else np.inf
        said.append(
            f"{best} leaves {100 * rows[best]['error']:.2g} % of the response where single repeats "
            f"scatter by {100 * floor:.2g} %"
            + ("; no law is asked for beyond it." if ratio < 1.2 else ".")
        )
    for name, row in rows.items():
        if row["at_bound"] and row["answer"] != "worse":
            said.append(f"{name}: {', '.join(row['at_bound'])} at a bound of the prior.")
        if row["khat"] is not None and row["khat"] > 0.7:
            said.append(
                f"{name}: the score of a left-out run is rough (k-hat {row['khat']:.2f}, 0.7 is "
                "the limit)."
            )
    said.append("Doubling the width of a law's priors takes 0.7 nats a parameter off its evidence.")
    return said


def _scores(left: Mapping[str, LeftOut], runs: Sequence[str]) -> xr.Dataset:
    dims, none = ("law", "run"), np.zeros((0, len(runs)))
    elpd = np.array([[one.elpd[run] for run in runs] for one in left.values()])
    error = np.array([[one.error[run] for run in runs] for one in left.values()])
    return xr.Dataset(
        {
            "elpd": (dims, elpd if left else none, {"long_name": "log predictive density"}),
            "error": (dims, error if left else none, {"units": "1", "long_name": "error over rms"}),
        },
        {"law": list(left), "run": list(runs)},
    )


def _curves(
    named: Mapping[str, Candidate], draws: Mapping[str, xr.DataTree], y_peak: float
) -> xr.Dataset:
    """Frequency and damping against amplitude under every law, with bands."""
    amplitude = np.linspace(0.0, 1.25 * y_peak, NUM_AMPLITUDES + 1)[1:]
    frequency, damping = [], []
    for name, one in named.items():
        theta = _some(draws[name], one.fitted.data)
        own = carry(curves, theta, jnp.asarray(amplitude), one.laws)
        frequency.append(band(own[0]))
        damping.append(band(own[1]))
    dims = ("law", "quantile", "amplitude")
    return xr.Dataset(
        {"frequency": (dims, frequency, HERTZ), "damping": (dims, damping, RATIO)},
        {"law": list(named), "quantile": list(QUANTILES), "amplitude": (
            "amplitude", amplitude, {"units": "m"})},
        {"y_fitted": float(y_peak)},
    )  # fmt: skip


def _some(tree: xr.DataTree, data: Dataset) -> dict[str, np.ndarray]:
    """Some draws by name, and what was held."""
    posterior = tree["posterior"].to_dataset()
    chosen = evenly_spaced(posterior, NUM_DRAWS)
    theta = {name: np.ravel(values)[chosen] for name, values in scalars(tree).items()}
    held = {name: np.full(len(chosen), float(value)) for name, value in data.held.items()}
    return {**held, **theta}


def save_laws(folder: Path, found: LawComparison) -> None:
    """Write laws.nc, laws.png and laws.json, the numbers last."""
    found.tree.to_netcdf(folder / "laws.nc", engine="h5netcdf")
    write_figure(folder / "laws.png", laws_figure(found.tree))
    write_json(folder / "laws.json", found.record)
