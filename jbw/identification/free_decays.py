"""A separate posterior from free decays alone, to compare with that of all tests."""

from dataclasses import dataclass, replace
from typing import Any

import jax

from jbw.errors import Attempts
from jbw.identification.assemble import Measured, Report, assemble
from jbw.identification.checks import Checks, joint_step
from jbw.identification.joint import JointPosterior, JointProblem
from jbw.identification.step import Step
from jbw.inference.posterior.finding import Finding
from jbw.inference.samplers.chunked_run import Keep
from jbw.observables.dataset import Dataset
from jbw.observables.decay import Decays
from jbw.report.messages import stages

DECAY_KEY = 100  # number from which the random key of this posterior is derived


@dataclass(frozen=True)
class FreeDecays:
    """The result of the fit to free decays alone: envelopes, posterior, findings."""

    data: Decays | None = None  # the envelopes, with the noise estimated in the fit
    step: Step | None = None  # the separate posterior; None if it was not drawn
    findings: tuple[Finding, ...] = ()  # findings that explain why a separate posterior is missing


def free_decays(
    seen: Measured,
    joint: JointPosterior,
    checks: Checks,
    *,
    seed: int,
    report: Report,
    keep: Keep,
) -> FreeDecays:
    """Draw a posterior from the free decays alone, in addition to that from all tests.

    If it cannot be drawn, a finding says so and the joint posterior remains valid. If decays alone
    show no joint, their posterior is kept, but predictions of decays use the joint posterior.
    """
    if seen.decays is None:
        return FreeDecays()
    in_joint = decays_in(joint.fitted.data)
    if checks.sees_no_joint or all(test.traits.is_free for test in seen.tests):
        return FreeDecays(in_joint)
    report(stages.FREE_DECAYS)
    key = jax.random.fold_in(jax.random.key(seed), DECAY_KEY)
    free = replace(seen, chosen=tuple(test for test in seen.chosen if test.traits.is_free))
    attempts = Attempts(report)

    def of_decays() -> tuple[Step, Dataset]:
        problem = JointProblem(assemble(free), seen.settings, tests=seen.tests)
        return joint_step(key, problem, name="decay", keep=keep)

    made = attempts.make(stages.FREE_POSTERIOR, of_decays, None)
    if made is None:
        reason = {"reason": " ".join(attempts.said)}
        missing = Finding("second_posterior", "usable", reason, float("nan"))
        return FreeDecays(in_joint, findings=(missing,))
    step, data = made
    return FreeDecays(decays_in(data) if data.laws else in_joint, step)


def decays_in(data: Dataset) -> Any:
    """Return the envelopes of free decays in a fitted dataset, or None."""
    return next((part for part in data.parts if part.own_shifts), None)
