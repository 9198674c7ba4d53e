"""The procedure of the paper on one campaign: Steps 2, 3 and 4, and the joint posterior."""

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import jax
from jaxtyping import Array, Key

from jbw.identification import third_order
from jbw.identification.cut import opening_steps
from jbw.identification.decay import decay_step
from jbw.identification.gathering import by_form, fitted, gather
from jbw.identification.joint import joint_step
from jbw.identification.linear_step import LinearStep, linear_step
from jbw.identification.selection import (
    DecaySplit,
    Sweeps,
    decay_tests,
    linear_test,
    probing_tests,
    sweep_tests,
)
from jbw.identification.step import Step
from jbw.inference.keeping import Keep, nowhere
from jbw.measurement.records import Test
from jbw.observables import response
from jbw.observables.decay import Decays
from jbw.observables.evidence import Evidence, labels

logger = logging.getLogger("jbw")
DECAY_KEY = 100  # of the seed: the paper's steps draw the same with decays and without


@dataclass(frozen=True)
class Identification:
    """Everything that the procedure found on a campaign.

    Attributes:
        linear: Step 2, when there was a noise test.
        kernel: Step 3's measured kernels and initial fit, when there were probing tones.
        sweeps: The split of the sweeps, when there were any.
        data: What the joint posterior was made from, as it was sampled.
        decays: The split of the free decays, when there were any.
        decay_data: Their envelopes, with the noise that the fit found.
        steps: Every posterior by name; the joint one is named "joint".
    """

    linear: LinearStep | None = None
    kernel: third_order.KernelFit | None = None
    sweeps: Sweeps | None = None
    data: Evidence | None = None
    decays: DecaySplit | None = None
    decay_data: Decays | None = None
    steps: dict[str, Step] = field(default_factory=dict)

    @property
    def main(self) -> Step:
        """The posterior that the verdict is about: the joint one where there is one."""
        return self.steps.get("joint") or self.steps["third_order_nuts"]

    @property
    def decay(self) -> Step | None:
        """The posterior from free decays: the joint one where there is nothing else."""
        if self.decays is None:
            return None
        return self.steps.get("decay") or self.main


Report = Callable[[str], None]


def run_procedure(
    tests: tuple[Test, ...],
    settings: Mapping[str, Any],
    *,
    gain: float | None = None,
    seed: int = 0,
    report: Report = logger.info,
    keep: Keep = nowhere,
) -> Identification:
    """Run every step that the tests of a campaign allow.

    Args:
        tests: The campaign's tests.
        settings: Its [identify] table.
        gain: Gain that the campaign states [N/kg per unit of the input], not identified then.
        seed: Seed of everything random.
        report: Called with one sentence at every stage.
        keep: Where the chains of each posterior outlive the process.

    Returns:
        The posteriors and what they were made from.

    Raises:
        DataError: If there is nothing that the joint can be fitted to.
    """
    decays = decay_tests(tests, settings, fitted(tests, settings))
    forced = any(test.kind != "decay" for test in tests)
    found = Identification(decays=decays)
    if forced:
        found = _forced_steps(found, tests, settings, gain, seed, report, keep)
    if decays is None:
        return found
    report(f"Free decays: the joint from {len(decays.fitted.records)} records")
    name = "decay" if forced else "joint"
    key = jax.random.fold_in(jax.random.key(seed), DECAY_KEY)
    step, data = decay_step(key, decays.fitted, settings, name, keep=keep)
    return replace(found, decay_data=data, steps={**found.steps, name: step})


def _forced_steps(
    found: Identification,
    tests: tuple[Test, ...],
    settings: Mapping[str, Any],
    gain: float | None,
    seed: int,
    report: Report,
    keep: Keep,
) -> Identification:
    """The paper's steps on the tests with a measured input, and the joint posterior of all."""
    keys = iter(jax.random.split(jax.random.key(seed), 16))
    noise, linear = linear_test(tests), None
    if noise is not None:
        report(f"Step 2: line fit of {noise.name}")
        linear = linear_step(noise, gain)
    sweeps = sweep_tests(tests, settings)
    found = replace(found, linear=linear, sweeps=sweeps)
    if linear is not None:
        found = _paper_steps(found, linear, tests, settings, keys, report, keep)
    data = gather(tests, settings, linear=linear, sweeps=sweeps, decays=found.decays, gain=gain)
    report(f"Joint posterior: all parameters from {len(labels(data))} groups of data")
    step, data = joint_step(next(keys), data, found.steps, settings, keep=keep)
    return replace(found, data=data, steps={**found.steps, "joint": step})


def _paper_steps(
    found: Identification,
    linear: LinearStep,
    tests: tuple[Test, ...],
    settings: Mapping[str, Any],
    keys: Iterator[Key[Array, ""]],
    report: Report,
    keep: Keep,
) -> Identification:
    """Steps 3 and 4 by the paper's cut, as far as the tests allow them."""
    probing = probing_tests(tests, linear.natural_hz)
    if not probing:
        return found
    report(f"Step 3: third-order kernel at {len(probing)} frequencies")
    kernel_fit = third_order.fit_kernel(next(keys), probing, linear.pooled, settings)
    steps = third_order.third_order_steps(next(keys), kernel_fit, settings, keep=keep)
    chosen = {test.name for test in fitted(tests, settings)}
    sweeps = [] if found.sweeps is None else found.sweeps.fitted
    swept = by_form([test for test in sweeps if test.name in chosen])
    if swept:
        # One record form, the one with the most levels: the curve of gamma is of one solve.
        report("Step 4: gamma alone, the earlier steps held")
        most = max(swept, key=len)
        swept = response.reduce(most, substeps=settings.get("substeps", 2))
        held = steps["third_order_nuts"]
        steps |= opening_steps(next(keys), swept, linear.pooled, held, settings, keep=keep)
    return replace(found, kernel=kernel_fit, steps=steps)
