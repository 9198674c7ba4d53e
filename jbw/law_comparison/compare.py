"""The comparison of joint laws on one campaign, `jbw.compare_laws`.

Every law is judged by the same numbers, loops and residuals. Errors on held-out tests are given
separately within and beyond the fitted motion: different laws may be best between the fitted levels
and above them, and a laboratory that plans the next level needs the second.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Key

from jbw.campaign.load import Campaign
from jbw.errors import Attempts, DataError, JbwError
from jbw.identification import evidence
from jbw.identification.across_kinds import across_kinds
from jbw.identification.assemble import Measured, Report, entered, measured_in
from jbw.identification.diagnosis import diagnose, diagnosis_sentences
from jbw.identification.evidence import Candidate, likelihood_at, offset_changes, without_offsets
from jbw.identification.floors import own_lines, scatter_of_means
from jbw.identification.joint import every_parameter
from jbw.identification.law_scores import (
    LeftOut,
    left_out,
    left_out_of_fits,
    log_evidence_wide,
    runs_of,
)
from jbw.identification.reached import threshold_sentences
from jbw.identification.run_effects import runs_dataset, runs_sentence
from jbw.identification.tied_joints import trials_at_joints
from jbw.inference.compiled import forget_when_many
from jbw.inference.posterior.summary import evenly_spaced, posterior_draws, scalars
from jbw.inference.space.box import require_float64
from jbw.inference.thresholds import BEYOND
from jbw.law_comparison.answers import compared_rows, statements
from jbw.law_comparison.stack import law_groups, stack_of
from jbw.measurement.channels import rms
from jbw.measurement.records import Test, belongs_to
from jbw.observables import dataset
from jbw.observables.dataset import Dataset
from jbw.observables.drives import readings_of
from jbw.oscillator.laws import FAMILIES, LAWS, laws_named
from jbw.oscillator.oscillator import oscillator_of
from jbw.parts import Parts, unkept
from jbw.report.messages import stages
from jbw.report.messages import study as messages
from jbw.results.attributes import DrawnPosterior
from jbw.results.laws import StoredLaw, StoredLaws
from jbw.study.free_group import (
    free_law_groups,
    free_law_of,
    free_law_record,
    free_law_sentences,
    gap_record,
    gap_sentences,
)
from jbw.study.look import look_groups, look_quietly
from jbw.verification.backbone import HERTZ, RATIO, curves
from jbw.verification.bands import QUANTILE_AXIS, band
from jbw.verification.predict import Request, predict
from jbw.verification.predicted import is_measured
from jbw.verification.predictive_basis import basis_of

logger = logging.getLogger("jbw")

# Laws that are compared by default, if they are registered: no law, elastic laws, a smooth
# dissipative pair, and hysteretic laws with and without an elastic one.
USUAL = (
    "", "cubic", "quadratic + quadratic_damping", "bouc_wen", "bouc_wen + cubic", "bouc_wen_nu",
    "iwan4", "iwan4 + cubic", "masing_power + cubic", "jenkins_3",
)  # fmt: skip
OF_LOOPS = ("gap_series",)  # additional law that is compared if tests prescribe the displacement
NUM_DRAWS = 50  # number of draws from which bands of the curves are computed
NUM_AMPLITUDES = 40
FREE_PARTICLES = 1000  # number of particles for the law without an assumed form
# Two random keys: one for the posterior, one for the scores of held-out runs.
Keys = Key[Array, " two"] | Sequence[Key[Array, ""]]
NUM_POINTS = 101  # number of points on half a loop
MOST_PARTS = 100  # largest number of record sections for which an rms is shown
NUM_ERROR_DRAWS = 20  # number of draws that give the median of an error


class Weighed(NamedTuple):
    """A fitted law with its posterior, its scores and its evidence."""

    candidate: Candidate
    draws: xr.DataTree
    left_out: LeftOut | None  # scores of held-out runs; None if there is only one run
    wide: float | None  # log evidence under priors twice as wide
    log_likelihood: float  # largest log likelihood [nats]
    # whether the fit is so poor that draws and scores are based on the fit alone
    hopeless: bool = False


# draws, scores of held-out runs, and log evidence under wider priors, as in `Weighed`
Judged = tuple[xr.DataTree, LeftOut | None, float | None]


@dataclass(frozen=True)
class LawComparison:
    """The result of `compare_laws`."""

    candidates: dict[str, Candidate]  # fitted sets of laws, by name, all with the same data
    tree: xr.DataTree  # scores by run and law, and curves against amplitude
    record: dict[str, Any]  # all results as plain values, as in `laws.json`

    def predict(self, test: Test) -> xr.Dataset:
        """Predict bands for any test from all laws, each with its weight.

        Raises:
            DataError: If the test's source is in another unit than the campaign's.
        """
        return predict(stack_of(self.tree, self.result), test)

    @cached_property
    def result(self) -> StoredLaws:
        """The content of `record` as typed objects."""
        return StoredLaws.read(self.record)


def compare_laws(
    campaign: Campaign,
    laws: Sequence[str | Sequence[str]] | None = None,
    *,
    seed: int | None = None,
    report: Report = logger.info,
    parts: Parts = unkept,
) -> LawComparison:
    r"""Fit and compare laws of the joint on one campaign; show which of them the data distinguish.

    Args:
        campaign: Campaign from `jbw.load_campaign` or the virtual rig; its own laws are tried too.
        laws: Laws by name; several names joined by + or in a sequence act in parallel. None for the
            usual ones. With several joints, each is tried at all joints and at each one, and a name
            such as `jenkins_3@bolt_1` only at that joint.
        seed: Random seed; the campaign's if None.
        report: Function that is called with one sentence at every stage.
        parts: Storage of the fit and the scores of each law, so that an interrupted comparison
            continues.

    Returns:
        For every law the error of its fit, the error of its predictions of held-out runs, the log
        score of these with its difference to the best and its standard error, its weight in a
        predictive mixture, and the log evidence. `record` contains sentences on which laws are
        distinguished and which are not.

    Raises:
        ConfigError: A law is unknown, or no law can be fitted.
        DataError: No test of the campaign can be fitted.

    Examples:
        The force loop of the virtual rig rejects a linear spring, for the joint slips:

        >>> import jbw; jbw.enable_x64()
        >>> rig = jbw.rig.measure("mixed", tests=["pull_4p00mm"], repeats=2, fs=256.0)
        >>> campaign = jbw.Campaign("joint", None, rig.tests)
        >>> found = jbw.compare_laws(campaign, ["bouc_wen", "linear"])
        >>> print(found.record["statements"][1])
        Laws that are significantly worse than the best law: linear.
    """
    require_float64()
    sets, tried = _trials(campaign, laws)
    seed = campaign.settings.seed if seed is None else seed
    seen = measured_in(campaign, report)
    keys = jax.random.split(jax.random.key(seed), 3)
    candidates, unfitted = evidence.candidates(keys[0], seen, sets, report, parts)
    weighed, unweighed = weigh(keys[1:], candidates, report, parts)
    first = candidates[0].fitted
    highest = _highest(campaign, list(runs_of(first.data)))
    rows = _rows(weighed, highest)
    (best,) = (name for name, row in rows.items() if row.answer == "best")
    named = {name: law.candidate for name, law in weighed.items()}
    groups = law_groups(campaign.tests, named, {name: law.draws for name, law in weighed.items()})
    tests = unseen(campaign.tests, _fitted_names(named[best]))
    errors = partial(held_out_errors, tests, groups, list(named), campaign.settings.seed)
    held_out = parts("errors of held-out tests", errors)
    rows = {name: row.replaced(**errors_apart(held_out, name, best)) for name, row in rows.items()}
    shared = partial(_shared_runs, keys[0], seen, named, best, report)
    shared_runs = parts("laws without offsets", shared)
    offsets = _offsets(keys[0], weighed[best])
    readings = readings_of(first.data.parts)
    diagnosis = None if readings is None else diagnose(readings)
    looked = look_quietly(campaign)
    without_form = Attempts(report).make(
        stages.WITHOUT_FORM,
        lambda: free_law_of(looked, seen, seed, named=True, particles=FREE_PARTICLES),
        None,
    )
    lines = own_lines(first.data, {**_held(first.data), **first.fit.theta})
    gaps = gap_record(campaign.tests, seen)
    record = StoredLaws.read(
        {
            "campaign": campaign.name,
            "diagnosis": None if diagnosis is None else diagnosis._asdict(),
            "runs": list(runs_of(first.data)),
            "highest": highest,
            "floor": scatter_of_means(first.data),
            "line": rms(list(lines.values())) if lines else None,
            "lines": lines,
            "laws": rows,
            "refused": unfitted | unweighed,
            "shared_runs": shared_runs,
            "free_law": free_law_record(without_form),
            "gap_sliders": gaps,
        }
    )
    sentences = [
        *([tried] if tried else []),
        *([] if diagnosis is None else diagnosis_sentences(diagnosis)),
        *statements(record),
        *free_law_sentences(without_form),
        *gap_sentences(gaps),
        *([] if offsets is None else [f"Under {best}: {runs_sentence(offsets)}"]),
    ]
    tree = _tree(weighed, record, {"/offsets": offsets, "/held_out": held_out})
    beside = look_groups(looked, entered(seen)) | free_law_groups(without_form)
    whole = xr.DataTree.from_dict({**tree, **beside, **groups})
    return LawComparison(named, whole, record.replaced(statements=sentences).plain())


def _tree(
    weighed: Mapping[str, Weighed],
    record: StoredLaws,
    besides: Mapping[str, xr.Dataset | None],
) -> dict[str, xr.Dataset]:
    """Return scores, curves, loops, residuals and posteriors of all laws, by path."""
    named = {name: law.candidate for name, law in weighed.items()}
    y_peak = max(law.fitted.y_peak for law in named.values())
    hopeless = [row.hopeless for row in record.laws.values()]
    return {
        "/scores": _scores(_left_out(weighed), record.runs, record.lines),
        "/curves": _curves(weighed, y_peak).assign(
            hopeless=("law", hopeless, {"long_name": messages.FIT_ALONE})
        ),
        "/loops": loops(named, y_peak),
        "/residuals": residuals(named, record.highest),
        **{path: group for path, group in besides.items() if group is not None},
    }


def _left_out(weighed: Mapping[str, Weighed]) -> dict[str, LeftOut]:
    """Return the scores of held-out runs, for those laws that have such scores."""
    return {name: law.left_out for name, law in weighed.items() if law.left_out is not None}


def _fitted_names(candidate: Candidate) -> tuple[str, ...]:
    """Return the names of the runs and data groups to which laws were fitted."""
    data = candidate.fitted.data
    return *data.runs, *data.labels


def _offsets(key: Key[Array, ""], law: Weighed) -> xr.Dataset | None:
    """Return the run offsets of omega_n and zeta under a law; None without such offsets."""
    fitted = law.candidate.fitted
    return runs_dataset(key, posterior_draws(law.draws), fitted.box.names, fitted.data)


def _rows(weighed: Mapping[str, Weighed], highest: str | None) -> dict[str, StoredLaw]:
    """Return a table row for each law, compared with the others by scores of held-out runs."""
    rows, scores = {name: row_of(law) for name, law in weighed.items()}, _left_out(weighed)
    elpd = {name: np.array(list(law.elpd.values())) for name, law in scores.items()}
    compared = compared_rows(rows, elpd)
    for name, law in scores.items():
        compared[name] = compared[name].replaced(
            error_highest=law.error.get(highest) if highest else None,
            error_across=errors_across_kinds(weighed[name].candidate),
        )
    return compared


def _trials(
    campaign: Campaign, laws: Sequence[str | Sequence[str]] | None
) -> tuple[tuple[tuple[str, ...], ...], str]:
    """Return the sets of laws to compare (by default the usual ones), and a sentence on them."""
    chosen = None
    if laws is not None:
        parted = (_parts(names) if isinstance(names, str) else tuple(names) for names in laws)
        chosen = list(dict.fromkeys(parted))
        for names in chosen:
            laws_named(names)  # An unknown name raises an error.
    if campaign.joints is not None:
        return trials_at_joints(campaign.laws, chosen)
    if chosen is not None:
        return tuple(chosen), ""
    # The usual laws that are registered are compared with the campaign's own laws.
    has_loops = any(test.traits.is_prescribed for test in campaign.tests)
    usual = [_parts(names) for names in (*USUAL, *(OF_LOOPS if has_loops else ()))]
    available = [
        names
        for names in usual
        if all(name in LAWS or name.rpartition("_")[0] in FAMILIES for name in names)
    ]
    return tuple(dict.fromkeys([*available, campaign.laws])), ""


def _parts(name: str) -> tuple[str, ...]:
    """Return the names of laws that a text joins by +; empty for the linear structure."""
    parts = [part.strip() for part in name.split("+")]
    return tuple(part for part in parts if part not in ("", "linear"))


def _highest(campaign: Campaign, runs: Sequence[str]) -> str | None:
    """Return the run with the highest level, of the first kind of test with several levels."""
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
                {"units": "1", "long_name": messages.ERROR_OF_LINEAR},
            ),
        },
        {"law": list(held_out), "run": list(runs)},
    )


def _curves(weighed: Mapping[str, Weighed], y_peak: float) -> xr.Dataset:
    """Return the frequency and damping against amplitude under every law, with bands."""
    amplitude = np.linspace(0.0, 1.25 * y_peak, NUM_AMPLITUDES + 1)[1:]
    frequency, damping = [], []
    for law in weighed.values():
        theta = _some(law.draws, law.candidate.fitted.data)
        carried = curves(theta, amplitude, law.candidate.laws)
        frequency.append(band(carried[0]))
        damping.append(band(carried[1]))
    dims = ("law", "quantile", "amplitude")
    return xr.Dataset(
        {"frequency": (dims, frequency, HERTZ), "damping": (dims, damping, RATIO)},
        {"law": list(weighed), "quantile": QUANTILE_AXIS, "amplitude": (
            "amplitude", amplitude, {"units": "m"})},
        {"y_fitted": float(y_peak)},
    )  # fmt: skip


def _some(tree: xr.DataTree, data: Dataset) -> dict[str, np.ndarray]:
    """Return evenly spaced draws of all parameters by name; fixed parameters are repeated."""
    posterior = posterior_draws(tree)
    chosen = evenly_spaced(posterior, NUM_DRAWS)
    theta = {name: np.ravel(values)[chosen] for name, values in scalars(tree).items()}
    held = {name: np.full(len(chosen), value) for name, value in _held(data).items()}
    return {**held, **theta}


def _shared_runs(
    key: Key[Array, ""],
    seen: Measured,
    named: Mapping[str, Candidate],
    best: str,
    report: Report,
) -> dict[str, Any] | None:
    """Fit laws without run offsets; return the best law's parameters and the errors of all laws.

    The result is None if no run has offsets.
    """
    if not named[best].fitted.data.has_offsets:
        return None
    report(stages.FITTING_SHARED)
    shared = without_offsets(key, seen, list(named.values()), named[best])
    by_name = dict(zip(named, shared, strict=True))
    errors = {name: shared_fit.error for name, shared_fit in by_name.items()}
    return {**offset_changes(named[best], by_name[best]), "errors": errors}


def _held(data: Dataset) -> dict[str, float]:
    return {name: float(value) for name, value in data.held.items()}


def weigh(
    keys: Key[Array, " two"],
    candidates: Sequence[Candidate],
    report: Report,
    parts: Parts = unkept,
) -> tuple[dict[str, Weighed], dict[str, str]]:
    """Sample and score each law; return failed laws, too, with the reasons.

    Laws that do not fit at all are scored by their fits alone.
    """
    weighed: dict[str, Weighed] = {}
    refused: dict[str, str] = {}
    runs = runs_of(candidates[0].fitted.data)
    likelihoods = {
        candidate.name: likelihood_at(candidate.fitted.fit, candidate.fitted.data)
        for candidate in candidates
    }
    hopeless = evidence.hopeless(candidates, likelihoods)
    for i, candidate in enumerate(candidates):
        forget_when_many()
        name, law_keys = candidate.name, [jax.random.fold_in(key, i) for key in keys]
        judge = partial(
            _by_fit if name in hopeless else _by_draws, law_keys, candidate, several=len(runs) > 1
        )
        report(stages.scoring(name, len(runs), by_fit=name in hopeless))
        try:
            judged = parts(f"scores of {name}", judge, LeftOut)
        except JbwError as error:
            refused[name] = str(error)
        else:
            weighed[name] = Weighed(
                candidate, *judged, likelihoods[name], hopeless=name in hopeless
            )
    if not weighed:
        raise DataError(f"No law can be compared on these data: {next(iter(refused.values()))}")
    return weighed, refused


def _by_draws(keys: Keys, candidate: Candidate, *, several: bool) -> Judged:
    """Return a law's posterior, scores of held-out runs, and evidence under wider priors."""
    drawn, moments = evidence.posterior(keys[0], candidate)
    held_out = left_out(keys[1], candidate, drawn, moments) if several else None
    wide = log_evidence_wide(keys[0], candidate, drawn)
    return drawn, held_out, wide


def _by_fit(keys: Keys, candidate: Candidate, *, several: bool) -> Judged:
    """Return draws and scores from the fit alone, for a law that fits very poorly."""
    held_out = left_out_of_fits(candidate) if several else None
    return evidence.about_fit(keys[0], candidate), held_out, None


def row_of(weighed: Weighed) -> StoredLaw:
    """Return the stored numbers of a law."""
    candidate, tree, held_out = weighed.candidate, weighed.draws, weighed.left_out
    names, posterior = candidate.fitted.box.names, posterior_draws(tree)
    facts = DrawnPosterior.of(tree)
    every = every_parameter(posterior, candidate.fitted.data)
    row = {
        "laws": list(candidate.laws),
        "meet": candidate.meet,
        "num_parameters": len(names),
        "error": candidate.error,
        "error_left_out": None if held_out is None else rms(list(held_out.error.values())),
        "error_highest": None,
        "error_across": None,
        "elpd": None if held_out is None else float(sum(held_out.elpd.values())),
        "khat": None if held_out is None else held_out.khat,
        "elpd_doubt": None if held_out is None else held_out.doubt,
        "log_likelihood": weighed.log_likelihood,
        "hopeless": weighed.hopeless,
        "log_evidence": facts.log_evidence,
        "log_evidence_error": facts.log_evidence_error,
        "log_evidence_wide": weighed.wide,
        "khat_evidence": facts.khat,
        "at_bound": list(candidate.at_bound),
        "widened": list(candidate.fitted.statements),
        "reached": threshold_sentences(every, candidate.fitted.y_peak, candidate.laws),
        "parameters": {
            str(name): {"mean": float(posterior[name].mean()), "sd": float(posterior[name].std())}
            for name in names
        },
    }
    return StoredLaw.read(row)


def loops(named: Mapping[str, Candidate], y_peak: float) -> xr.Dataset:
    """Return the laws' force loops at the largest displacement [m], less the fully stuck force.

    Each loop is the force minus that of the stuck spring, on the way down from y = Y and up again,
    at the fit of the law. Dampers have no effect at this slow motion.
    """
    down = y_peak * np.cos(np.linspace(0.0, np.pi, NUM_POINTS))
    force = []
    for candidate in named.values():
        theta = dataset.as_arrays(candidate.fitted.fit.theta, candidate.fitted.data)
        joint = oscillator_of(theta, candidate.laws)
        stuck = sum(law.stiffness() for law in joint.laws)
        if not joint.laws:
            force.append(np.zeros(2 * NUM_POINTS))
            continue
        joint_force = np.asarray(joint.force_unloading(y_peak, jnp.asarray(down)) - stuck * down)
        force.append(np.concatenate([joint_force, -joint_force]))
    return xr.Dataset(
        {
            "displacement": ("point", np.concatenate([down, -down]), {"units": "m"}),
            "force": (("law", "point"), force, {"units": "N/kg"}),
        },
        {"law": list(named)},
    )


def residuals(named: Mapping[str, Candidate], highest: str | None) -> xr.Dataset:
    """Return each law's residual, divided by its rms, for the data group of the highest level.

    If no level is known, the group is that with the largest response.
    """
    data = next(iter(named.values())).fitted.data
    sizes = dataset.size_by_label(data)
    pairs = zip(data.labels, data.runs, strict=True)
    labels = [label for label, run in pairs if run == highest and label in sizes] or list(sizes)
    if not labels:
        return xr.Dataset()
    label = max(labels, key=lambda name: sizes[name])
    rows = []
    for candidate in named.values():
        residual = dataset.residual_by_label(candidate.fitted.fit.residual, candidate.fitted.data)[
            label
        ]
        relative = np.abs(residual) * np.sqrt(len(residual)) / sizes[label]
        parts = np.array_split(relative, min(MOST_PARTS, len(relative)))
        rows.append([np.sqrt(np.mean(part**2)) for part in parts])
    return xr.Dataset(
        {"left": (("law", "part"), rows, {"units": "1"})}, {"law": list(named)}, {"group": label}
    )


def unseen(tests: Sequence[Test], runs: Sequence[str]) -> list[Test]:
    """Return the measured tests of which no record was fitted."""
    return [
        test
        for test in tests
        if is_measured(test) and not any(belongs_to(r, test.name) for r in runs)
    ]


def errors_across_kinds(candidate: Candidate) -> dict[str, float] | None:
    """Return a law's error for each kind of test, predicted from other kinds; None for one kind."""
    fitted = candidate.fitted
    predicted = across_kinds(fitted.fit, fitted.box, fitted.data)
    if predicted is None:
        return None
    return dict(
        zip(map(str, predicted["kind"].values), predicted["error"].values.tolist(), strict=True)
    )


def held_out_errors(
    tests: Sequence[Test], groups: Mapping[str, xr.Dataset], laws: Sequence[str], seed: int
) -> xr.Dataset | None:
    """Return each law's error and extrapolation on each held-out test; None without such tests.

    Values are NaN if a law cannot predict a test. `groups` are those of `law_groups`.
    """
    if not tests:
        return None
    shape = len(laws), len(tests)
    error, reach = np.full(shape, np.nan), np.full(shape, np.nan)
    for i, law in enumerate(laws):
        law_tree = xr.DataTree.from_dict(
            {"/": groups[f"/laws/{law}"], "/posterior": groups[f"/laws/{law}/posterior"]}
        )
        try:
            basis = basis_of(law_tree)
        except JbwError:
            continue
        for j, test in enumerate(tests):
            try:
                prediction = predict(
                    basis, test, Request(num_draws=NUM_ERROR_DRAWS, seed=seed)
                ).attrs
            except JbwError:
                continue
            error[i, j] = prediction.get("nrmse", np.nan)
            reach[i, j] = prediction.get("extrapolation", np.nan)
    dims = ("law", "test")
    return xr.Dataset(
        {
            "error": (dims, error, {"units": "1", "long_name": "error over rms"}),
            "extrapolation": (dims, reach, {
                "units": "1", "long_name": messages.EXTRAPOLATION}),
        },
        {"law": list(laws), "test": [test.name for test in tests]},
    )  # fmt: skip


def errors_apart(errors: xr.Dataset | None, law: str, best: str) -> dict[str, Any]:
    """Return a law's rms errors on held-out tests, within and above the fitted amplitudes."""
    if errors is None:
        return {"error_held_out": None, "error_beyond": None}
    law_errors = errors["error"].sel(law=law).values
    beyond = errors["extrapolation"].sel(law=best).values > BEYOND
    finite = np.isfinite(law_errors)
    apart = (law_errors[finite & ~beyond], law_errors[finite & beyond])
    error_by_reach = [rms(part.tolist()) if len(part) else None for part in apart]
    return dict(zip(("error_held_out", "error_beyond"), error_by_reach, strict=True))
