"""`jbw.compare_laws`: which law of the joint do the data of a campaign ask for, and how surely?"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from jbw.campaign.load import Campaign
from jbw.identification import evidence
from jbw.identification.assemble import Report, entered, measured_in
from jbw.identification.diagnosis import diagnose, diagnosis_sentences
from jbw.identification.evidence import Candidate, offset_changes, without_offsets
from jbw.identification.floors import own_lines, scatter_of_means
from jbw.identification.run_effects import runs_dataset, runs_sentence
from jbw.identification.unseen_runs import LeftOut, runs_of
from jbw.inference.posterior.summary import evenly_spaced, scalars
from jbw.inference.space.box import require_float64
from jbw.measurement.channels import rms
from jbw.measurement.records import Test, belongs_to
from jbw.observables.dataset import Dataset
from jbw.observables.drives import readings_of
from jbw.oscillator.laws import FAMILIES, LAWS, laws_named
from jbw.report.messages import stages
from jbw.report.messages import study as messages
from jbw.study.law_answers import compare_rows, statements
from jbw.study.law_rows import (
    Weighed,
    errors_across_kinds,
    errors_apart,
    held_out,
    loops,
    residuals,
    row_of,
    unseen,
    weigh,
)
from jbw.study.laws_at_joints import trials_at_joints
from jbw.study.look import look_groups, look_quietly
from jbw.study.stack import law_groups, stack_of
from jbw.verification.backbone import HERTZ, RATIO, curves
from jbw.verification.bands import QUANTILE_AXIS, band
from jbw.verification.predict import predict
from jbw.verification.predicted import carry

logger = logging.getLogger("jbw")

# What is tried unless laws are named, where the register has them: none, elastic, a smooth pair
# that loses energy, and the hysteretic ones alone and beside an elastic one.
USUAL = (
    "", "cubic", "quadratic + quadratic_damping", "bouc_wen", "bouc_wen + cubic", "bouc_wen_nu",
    "iwan4", "iwan4 + cubic", "masing_power + cubic", "jenkins_3",
)  # fmt: skip
OF_LOOPS = ("gap_series",)  # besides, where force passes through zero along a motion that is given
NUM_DRAWS = 50  # that the curves' bands are made of
NUM_AMPLITUDES = 40


@dataclass(frozen=True)
class LawComparison:
    """Result of `compare_laws`."""

    candidates: dict[str, Candidate]  # by name, fitted to one dataset
    tree: xr.DataTree  # scores by run and law, and curves against amplitude
    record: dict[str, Any]  # all numbers in plain values, as `laws.json` holds them

    def predict(self, test: Test) -> xr.Dataset:
        """Bands of all laws together on any test, each law by its weight.

        Raises:
            DataError: If the test's source is in another unit than the campaign's.
        """
        return predict(stack_of(self.tree, self.record), test)


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
        laws: Each a name, several joined by + or in a sequence; those that are usual when None. Of
            several joints each is tried at all of them and at one, and names such as
            `jenkins_3@bolt_1` at that joint.
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
    chosen = None if laws is None else _chosen(laws)
    tried: list[str] = []
    if campaign.joints is None:
        sets = _usual(campaign) if chosen is None else chosen
    else:
        sets, sentence = trials_at_joints(campaign.laws, chosen)
        tried.append(sentence)
    settings = campaign.settings
    seen = measured_in(campaign, report)
    keys = jax.random.split(jax.random.key(settings.seed if seed is None else seed), 3)
    candidates, refused = evidence.candidates(keys[0], seen, sets, report)
    weighed, unweighed = weigh(keys[1:], candidates, report)
    refused |= unweighed
    named = {name: law.candidate for name, law in weighed.items()}
    draws = {name: law.draws for name, law in weighed.items()}
    by_law = {name: law.left_out for name, law in weighed.items() if law.left_out is not None}
    runs = runs_of(candidates[0].fitted.data)
    y_peak = max(law.fitted.y_peak for law in named.values())
    highest = _highest(campaign, runs)
    rows = _rows(weighed, by_law, highest)
    first = candidates[0].fitted
    lines = own_lines(first.data, {**_held(first.data), **first.fit.theta})
    readings = readings_of(candidates[0].fitted.data.parts)
    diagnosis = None if readings is None else diagnose(readings)
    record = {
        "campaign": campaign.name,
        "diagnosis": None if diagnosis is None else diagnosis._asdict(),
        "runs": list(runs),
        "highest": highest,
        "floor": scatter_of_means(candidates[0].fitted.data),
        "line": rms(list(lines.values())) if lines else None,
        "lines": lines,
        "laws": rows,
        "refused": refused,
    }
    diagnosis_words = [] if diagnosis is None else diagnosis_sentences(diagnosis)
    (best,) = (name for name, row in rows.items() if row["answer"] == "best")
    best_fit = named[best].fitted
    groups = law_groups(campaign.tests, named, draws)
    names = (*best_fit.data.runs, *best_fit.data.labels)
    others = held_out(unseen(campaign.tests, names), groups, list(named), settings.seed)
    for name, row in rows.items():
        row |= errors_apart(others, name, best)
    record["shared_runs"] = None
    if best_fit.data.has_offsets:
        report(stages.FITTING_SHARED)
        shared = without_offsets(keys[0], seen, list(named.values()), named[best])
        record["shared_runs"] = _shared_runs(named[best], dict(zip(named, shared, strict=True)))
    posterior = draws[best]["posterior"].to_dataset()
    offsets = runs_dataset(keys[0], posterior, best_fit.box.names, best_fit.data)
    scatter = [] if offsets is None else [f"Under {best}: {runs_sentence(offsets)}"]
    record["statements"] = [*tried, *diagnosis_words, *statements(record), *scatter]
    tree = xr.DataTree.from_dict(
        {
            "/scores": _scores(by_law, runs, lines),
            "/curves": _curves(named, draws, y_peak).assign(hopeless=_hopeless(rows)),
            "/loops": loops(named, y_peak),
            "/residuals": residuals(named, highest),
            **({} if offsets is None else {"/offsets": offsets}),
            **({} if others is None else {"/held_out": others}),
            **look_groups(look_quietly(campaign), entered(seen)),
            **groups,
        }
    )
    return LawComparison(named, tree, record)


def _rows(
    weighed: Mapping[str, Weighed], by_law: Mapping[str, LeftOut], highest: str | None
) -> dict[str, dict[str, Any]]:
    """A row of every law, compared by scores of runs left out, with its errors on these."""
    rows = {name: row_of(law) for name, law in weighed.items()}
    compare_rows(rows, {name: np.array(list(law.elpd.values())) for name, law in by_law.items()})
    for name, law in by_law.items():
        rows[name]["error_highest"] = law.error.get(highest) if highest else None
        rows[name]["error_across"] = errors_across_kinds(weighed[name].candidate)
    return rows


def _usual(campaign: Campaign) -> list[tuple[str, ...]]:
    """The usual laws that the register has, and the campaign's own."""
    loops = any(test.traits.is_prescribed for test in campaign.tests)
    usual = [_parts(names) for names in (*USUAL, *(OF_LOOPS if loops else ()))]
    available = [names for names in usual if all(_known(name) for name in names)]
    return list(dict.fromkeys([*available, campaign.laws]))


def _chosen(laws: Sequence[str | Sequence[str]]) -> list[tuple[str, ...]]:
    """Sets of laws by what names them, each once."""
    parted = (_parts(names) if isinstance(names, str) else tuple(names) for names in laws)
    sets = list(dict.fromkeys(parted))
    for names in sets:
        laws_named(names)
    return sets


def _parts(name: str) -> tuple[str, ...]:
    """Names of laws that + joins; none of a linear structure."""
    parts = [part.strip() for part in name.split("+")]
    return tuple(part for part in parts if part not in ("", "linear"))


def _known(name: str) -> bool:
    return name in LAWS or name.rpartition("_")[0] in FAMILIES


def _highest(campaign: Campaign, runs: Sequence[str]) -> str | None:
    """The run of the highest level of the first kind of test that has levels."""
    levels: dict[str, dict[str, float]] = {}
    for test in campaign.tests:
        of_test = [run for run in runs if belongs_to(run, test.name)]
        if np.isfinite(test.level) and of_test:
            levels.setdefault(test.kind, {})[of_test[0]] = test.level
    first = next(iter(levels.values()), {})
    return max(first, key=lambda run: first[run]) if len(first) > 1 else None


def _scores(
    held_out: Mapping[str, LeftOut], runs: Sequence[str], lines: Mapping[str, float]
) -> xr.Dataset:
    dims, none = ("law", "run"), np.zeros((0, len(runs)))
    elpd = np.array([[score.elpd[run] for run in runs] for score in held_out.values()])
    error = np.array([[score.error[run] for run in runs] for score in held_out.values()])
    return xr.Dataset(
        {
            "elpd": (dims, elpd if held_out else none, {"long_name": "log predictive density"}),
            "error": (
                dims,
                error if held_out else none,
                {"units": "1", "long_name": "error over rms"},
            ),
            "line": (
                "run",
                [lines.get(run, np.nan) for run in runs],
                {"units": "1", "long_name": messages.VARIABLES["line"]},
            ),
        },
        {"law": list(held_out), "run": list(runs)},
    )


def _curves(
    named: Mapping[str, Candidate], draws: Mapping[str, xr.DataTree], y_peak: float
) -> xr.Dataset:
    """Frequency and damping against amplitude under every law, with bands."""
    amplitude = np.linspace(0.0, 1.25 * y_peak, NUM_AMPLITUDES + 1)[1:]
    frequency, damping = [], []
    for name, candidate in named.items():
        theta = _some(draws[name], candidate.fitted.data)
        carried = carry(curves, theta, jnp.asarray(amplitude), candidate.laws)
        frequency.append(band(carried[0]))
        damping.append(band(carried[1]))
    dims = ("law", "quantile", "amplitude")
    return xr.Dataset(
        {"frequency": (dims, frequency, HERTZ), "damping": (dims, damping, RATIO)},
        {"law": list(named), "quantile": QUANTILE_AXIS, "amplitude": (
            "amplitude", amplitude, {"units": "m"})},
        {"y_fitted": float(y_peak)},
    )  # fmt: skip


def _hopeless(rows: Mapping[str, Mapping[str, Any]]) -> tuple[str, list[bool], dict[str, str]]:
    """Which laws are judged by their fits: the bands about these are of no posterior."""
    attrs = {"long_name": messages.VARIABLES["hopeless"]}
    return "law", [row["hopeless"] for row in rows.values()], attrs


def _some(tree: xr.DataTree, data: Dataset) -> dict[str, np.ndarray]:
    """Some draws by name, and what was held."""
    posterior = tree["posterior"].to_dataset()
    chosen = evenly_spaced(posterior, NUM_DRAWS)
    theta = {name: np.ravel(values)[chosen] for name, values in scalars(tree).items()}
    held = {name: np.full(len(chosen), value) for name, value in _held(data).items()}
    return {**held, **theta}


def _shared_runs(best: Candidate, shared: Mapping[str, Candidate]) -> dict[str, Any]:
    """What laws would be without offsets of the runs: the best one's parameters, all errors."""
    errors = {name: shared_fit.error for name, shared_fit in shared.items()}
    return {**offset_changes(best, shared[best.name]), "errors": errors}


def _held(data: Dataset) -> dict[str, float]:
    return {name: float(value) for name, value in data.held.items()}
