"""The procedure of the paper on one campaign: Steps 2, 3 and 4, and the joint posterior."""

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import numpy as np

from jbw.errors import DataError
from jbw.identification import third_order
from jbw.identification.cut import opening_steps
from jbw.identification.decay import decay_step
from jbw.identification.joint import joint_step
from jbw.identification.linear_step import LinearStep, linear_step
from jbw.identification.opening import OpeningData, opening_data
from jbw.identification.selection import (
    DecaySplit,
    Sweeps,
    decay_tests,
    linear_test,
    probing_tests,
    sweep_tests,
)
from jbw.identification.step import Step
from jbw.measurement.records import Test
from jbw.observables import response
from jbw.observables.decay import Decays

logger = logging.getLogger("jbw")
DECAY_KEY = 100  # of the seed: the paper's steps draw the same with decays and without


@dataclass(frozen=True)
class Identification:
    """Everything that the procedure found on a campaign.

    Attributes:
        linear: Step 2, when there was a noise test.
        kernel: Step 3's measured kernels and initial fit, when there were probing tones.
        sweeps: The split of the sweeps, when there were any.
        data: The data of Step 4 with nothing held.
        decays: The split of the free decays, when there were any.
        decay_data: Their envelopes, with the noise that the fit found.
        steps: Every posterior by name; the joint one is named "joint".
    """

    linear: LinearStep | None = None
    kernel: third_order.KernelFit | None = None
    sweeps: Sweeps | None = None
    data: OpeningData | None = None
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
) -> Identification:
    """Run every step that the tests of a campaign allow.

    Args:
        tests: The campaign's tests.
        settings: Its [identify] table.
        gain: Gain that the campaign states [N/kg per unit of the input], not identified then.
        seed: Seed of everything random.
        report: Called with one sentence at every stage.

    Returns:
        The posteriors and what they were made from.

    Raises:
        DataError: If there is a measured input but no test allows Step 2, or neither a probing tone
            nor a sweep.
    """
    split = decay_tests(tests, settings)
    forced = any(test.kind != "decay" for test in tests)
    found = _forced_steps(tests, settings, gain, seed, report) if forced else Identification()
    if split is None:
        return found
    report(f"Free decays: the joint from {len(split.fitted.records)} records")
    name = "decay" if forced else "joint"
    key = jax.random.fold_in(jax.random.key(seed), DECAY_KEY)
    step, data = decay_step(key, split.fitted, settings, name)
    return replace(found, decays=split, decay_data=data, steps={**found.steps, name: step})


def _forced_steps(
    tests: tuple[Test, ...],
    settings: Mapping[str, Any],
    gain: float | None,
    seed: int,
    report: Report,
) -> Identification:
    """The paper's steps on the tests with a measured input."""
    keys = iter(jax.random.split(jax.random.key(seed), 16))
    noise = linear_test(tests)
    if noise is None:
        raise DataError(
            "Step 2 needs a test of kind noise or multisine, but the campaign has none.",
            remedy="Add one at a low level, or keep free decays alone in the campaign.",
        )
    report(f"Step 2: line fit of {noise.name}")
    linear = linear_step(noise, gain)
    natural_hz = linear.pooled.omega_n / (2 * np.pi)
    probing, sweeps = probing_tests(tests, natural_hz), sweep_tests(tests, settings)
    if not probing and sweeps is None:
        raise DataError(
            "The campaign has neither tones near a third of the resonance nor sweeps.",
            why="Steps 3 and 4 read the joint from them.",
            remedy=f"Add tones near {natural_hz / 3:.3g} Hz, or a sweep through the resonance.",
        )
    steps: dict[str, Step] = {}
    kernel_fit = None
    if probing:
        report(f"Step 3: third-order kernel at {len(probing)} frequencies")
        kernel_fit = third_order.fit_kernel(next(keys), probing, linear.pooled, settings)
        steps |= third_order.third_order_steps(next(keys), kernel_fit, settings)
    data = None
    if sweeps is not None:
        records = response.reduce(sweeps.fitted, substeps=settings.get("substeps", 2))
        known = (linear.pooled.gain, float(np.sqrt(linear.pooled.covariance[2, 2])))
        data = opening_data(records, {} if gain is None else {"gain": gain}, known)
        if kernel_fit is not None:
            report("Step 4: gamma alone, the earlier steps held")
            held = steps["third_order_nuts"]
            steps |= opening_steps(next(keys), data, linear.pooled, held, settings)
        report(f"Step 4: all parameters from {len(sweeps.fitted)} levels of sweeps")
        steps["joint"] = joint_step(next(keys), data, linear.pooled, steps, settings)
    return Identification(linear, kernel_fit, sweeps, data, steps=steps)
