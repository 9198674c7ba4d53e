"""The result of an identification: its posteriors, and the fitted tests.

The module also provides a single posterior before sampling: density, prior, data, fit.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
from jaxtyping import Array, Key, PyTree

from jbw.errors import ConfigError, DataError
from jbw.identification.assemble import Measured, Report
from jbw.identification.checks import Checks, step_of
from jbw.identification.free_decays import FreeDecays
from jbw.identification.joint import JointPosterior
from jbw.identification.linear import PooledFit
from jbw.identification.linear_step import LinearStep
from jbw.identification.paper import kernel, step3, step4
from jbw.identification.paper_route import PaperRoute
from jbw.identification.prepare import Fitted, fit_joint, refit
from jbw.identification.selection import DecaySplit, Sweeps
from jbw.identification.step import Step, means_of
from jbw.inference.fit.fitting import Fit
from jbw.inference.posterior.finding import Verdict
from jbw.inference.space.box import Box
from jbw.inference.space.problem import LogLikelihood
from jbw.observables.dataset import Dataset, log_likelihood
from jbw.observables.decay import Decays
from jbw.observables.records import Records
from jbw.quantities import DEFAULT_LAWS
from jbw.report.messages import stages

logger = logging.getLogger("jbw")
STEPS = ("joint", "third_order", "opening")


@dataclass(frozen=True)
class Posteriors:
    """The drawn and checked posteriors of a campaign, before they are judged."""

    joint: JointPosterior
    checks: Checks  # checks of the joint posterior
    free: FreeDecays = field(default_factory=FreeDecays)
    paper: PaperRoute = field(default_factory=PaperRoute)


@dataclass(frozen=True)
class Identification:
    """The complete result of the procedure for a campaign."""

    linear: LinearStep | None = None  # line fit of a noise test (Step 2); None without such a test
    kernel: step3.KernelFit | None = None  # fit of the kernel; None without probing tones
    sweeps: Sweeps | None = None
    data: Dataset | None = None  # dataset of the joint posterior, as sampled
    decays: DecaySplit | None = None
    decay_data: Decays | None = None  # envelopes of free decays, with noise from the fit
    steps: dict[str, Step] = field(default_factory=dict)  # posteriors; the main one is "joint"

    @property
    def main(self) -> Step:
        """The posterior that the verdict judges: the joint posterior if it exists."""
        return self.steps.get("joint") or self.steps["third_order_nuts"]

    @property
    def fitted(self) -> Fitted | None:
        """The fit from which the main posterior started; None without a joint posterior."""
        return None if self.data is None else Fitted(self.main.fit, self.main.box, self.data)

    @property
    def decay(self) -> Step | None:
        """The posterior of free decays; the joint posterior if no separate one was drawn."""
        if self.decays is None:
            return None
        return self.steps.get("decay") or self.main


def identified(
    seen: Measured, posteriors: Posteriors, judged: Verdict, statements: Sequence[str]
) -> Identification:
    """Combine all posteriors of a campaign with the joint posterior's verdict and statements."""
    free, paper, joint = posteriors.free, posteriors.paper, posteriors.joint
    main = step_of(joint, posteriors.checks, judged, statements)
    beside = {} if free.step is None else {free.step.name: free.step}
    return Identification(
        linear=seen.linear,
        kernel=paper.kernel,
        sweeps=seen.sweeps,
        data=joint.fitted.data,
        decays=seen.decays,
        decay_data=free.data,
        steps={**paper.steps, main.name: main, **beside},
    )


@dataclass(frozen=True)
class Posterior:
    """A posterior of the procedure, ready for sampling."""

    name: str  # "joint", "third_order" or "opening"
    # log likelihood: function of (theta, data) that returns its terms [nats]
    log_likelihood: LogLikelihood
    box: Box  # prior bounds
    data: PyTree  # argument of the likelihood
    fit: Fit  # least-squares fit within the bounds
    stepped: bool  # whether an evaluation integrates in time, which is slow
    laws: tuple[str, ...] = DEFAULT_LAWS


@dataclass(frozen=True)
class Known:
    """The prior bounds and means of a finished run; empty if it states none."""

    # prior bounds of the joint posterior
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    # means of zeta, alpha and delta from the kernel fit (Step 3)
    means: Mapping[str, float] = field(default_factory=dict)


def posterior_of(
    step: str,
    seen: Measured,
    *,
    seed: int = 0,
    known: Known | None = None,
    report: Report = logger.info,
) -> Posterior:
    """Perform the procedure up to the fit of one step; return its posterior, not yet sampled.

    `step` is "joint", "third_order" or "opening". `known` contains the prior and the means of Step
    3 of a finished run.

    Raises:
        ConfigError: The step is unknown.
        DataError: The tests do not allow the step.
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
            remedy='Add sweeps, or compare laws on step "third_order" or "joint".',
        )
    keys, means = jax.random.split(key, 3), run_knowledge.means
    if not means:
        report(stages.STEP_3_MEANS)
        third_order = step3.fit_kernel(keys[0], seen.probing, linear, seen.settings)
        request = step3.SAMPLERS["third_order_nuts"]._replace(chain_method="vectorized")
        means = means_of(step3.draw(keys[1], third_order, request))
    report(stages.STEP_4)
    records = Records.of(seen.sweeps.fitted, substeps=seen.settings.substeps)
    curve, best, prior, _ = step4.fit_opening(keys[2], records, linear, means, seen.settings)
    return Posterior("opening", step4.log_likelihood, prior, curve, best, stepped=False)


def _joint(key: Key[Array, ""], seen: Measured, run_knowledge: Known, report: Report) -> Posterior:
    """Return the joint posterior, with the prior of a finished run if it is known.

    The run's prior may differ from the campaign's.
    """
    ready = fit_joint(key, seen, report)
    prior, best, data = ready.box, ready.fit, ready.data
    if run_knowledge.bounds:
        if set(run_knowledge.bounds) != set(prior.names):
            raise ConfigError(
                f"The run sampled the parameters {', '.join(run_knowledge.bounds)}, but the "
                f"campaign has the parameters {', '.join(prior.names)}.",
                why="This is not the run's campaign file, or the file was changed after the run.",
                remedy="Give the run's campaign file with --campaign, or a campaign file in place "
                "of the run.",
            )
        lower, upper = zip(*(run_knowledge.bounds[name] for name in prior.names), strict=True)
        prior = Box(prior.names, jnp.asarray(lower), jnp.asarray(upper))
        best = refit(best, prior, data)
    return Posterior("joint", log_likelihood, prior, data, best, data.stepped, data.laws)
