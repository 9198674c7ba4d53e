"""The posteriors of the procedure before anything is drawn: density, prior, data, fit."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Key, PyTree

from jbw.errors import ConfigError, DataError
from jbw.identification import cut, third_order
from jbw.identification.coordinates import box_of
from jbw.identification.drawing import steps_through_time
from jbw.identification.fitted import fit_joint
from jbw.identification.gathering import gather
from jbw.identification.linear_step import LinearStep, linear_step
from jbw.identification.procedure import Report
from jbw.identification.selection import decay_tests, linear_test, probing_tests, sweep_tests
from jbw.identification.settling import again, settled
from jbw.identification.starts import fit_from, linear_look
from jbw.inference.box import Box
from jbw.inference.fitting import Fit
from jbw.inference.model import LogLikelihood
from jbw.inference.ridge import sample_along
from jbw.measurement.records import Test
from jbw.observables import decay_likelihood, evidence, kernel, opening, response
from jbw.observables.evidence import Evidence, labels

logger = logging.getLogger("jbw")
STEPS = ("joint", "third_order", "opening")


@dataclass(frozen=True)
class Posterior:
    """A posterior of the procedure, to be drawn from.

    Attributes:
        name: "joint", "third_order" or "opening".
        log_likelihood: (theta, data) to terms [nats].
        box: Its prior.
        data: What the likelihood takes.
        fit: Least squares in the box.
        stepped: Whether an evaluation steps through time, and costs accordingly.
    """

    name: str
    log_likelihood: LogLikelihood
    box: Box
    data: PyTree
    fit: Fit
    stepped: bool


@dataclass(frozen=True)
class Known:
    """What a finished run knows of a posterior.

    Attributes:
        bounds: Prior of the joint posterior by name; empty where it is not known.
        means: Step 3's means of zeta, alpha and delta; empty where they are not known.
    """

    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    means: Mapping[str, float] = field(default_factory=dict)


def posterior_of(
    step: str,
    tests: Sequence[Test],
    settings: Mapping[str, Any],
    *,
    gain: float | None = None,
    seed: int = 0,
    known: Known | None = None,
    report: Report = logger.info,
) -> Posterior:
    """Do the procedure as far as the fit of one step, and stop before its draws.

    Args:
        step: "joint", "third_order" or "opening".
        tests: The campaign's tests.
        settings: Its [identify] table.
        gain: Gain that the campaign states [N/kg per unit of the input].
        seed: Of the starts.
        known: What a finished run says of its prior and of Step 3.
        report: Called with one sentence at every stage.

    Raises:
        ConfigError: An unknown step.
        DataError: Tests that do not allow the step.
    """
    if step not in STEPS:
        raise ConfigError(f"Argument `step` must be one of {', '.join(STEPS)}, not {step!r}.")
    key, known = jax.random.key(seed), known or Known()
    noise = linear_test(tests)
    linear = None
    if noise is not None:
        report(f"Step 2: line fit of {noise.name}")
        linear = linear_step(noise, gain)
    if step == "joint":
        return _joint(key, tests, settings, linear, gain, seed, known, report)
    probing = [] if linear is None else probing_tests(tests, linear.natural_hz)
    if linear is None or not probing:
        raise DataError(
            f"Step `{step}` needs a noise test and probing tones, which the campaign lacks.",
            remedy='Compare on step "joint".',
        )
    if step == "opening":
        return _opening(key, tests, settings, linear, probing, known, report)
    report(f"Step 3: third-order kernel at {len(probing)} frequencies")
    found = third_order.fit_kernel(key, probing, linear.pooled, settings)
    best = third_order.as_noise(found.fit)
    return Posterior(step, kernel.log_likelihood, found.box, found.data, best, stepped=False)


def _opening(
    key: Key[Array, ""],
    tests: Sequence[Test],
    settings: Mapping[str, Any],
    linear: LinearStep,
    probing: Sequence[Test],
    known: Known,
    report: Report,
) -> Posterior:
    sweeps = sweep_tests(tests, settings)
    if sweeps is None:
        raise DataError(
            "Step `opening` needs sweeps, which the campaign lacks.",
            remedy='Compare on step "third_order" or "joint".',
        )
    keys, means = jax.random.split(key, 3), dict(known.means)
    if not means:
        report("Step 3: means of zeta, alpha and delta, by NUTS")
        found = third_order.fit_kernel(keys[0], probing, linear.pooled, settings)
        tree = sample_along(
            keys[1], kernel.log_likelihood, found.box, found.data, third_order.as_noise(found.fit),
            num_warmup=500, num_samples=500, chain_method="vectorized",
        )  # fmt: skip
        means = {str(n): float(v.mean()) for n, v in tree["posterior"].data_vars.items()}
    report("Step 4: gamma alone, the earlier steps held")
    records = response.reduce(sweeps.fitted, substeps=settings.get("substeps", 2))
    start = cut.fit_opening(keys[2], records, linear.pooled, means, settings)
    return Posterior(
        "opening", opening.log_likelihood, start.box, start.curve, start.fit, stepped=False
    )


def _joint(
    key: Key[Array, ""],
    tests: Sequence[Test],
    settings: Mapping[str, Any],
    linear: LinearStep | None,
    gain: float | None,
    seed: int,
    known: Known,
    report: Report,
) -> Posterior:
    decays = decay_tests(tests, settings)
    if decays is not None and all(test.kind == "decay" for test in tests):
        found = fit_joint(tests, settings, gain=gain, seed=seed, report=report)
        log_likelihood = decay_likelihood.log_likelihood
        return Posterior("joint", log_likelihood, found.box, found.data, found.fit, stepped=False)
    sweeps = sweep_tests(tests, settings)
    data = gather(tests, settings, linear=linear, sweeps=sweeps, decays=decays, gain=gain)
    report(f"Least squares: all parameters from {len(labels(data))} groups of data")
    keys, look = jax.random.split(key), linear_look(data)
    prior = box_of(settings, data, look)
    first = fit_from(keys[0], data, prior, look)
    prior, best, data, _ = settled(keys[1], data, prior, first, settings)
    prior, best = _as_known(prior, best, data, known)
    return Posterior(
        "joint", evidence.log_likelihood, prior, data, best, stepped=steps_through_time(data)
    )


def _as_known(prior: Box, best: Fit, data: Evidence, known: Known) -> tuple[Box, Fit]:
    """The prior of the run, which may have started elsewhere, and the fit in it."""
    if not known.bounds:
        return prior, best
    if set(known.bounds) != set(prior.names):
        raise ConfigError(
            f"The run sampled {', '.join(known.bounds)}, but the campaign leads to "
            f"{', '.join(prior.names)}.",
            why="The campaign is not the run's, or was changed since.",
            remedy="Give the run's campaign with --campaign, or compare on the campaign alone.",
        )
    lower, upper = zip(*(known.bounds[name] for name in prior.names), strict=True)
    prior = Box(prior.names, jnp.asarray(lower), jnp.asarray(upper))
    return prior, again(best, prior, data)
