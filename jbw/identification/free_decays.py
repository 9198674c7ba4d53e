"""Free decays beside other tests: a posterior of their own, to compare with that of all tests."""

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

DECAY_KEY = 100  # of the seed: the paper's steps draw the same with decays and without


@dataclass(frozen=True)
class FreeDecays:
    """The free decays of a campaign, after its joint posterior."""

    data: Decays | None = None  # their envelopes, with the noise that the fit found
    step: Step | None = None  # their own posterior; None where the joint one is all that they have
    findings: tuple[Finding, ...] = ()  # that there is no second posterior to compare with


def free_decays(
    seen: Measured,
    joint: JointPosterior,
    checks: Checks,
    *,
    seed: int,
    report: Report,
    keep: Keep,
) -> FreeDecays:
    """Draw the posterior of free decays alone, in addition to the posterior of all tests.

    One that cannot be made costs the joint posterior nothing: a finding says so. Where decays alone
    show no joint, their posterior is kept, and what is predicted of them is the joint posterior's.
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
    """Return the envelopes of free decays among what was fitted; None without any."""
    return next((part for part in data.parts if part.own_shifts), None)
