"""The checks of a joint posterior: findings, sentences, and arrays stored with the draws.

A check is a function that takes a `CheckedPosterior` and returns an `Outcome`. A check that fails
with an error is omitted, and the finding on incomplete checks names it.
"""

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from time import perf_counter
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Array, Key

from jbw.errors import Attempts
from jbw.identification import accuracy
from jbw.identification.across_kinds import across_kinds, across_kinds_sentence, kinds_of
from jbw.identification.attachments import drive_sentences
from jbw.identification.causes import cause_finding, causes, causes_sentence
from jbw.identification.discrepancy import discrepancy_finding, discrepancy_sentences
from jbw.identification.equivalent import (
    Effects,
    effects,
    effects_sentence,
    hysteresis_finding,
    response_finding,
    within_response,
)
from jbw.identification.joint import (
    JointPosterior,
    JointProblem,
    draw_joint,
    every_parameter,
    fit_problem,
)
from jbw.identification.joint_answers import (
    BACKBONES,
    JOINTS,
    backbones_group,
    joints_finding,
    joints_group,
    joints_words,
)
from jbw.identification.joint_modes import joint_modes
from jbw.identification.leaving_out import (
    between_finding,
    between_records,
    consistency_finding,
    fits_without_each_run,
    leave_one_out,
    left_out_sentence,
    own_joint_sentences,
)
from jbw.identification.model_discrepancy import model_discrepancy
from jbw.identification.no_joint import (
    drag_finding,
    joint_finding,
    may_be_absent,
    may_be_drag,
    with_drag,
    without_joint,
)
from jbw.identification.prepare import Fitted
from jbw.identification.reached import threshold_sentences
from jbw.identification.run_effects import runs_dataset, runs_sentence
from jbw.identification.stated_modes import (
    one_joint_sentences,
    participation_sentences,
    same_joint_sentences,
)
from jbw.identification.step import Step, fit_sentences
from jbw.identification.widening import ending
from jbw.inference.generator import parts_of
from jbw.inference.posterior.finding import Amendment, Finding, Verdict, judge
from jbw.inference.posterior.verdict import verdict
from jbw.inference.samplers.chunked_run import Keep, no_checkpoint
from jbw.observables import dataset, noise
from jbw.observables.dataset import Dataset
from jbw.observables.drives import of_drive
from jbw.report.messages import posterior as messages
from jbw.report.messages.discrepancy import one_kind
from jbw.results.attributes import DrawnPosterior

under_way = logging.getLogger("jbw.progress")
STUCK = {"frozen_chain", "r_hat"}  # findings that show that a sampler does not suit the posterior


@dataclass(frozen=True)
class Outcome:
    """The result of one check of a posterior: its finding, sentences and arrays."""

    finding: Finding | None = None  # the finding; None if the check does not apply
    statements: Sequence[str] = ()  # sentences for the report
    # arrays that are stored with the draws
    groups: Mapping[str, xr.Dataset] = field(default_factory=dict)


@dataclass(frozen=True)
class Checks:
    """The results of all checks of a posterior."""

    findings: tuple[Finding, ...]  # findings on the chains, the fit and the posterior
    # changes of the status of findings, for example because the errors of the fit are small
    amendments: tuple[Amendment | None, ...]
    statements: tuple[str, ...]  # sentences on the fit, the sampler and the checks
    groups: Mapping[str, xr.Dataset]  # labelled arrays stored with the draws, by name
    wall_s: float

    @property
    def sees_no_joint(self) -> bool:
        """Whether the checks have found that the joint has no effect."""
        return any(row.code == "no_joint" and row.status != "ok" for row in self.findings)


@dataclass(frozen=True)
class CheckedPosterior:
    """The input of the checks: the draws and the fit of one posterior, and a random key."""

    key: Key[Array, ""]
    draws: xr.Dataset
    fitted: Fitted

    @property
    def data(self) -> Dataset:
        """The dataset that was fitted."""
        return self.fitted.data

    @cached_property
    def residuals(self) -> dict[str, np.ndarray]:
        """The residuals of the fit by data group."""
        return dataset.residual_by_label(self.fitted.fit.residual, self.data)

    @cached_property
    def error(self) -> dict[str, Any]:
        """The error of the fit in each data group, relative to the rms of the group."""
        return dataset.error_by_label(self.residuals, self.data)

    @cached_property
    def theta(self) -> Mapping[str, Any]:
        """The parameters at the optimum of the fit."""
        return dataset.as_arrays(self.fitted.fit.theta, self.data)

    @cached_property
    def without_each_run(self) -> Any:
        """The fits without each of the runs."""
        return fits_without_each_run(self.fitted.fit, self.fitted.box, self.data)


Check = Callable[[CheckedPosterior], Outcome]
FURTHER: dict[str, Check] = {}  # checks that users have registered, by subject


def register(what: str, check: Check) -> Check:
    """Register a user's check, which then runs on every joint posterior.

    Args:
        what: What it checks, such as "the stop of the bench". It is printed as progress, and where
            the check fails.
        check: The check. If it returns a finding, the entry of its code is registered by
            `jbw.report.messages.findings.register`.
    """
    FURTHER[what] = check
    return check


def check_joint(key: Key[Array, ""], posterior: JointPosterior) -> Checks:
    """Check the chains, the fit and the posterior; return findings, amendments and statements."""
    started, ready, tree = perf_counter(), posterior.fitted, posterior.tree
    checked = CheckedPosterior(key, posterior.draws, ready)
    outcomes = posterior_checks(checked)
    by_chains = verdict(
        tree, ready.box, chi_square=ready.chi_square, ending=ending(ready.box, ready.data.laws)
    )
    of_checks = [outcome.finding for outcome in outcomes if outcome.finding is not None]
    findings = (*by_chains.findings, *ready.findings, *of_checks)
    groups, attempts = groups_of(outcomes), Attempts()
    amendments = amendments_of(checked, groups, attempts)
    statements = (
        *ready.statements,
        *drawn(DrawnPosterior.of(tree)),
        *(sentence for outcome in outcomes for sentence in outcome.statements),
        *fit_sentences(ready.fit),
        *stuck(tree, findings),
        *attempts.said,
    )
    return Checks(findings, amendments, statements, groups, perf_counter() - started)


def groups_of(outcomes: Iterable[Outcome]) -> dict[str, xr.Dataset]:
    """Return the labelled arrays of several checks by name."""
    return {name: group for outcome in outcomes for name, group in outcome.groups.items()}


def amendments_of(
    checked: CheckedPosterior, groups: Mapping[str, xr.Dataset], attempts: Attempts
) -> tuple[Amendment | None, ...]:
    """Return the amendments of findings for small errors of fits and a determined joint effect."""
    of_unseen, ready, data = None, checked.fitted, checked.data
    if (left_out := groups.get("leave_one_out")) is not None:
        errors = left_out["fitted"].values.tolist(), left_out["error"].values.tolist()
        of_unseen = accuracy.within_unseen(accuracy.OF_MISFIT, *errors, messages.EACH_FROM_OTHERS)
    of_response = attempts.make(
        messages.JOINT_EFFECT,
        lambda: within_response(checked.draws, data.held, ready.y_peak, data.laws),
        None,
    )
    return accuracy.within_misfit(checked.error), of_unseen, of_response


def posterior_checks(checked: CheckedPosterior) -> list[Outcome]:
    """Run every check of a posterior; return the outcomes in the order of the report."""
    attempts = Attempts()

    def made(checks: Mapping[str, Check]) -> list[Outcome]:
        return [attempts.make(what, partial(c, checked), Outcome()) for what, c in checks.items()]

    def logged(checks: Mapping[str, Check]) -> list[Outcome]:
        outcomes = []
        for label, check in checks.items():
            under_way.info("check of %s", label)
            outcomes += made({messages.check_of(label): check})
        return outcomes

    outcomes = logged(OF_FIT)
    misses = any(x.finding is not None and x.finding.status != "ok" for x in outcomes)
    outcomes += logged(OF_DRAWS)
    if misses:
        outcomes += logged({messages.CAUSES: lack_of_fit})
    outcomes += made(OF_RUNS_AND_JOINTS)
    outcomes += made({messages.statement_on(topic): say for topic, say in STATEMENTS.items()})
    added = attempts.make(messages.JOINT_EFFECT, partial(effects_in, checked), None)
    if added is not None:
        is_one = JOINTS not in groups_of(outcomes)
        sentences = (effects_sentence(added, checked.fitted.y_peak),) if is_one else ()
        outcomes.append(Outcome(statements=sentences))
        outcomes += logged(effect_checks(added, misses=misses))
    outcomes += made({messages.THRESHOLDS: thresholds_reached})
    outcomes += logged(OF_OTHER_TESTS) + logged(FURTHER)
    return [*outcomes, Outcome(incomplete_finding(attempts.said))]


def residual_of_fit(checked: CheckedPosterior) -> Outcome:
    """Check whether the residuals of the fit are white."""
    counted, data = noise.fractions_counted(checked.data), checked.data
    return Outcome(accuracy.residual_finding(checked.residuals, counted, checked.error, data.laws))


def shape_of_fit(checked: CheckedPosterior) -> Outcome:
    """Check fit errors against the largest error allowed for the kind of data."""
    return Outcome(accuracy.shape_finding(checked.error, checked.data))


def repeats_of_tests(checked: CheckedPosterior) -> Outcome:
    """Check whether the error of the fit exceeds the variation between a test's repeats."""
    return Outcome(accuracy.repeatability_finding(checked.error, checked.data))


def solver_steps(checked: CheckedPosterior) -> Outcome:
    """Check whether the solver's time steps are fine enough."""
    sampled = checked.draws[list(checked.fitted.box.names)]
    return Outcome(accuracy.solver_finding(sampled, checked.data))


def response_bands(checked: CheckedPosterior) -> Outcome:
    """Check whether the chains agree on frequency and damping against amplitude."""
    data, y_peak = checked.data, checked.fitted.y_peak
    return Outcome(response_finding(checked.draws, data.held, y_peak, data.laws))


def lack_of_fit(checked: CheckedPosterior) -> Outcome:
    """Find likely causes of the residuals of a poor fit."""
    why = causes(checked.fitted.fit, checked.data)
    return Outcome(cause_finding(why), (causes_sentence(why),) if why else ())


def offsets_of_runs(checked: CheckedPosterior) -> Outcome:
    """Return the offsets of omega_n and zeta between runs; empty without run offsets."""
    runs = runs_dataset(checked.key, checked.draws, checked.fitted.box.names, checked.data)
    return Outcome() if runs is None else Outcome(None, (runs_sentence(runs),), {"runs": runs})


def effects_of_joints(checked: CheckedPosterior) -> Outcome:
    """Return each joint's effect on every mode, with backbones; empty for a single joint."""
    draws, data = checked.draws, checked.data
    if (modes := joint_modes(draws, data)) is None:
        return Outcome()
    joints = joints_group(draws, data, modes)
    groups = {JOINTS: joints, BACKBONES: backbones_group(data, modes)}
    return Outcome(joints_finding(joints), tuple(joints_words(joints)), groups)


def of_tests(checked: CheckedPosterior) -> Outcome:
    """Return, for every kind of test, the statements on its fit."""
    theta, parts = checked.theta, checked.data.parts
    return Outcome(
        statements=[x for part in parts for x in part.statements(of_drive(theta, part.drive))]
    )


def of_drives(checked: CheckedPosterior) -> Outcome:
    """Return the statements on drives with their own natural frequency and damping."""
    return Outcome(statements=tuple(drive_sentences(checked.theta, checked.data)))


def participation(checked: CheckedPosterior) -> Outcome:
    """Return the statements on how strongly the joint moves in each mode."""
    return Outcome(statements=tuple(participation_sentences(checked.draws, checked.data.modes)))


def one_joint(checked: CheckedPosterior) -> Outcome:
    """Return the statements on whether several modes share one joint."""
    ready = checked.fitted
    return Outcome(statements=tuple(one_joint_sentences(ready.fit, ready.box, ready.data)))


def difference_of_joints(checked: CheckedPosterior) -> Outcome:
    """Return the statements on how far the joints of uncoupled modes differ."""
    return Outcome(statements=tuple(same_joint_sentences(checked.draws, checked.data)))


def joint_of_each_mode(checked: CheckedPosterior) -> Outcome:
    """Return statements on whether a separate joint fits each mode better than a common joint."""
    sentences = own_joint_sentences(checked.key, checked.fitted.fit, checked.data)
    return Outcome(statements=tuple(sentences))


def effects_in(checked: CheckedPosterior) -> Effects | None:
    """Return the joint's effect on frequency and damping at the largest fitted motion."""
    data, y_peak = checked.data, checked.fitted.y_peak
    return effects(checked.draws, data.held, y_peak, data.laws)


def thresholds_reached(checked: CheckedPosterior) -> Outcome:
    """Return statements on whether the motion in the tests exceeded the laws' thresholds."""
    theta = every_parameter(checked.draws, checked.data)
    sentences = threshold_sentences(theta, checked.fitted.y_peak, checked.data.laws)
    return Outcome(statements=tuple(sentences))


def each_test_left_out(checked: CheckedPosterior) -> Outcome:
    """Check how well each run is predicted by a fit to all other runs."""
    ready = checked.fitted
    left_out = leave_one_out(ready.fit, ready.box, ready.data, checked.without_each_run)
    if left_out is None:
        return Outcome()
    finding = consistency_finding(left_out, ready.data.laws)
    return Outcome(finding, (left_out_sentence(left_out),), {"leave_one_out": left_out})


def left_beyond_noise(checked: CheckedPosterior) -> Outcome:
    """Return the model discrepancy: the part of the residual that exceeds the noise."""
    ready = checked.fitted
    missed = model_discrepancy(ready.fit, ready.box, ready.data, checked.without_each_run)
    finding = discrepancy_finding(missed, ready.data.laws)
    return Outcome(finding, tuple(discrepancy_sentences(missed)), {"discrepancy": missed})


def each_kind_left_out(checked: CheckedPosterior) -> Outcome:
    """Check how well each kind of test is predicted by a fit to the other kinds."""
    ready = checked.fitted
    if (predicted := across_kinds(ready.fit, ready.box, ready.data)) is None:
        return Outcome(statements=tuple(map(one_kind, kinds_of(ready.data))))
    return Outcome(None, (across_kinds_sentence(predicted),), {"across_kinds": predicted})


def each_record_alone(checked: CheckedPosterior) -> Outcome:
    """Check whether fits to each single record agree with each other."""
    ready = checked.fitted
    if (between := between_records(ready.fit, ready.box, ready.data)) is None:
        return Outcome()
    return Outcome(between_finding(between), groups={"between_records": between})


OF_FIT: dict[str, Check] = {
    messages.RESIDUAL: residual_of_fit,
    messages.SHAPE: shape_of_fit,
    messages.REPEATS: repeats_of_tests,
}
OF_DRAWS: dict[str, Check] = {
    messages.SOLVER_STEPS: solver_steps,
    messages.RESPONSE_BANDS: response_bands,
}
OF_RUNS_AND_JOINTS: dict[str, Check] = {
    messages.OFFSETS: offsets_of_runs,
    messages.JOINT_SHARES: effects_of_joints,
}
STATEMENTS: dict[str, Check] = {
    "the tests": of_tests,
    "the drives": of_drives,
    messages.PARTICIPATION: participation,
    messages.ONE_JOINT: one_joint,
    messages.JOINT_DIFFERENCE: difference_of_joints,
    messages.JOINT_OF_MODES: joint_of_each_mode,
}
OF_OTHER_TESTS: dict[str, Check] = {
    messages.WITHOUT_EACH_TEST: each_test_left_out,
    messages.DISCREPANCY: left_beyond_noise,
    messages.WITHOUT_EACH_KIND: each_kind_left_out,
    messages.EACH_RECORD: each_record_alone,
}


def effect_checks(added: Effects, *, misses: bool) -> dict[str, Check]:
    """Return the checks whether hysteresis or only drag acts, and whether a joint acts at all."""

    def hysteresis(checked: CheckedPosterior) -> Outcome:
        return Outcome(seen_hysteresis(added, checked.fitted, misses=misses))

    def joint(checked: CheckedPosterior) -> Outcome:
        ready = checked.fitted
        without = without_joint(ready.fit, ready.box, ready.data)
        return Outcome(joint_finding(without, added, ready.y_peak))

    checks: dict[str, Check] = {messages.HYSTERESIS: hysteresis}
    return checks | ({messages.JOINT_SEEN: joint} if may_be_absent(added) else {})


def seen_hysteresis(added: Effects, ready: Fitted, *, misses: bool) -> Finding | None:
    """Return the finding that hysteresis is absent or fits no better than drag, or else None."""
    finding = hysteresis_finding(added, ready.y_peak, ready.data.laws, misses=misses)
    return finding or seen_drag(added, ready, misses=misses)


def seen_drag(added: Effects, ready: Fitted, *, misses: bool) -> Finding | None:
    """Return the finding on whether drag fits as well as hysteresis; None if no test is needed."""
    best, data, y_peak = ready.fit, ready.data, ready.y_peak
    zeta = {**data.held, **best.theta}["zeta"]
    if data.modes is not None or not may_be_drag(added, zeta, data.laws):
        return None
    damping = float(zeta * np.median(added.damping))
    drag = with_drag(best, ready.box, data, damping, y_peak)
    return drag_finding(drag, added, y_peak, misses=misses)


def incomplete_finding(said: Sequence[str]) -> Finding | None:
    """Return the finding on checks that could not be performed; None if all were performed."""
    if not said:
        return None
    return Finding("incomplete_checks", "not assessed", {"sentences": said}, float(len(said)))


def drawn(facts: DrawnPosterior) -> list[str]:
    """Return sentences on the sampling: sampler, coordinates, number of evaluations, evidence."""
    if not facts.coordinates:
        return []
    sentences = [messages.sampler(facts.sampler, facts.num_evaluations, facts.coordinates)]
    if facts.log_evidence is not None and facts.log_evidence_error is not None:
        sentences += [messages.evidence(facts.log_evidence, facts.log_evidence_error)]
    return [" ".join(sentences)]


def stuck(posterior: xr.DataTree, findings: Iterable[Finding]) -> list[str]:
    """Return advice if elliptical slice sampling has not converged, or else an empty text."""
    failed = {finding.code for finding in findings if finding.status != "ok"}
    if DrawnPosterior.of(posterior).sampler != "elliptical_slice" or not failed & STUCK:
        return []
    return [messages.TOO_CURVED]


def joint_step(
    key: Key[Array, ""], problem: JointProblem, *, name: str = "joint", keep: Keep = no_checkpoint
) -> tuple[Step, Dataset]:
    """Draw and check a joint posterior; return the result with the dataset that was fitted.

    The returned dataset has the offsets of the runs, and the effective numbers of values and solver
    steps that the fit determined.
    """
    keys = parts_of(key, 5)
    ready = fit_problem(keys[:2], problem)
    posterior = draw_joint(keys[2:4], problem, ready, keep=keep, name=name)
    checks = check_joint(keys[4], posterior)
    judged = judge(checks.findings, checks.amendments)
    return step_of(posterior, checks, judged, checks.statements), posterior.fitted.data


def step_of(
    posterior: JointPosterior, checks: Checks, judged: Verdict, statements: Sequence[str]
) -> Step:
    """Return a joint posterior with its verdict and statements, in the form of a result."""
    groups = {name: xr.DataTree(group) for name, group in checks.groups.items()}
    fitted = posterior.fitted
    return Step(
        posterior.name, posterior.tree.assign(groups), judged, fitted.fit, fitted.box,
        tuple(statements), posterior.held, posterior.wall_s + checks.wall_s,
    )  # fmt: skip
