"""The posteriors of the procedure before anything is drawn: density, prior, data, fit."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
from jaxtyping import Array, Key, PyTree

from jbw.errors import ConfigError, DataError
from jbw.identification.assemble import Measured, Report
from jbw.identification.linear import PooledFit
from jbw.identification.paper import kernel, step3, step4
from jbw.identification.prepare import fit_joint, refit
from jbw.identification.step import means_of
from jbw.inference.fit.fitting import Fit
from jbw.inference.space.box import Box
from jbw.inference.space.problem import LogLikelihood
from jbw.observables.dataset import log_likelihood
from jbw.observables.records import Records
from jbw.quantities import DEFAULT_LAWS

logger = logging.getLogger("jbw")
STEPS = ("joint", "third_order", "opening")


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
    report(f"Step 3: third-order kernel at {len(seen.probing)} frequencies")
    found = step3.fit_kernel(key, seen.probing, linear.pooled, seen.settings)
    best = step3.as_noise(found.fit)
    return Posterior(step, kernel.log_likelihood, found.box, found.data, best, stepped=False)


def _opening(
    key: Key[Array, ""], seen: Measured, linear: PooledFit, known: Known, report: Report
) -> Posterior:
    if seen.sweeps is None:
        raise DataError(
            "Step `opening` needs sweeps, which the campaign lacks.",
            remedy='Compare on step "third_order" or "joint".',
        )
    keys, means = jax.random.split(key, 3), known.means
    if not means:
        report("Step 3: means of zeta, alpha and delta, by NUTS")
        found = step3.fit_kernel(keys[0], seen.probing, linear, seen.settings)
        options = step3.SAMPLERS["third_order_nuts"]
        means = means_of(step3.draw(keys[1], found, chain_method="vectorized", **options))
    report("Step 4: gamma alone, the earlier steps held")
    records = Records.of(seen.sweeps.fitted, substeps=seen.settings.substeps)
    start = step4.fit_opening(keys[2], records, linear, means, seen.settings)
    return Posterior(
        "opening", step4.log_likelihood, start.box, start.curve, start.fit, stepped=False
    )


def _joint(key: Key[Array, ""], seen: Measured, known: Known, report: Report) -> Posterior:
    """The joint posterior, in the prior of the run where that is known: it may lie elsewhere."""
    ready = fit_joint(key, seen, report)
    prior, best, data = ready.box, ready.fit, ready.data
    if known.bounds:
        if set(known.bounds) != set(prior.names):
            raise ConfigError(
                f"The run sampled {', '.join(known.bounds)}, but the campaign leads to "
                f"{', '.join(prior.names)}.",
                why="The campaign is not the run's, or was changed since.",
                remedy="Give the run's campaign with --campaign, or compare on the campaign alone.",
            )
        lower, upper = zip(*(known.bounds[name] for name in prior.names), strict=True)
        prior = Box(prior.names, jnp.asarray(lower), jnp.asarray(upper))
        best = refit(best, prior, data)
    return Posterior("joint", log_likelihood, prior, data, best, data.stepped, data.laws)
