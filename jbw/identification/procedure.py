"""The procedure of the paper on one campaign: Steps 2, 3 and 4, and the joint posterior.

All of it, or as far as one posterior before anything is drawn: density, prior, data, fit.
"""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Key, PyTree

from jbw.errors import Attempts, ConfigError, DataError
from jbw.identification.assemble import Measured, Report, assemble
from jbw.identification.joint import joint_step
from jbw.identification.linear import PooledFit
from jbw.identification.linear_step import LinearStep
from jbw.identification.one_mode_readings import joint_readings
from jbw.identification.paper import kernel, step3, step4
from jbw.identification.prepare import Fitted, fit_joint, refit
from jbw.identification.selection import DecaySplit, Sweeps
from jbw.identification.step import Step, means_of
from jbw.inference.fit.fitting import Fit
from jbw.inference.generator import parts_of
from jbw.inference.posterior.finding import Finding, judge
from jbw.inference.samplers.chunked_run import Keep, no_checkpoint
from jbw.inference.space.box import Box
from jbw.inference.space.problem import LogLikelihood
from jbw.measurement.records import drive_of
from jbw.observables.dataset import Dataset, log_likelihood
from jbw.observables.decay import Decays
from jbw.observables.forms import by_form
from jbw.observables.records import Records
from jbw.quantities import DEFAULT_LAWS
from jbw.report.messages import paper_steps as messages
from jbw.report.messages import stages

logger = logging.getLogger("jbw")
STEPS = ("joint", "third_order", "opening")
PAPER_LAW = "bouc_wen"  # of Steps 3 and 4
READINGS_KEY = 200  # of the seed: of single modes, where there are several joints
DECAY_KEY = 100  # of the seed: the paper's steps draw the same with decays and without


@dataclass(frozen=True)
class Identification:
    """Everything that the procedure found on a campaign."""

    linear: LinearStep | None = None  # Step 2, when there was a noise test
    kernel: step3.KernelFit | None = None  # when there were probing tones
    sweeps: Sweeps | None = None
    data: Dataset | None = None  # what the joint posterior was made from, as it was sampled
    decays: DecaySplit | None = None
    decay_data: Decays | None = None  # their envelopes, with the noise that the fit found
    steps: dict[str, Step] = field(default_factory=dict)  # posteriors; the main one is "joint"

    @property
    def main(self) -> Step:
        """The posterior that the verdict is about: the joint one where there is one."""
        return self.steps.get("joint") or self.steps["third_order_nuts"]

    @property
    def fitted(self) -> Fitted | None:
        """The fit that the main posterior started from; None without a joint posterior."""
        return None if self.data is None else Fitted(self.main.fit, self.main.box, self.data)

    @property
    def decay(self) -> Step | None:
        """The posterior from free decays: the joint one where there is nothing else."""
        if self.decays is None:
            return None
        return self.steps.get("decay") or self.main


def run_procedure(
    seen: Measured,
    *,
    seed: int = 0,
    report: Report = logger.info,
    keep: Keep = no_checkpoint,
    at_fit: Callable[[Fitted], None] = lambda ready: None,
) -> Identification:
    """Run every step that the tests of a campaign allow.

    Free decays are part of the joint posterior; beside other tests they have one of their own too,
    to compare with. `report` is called with one sentence at every stage; `keep` says where the
    chains of each posterior outlive the process. `at_fit` is called with the fit of the joint
    posterior before anything is drawn from it.

    Raises:
        DataError: If there is nothing that the joint can be fitted to.
    """
    keys = iter(parts_of(jax.random.key(seed), 16))
    identification = Identification(linear=seen.linear, sweeps=seen.sweeps, decays=seen.decays)
    words = paper_words(seen)
    if words:
        report(words[0])
    if seen.linear is not None and seen.probing and PAPER_LAW in seen.laws:
        try:
            kernel_fit, steps = _paper_steps(seen, seen.linear.pooled, keys, report, keep)
        except DataError as error:
            if seen.settings.strict:
                raise
            report(messages.left_out(" ".join(str(error).split())))
        else:
            identification = replace(identification, kernel=kernel_fit, steps=_told(words, steps))
    data = assemble(seen)
    report(stages.joint_posterior(len(data.labels)))
    readings = joint_readings(jax.random.fold_in(jax.random.key(seed), READINGS_KEY), seen)
    step, data = joint_step(
        next(keys),
        data,
        identification.steps,
        seen.settings,
        keep=keep,
        at_fit=at_fit,
        readings=readings,
    )
    identification = replace(
        identification, data=data, steps=identification.steps | _told(words, {"joint": step})
    )
    if seen.decays is None:
        return identification
    unseen = any(
        finding.code == "no_joint" and finding.status != "ok" for finding in step.verdict.findings
    )
    if not unseen and not all(test.traits.is_free for test in seen.tests):
        report(stages.FREE_DECAYS)
        key = jax.random.fold_in(jax.random.key(seed), DECAY_KEY)
        free = replace(seen, chosen=tuple(test for test in seen.chosen if test.traits.is_free))
        attempts = Attempts(report)
        free_posterior = attempts.make(
            stages.FREE_POSTERIOR,
            lambda: joint_step(key, assemble(free), {}, seen.settings, name="decay", keep=keep),
            None,
        )
        if free_posterior is None:
            identification = replace(
                identification, steps=_compared_with_nothing(identification.steps, attempts.said)
            )
        else:
            step, data = free_posterior
            identification = replace(identification, steps={**identification.steps, "decay": step})
    return replace(identification, decay_data=decays_in(data))


def decays_in(data: Dataset) -> Decays | None:
    """The envelopes of free decays among what was fitted."""
    return next((part for part in data.parts if isinstance(part, Decays)), None)


def _compared_with_nothing(steps: Mapping[str, Step], sentences: Sequence[str]) -> dict[str, Step]:
    """Steps whose joint posterior says that there is no second one to compare it with."""
    joint, reason = steps["joint"], " ".join(sentences)
    missing = Finding("second_posterior", "usable", {"reason": reason}, float("nan"))
    return {**steps, "joint": replace(joint, verdict=judge([*joint.verdict.findings, missing]))}


def _told(words: tuple[str, ...], steps: Mapping[str, Step]) -> dict[str, Step]:
    """Steps that begin with some words."""
    return {
        name: replace(step, statements=(*words, *step.statements)) for name, step in steps.items()
    }


def paper_words(seen: Measured) -> tuple[str, ...]:
    """What the paper's Steps 3 and 4 are to the laws of this joint; nothing where they suit."""
    if seen.linear is None or not seen.probing:
        return ()
    others = " and ".join(name for name in seen.laws if name != PAPER_LAW)
    if PAPER_LAW not in seen.laws:
        return (messages.other_law(others or "none"),)
    if not others:
        return ()
    return (messages.further_laws(others),)


def _paper_steps(
    seen: Measured, linear: PooledFit, keys: Iterator[Key[Array, ""]], report: Report, keep: Keep
) -> tuple[step3.KernelFit, dict[str, Step]]:
    """Steps 3 and 4 by the paper's cut, as far as the tests allow them."""
    report(stages.kernel(len(seen.probing)))
    kernel_fit = step3.fit_kernel(next(keys), seen.probing, linear, seen.settings)
    steps = step3.third_order_steps(next(keys), kernel_fit, seen.settings, keep=keep)
    drive = drive_of(seen.linear.test) if seen.linear is not None else ""
    if swept := by_form([test for test in seen.swept if drive_of(test) == drive]):
        # One record form, the one with the most levels: the curve of gamma is of one solve.
        report(stages.STEP_4)
        records = Records.of(max(swept, key=len), substeps=seen.settings.substeps)
        held = steps["third_order_nuts"]
        steps |= step4.opening_steps(next(keys), records, linear, held, seen.settings, keep=keep)
    return kernel_fit, steps


@dataclass(frozen=True)
class Posterior:
    """A posterior of the procedure, to be drawn from."""

    name: str  # "joint", "third_order" or "opening"
    log_likelihood: LogLikelihood  # (theta, data) to terms [nats]
    box: Box  # its prior
    data: PyTree  # what the likelihood takes
    fit: Fit  # least squares in the box
    stepped: bool  # whether an evaluation steps through time, and costs accordingly
    laws: tuple[str, ...] = DEFAULT_LAWS


@dataclass(frozen=True)
class Known:
    """What a finished run knows of a posterior; empty where it does not."""

    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # the joint's prior
    means: Mapping[str, float] = field(default_factory=dict)  # Step 3's: zeta, alpha and delta


def posterior_of(
    step: str,
    seen: Measured,
    *,
    seed: int = 0,
    known: Known | None = None,
    report: Report = logger.info,
) -> Posterior:
    """Do the procedure as far as the fit of one step, and stop before its draws.

    `step` is "joint", "third_order" or "opening", `known` what a finished run says of its prior
    and of Step 3.

    Raises:
        ConfigError: An unknown step.
        DataError: Tests that do not allow the step.
    """
    if step not in STEPS:
        raise ConfigError(f"Argument `step` must be one of {', '.join(STEPS)}, not {step!r}.")
    key, known, linear = jax.random.key(seed), known or Known(), seen.linear
    if step == "joint":
        return _joint(key, seen, known, report)
    if linear is None or not seen.probing:
        raise DataError(
            f"Step `{step}` needs a noise test and probing tones, which the campaign lacks.",
            remedy='Compare on step "joint".',
        )
    if step == "opening":
        return _opening(key, seen, linear.pooled, known, report)
    report(stages.kernel(len(seen.probing)))
    third_order = step3.fit_kernel(key, seen.probing, linear.pooled, seen.settings)
    best = step3.as_noise(third_order.fit)
    return Posterior(
        step, kernel.log_likelihood, third_order.box, third_order.data, best, stepped=False
    )


def _opening(
    key: Key[Array, ""], seen: Measured, linear: PooledFit, run_knowledge: Known, report: Report
) -> Posterior:
    if seen.sweeps is None:
        raise DataError(
            "Step `opening` needs sweeps, which the campaign lacks.",
            remedy='Compare on step "third_order" or "joint".',
        )
    keys, means = jax.random.split(key, 3), run_knowledge.means
    if not means:
        report(stages.STEP_3_MEANS)
        third_order = step3.fit_kernel(keys[0], seen.probing, linear, seen.settings)
        options = step3.SAMPLERS["third_order_nuts"]
        means = means_of(step3.draw(keys[1], third_order, chain_method="vectorized", **options))
    report(stages.STEP_4)
    records = Records.of(seen.sweeps.fitted, substeps=seen.settings.substeps)
    start = step4.fit_opening(keys[2], records, linear, means, seen.settings)
    return Posterior(
        "opening", step4.log_likelihood, start.box, start.curve, start.fit, stepped=False
    )


def _joint(key: Key[Array, ""], seen: Measured, run_knowledge: Known, report: Report) -> Posterior:
    """The joint posterior, in the prior of the run where that is known: it may lie elsewhere."""
    ready = fit_joint(key, seen, report)
    prior, best, data = ready.box, ready.fit, ready.data
    if run_knowledge.bounds:
        if set(run_knowledge.bounds) != set(prior.names):
            raise ConfigError(
                f"The run sampled {', '.join(run_knowledge.bounds)}, but the campaign leads to "
                f"{', '.join(prior.names)}.",
                why="The campaign is not the run's, or was changed since.",
                remedy="Give the run's campaign with --campaign, or compare on the campaign alone.",
            )
        lower, upper = zip(*(run_knowledge.bounds[name] for name in prior.names), strict=True)
        prior = Box(prior.names, jnp.asarray(lower), jnp.asarray(upper))
        best = refit(best, prior, data)
    return Posterior("joint", log_likelihood, prior, data, best, data.stepped, data.laws)
