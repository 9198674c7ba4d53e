"""The procedure of the paper on one campaign: Steps 2, 3 and 4, and the joint posterior."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import jax
from jaxtyping import Array, Key

from jbw.identification.assemble import Measured, Report, assemble
from jbw.identification.joint import joint_step
from jbw.identification.linear import PooledFit
from jbw.identification.linear_step import LinearStep
from jbw.identification.paper import step3
from jbw.identification.paper.step4 import opening_steps
from jbw.identification.prepare import Fitted
from jbw.identification.selection import DecaySplit, Sweeps
from jbw.identification.step import Step
from jbw.inference.samplers.chunked_run import Keep, no_checkpoint
from jbw.observables.dataset import Dataset
from jbw.observables.decay import Decays
from jbw.observables.records import Records, by_form

logger = logging.getLogger("jbw")
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
    seen: Measured, *, seed: int = 0, report: Report = logger.info, keep: Keep = no_checkpoint
) -> Identification:
    """Run every step that the tests of a campaign allow.

    Free decays are part of the joint posterior; beside other tests they have one of their own too,
    to compare with. `report` is called with one sentence at every stage; `keep` says where the
    chains of each posterior outlive the process.

    Raises:
        DataError: If there is nothing that the joint can be fitted to.
    """
    keys = iter(jax.random.split(jax.random.key(seed), 16))
    found = Identification(linear=seen.linear, sweeps=seen.sweeps, decays=seen.decays)
    if seen.linear is not None and seen.probing and "bouc_wen" in seen.laws:
        kernel_fit, steps = _paper_steps(seen, seen.linear.pooled, keys, report, keep)
        found = replace(found, kernel=kernel_fit, steps=steps)
    data = assemble(seen)
    report(f"Joint posterior: all parameters from {len(data.labels)} groups of data")
    step, data = joint_step(next(keys), data, found.steps, seen.settings, keep=keep)
    found = replace(found, data=data, steps={**found.steps, "joint": step})
    if seen.decays is None:
        return found
    if not all(test.traits.is_free for test in seen.tests):
        report("Free decays: the joint from them alone")
        key = jax.random.fold_in(jax.random.key(seed), DECAY_KEY)
        free = replace(seen, chosen=tuple(test for test in seen.chosen if test.traits.is_free))
        step, data = joint_step(key, assemble(free), {}, seen.settings, name="decay", keep=keep)
        found = replace(found, steps={**found.steps, "decay": step})
    decays = next((part for part in data.parts if isinstance(part, Decays)), None)
    return replace(found, decay_data=decays)


def _paper_steps(
    seen: Measured,
    linear: PooledFit,
    keys: Iterator[Key[Array, ""]],
    report: Report,
    keep: Keep,
) -> tuple[step3.KernelFit, dict[str, Step]]:
    """Steps 3 and 4 by the paper's cut, as far as the tests allow them."""
    report(f"Step 3: third-order kernel at {len(seen.probing)} frequencies")
    kernel_fit = step3.fit_kernel(next(keys), seen.probing, linear, seen.settings)
    steps = step3.third_order_steps(next(keys), kernel_fit, seen.settings, keep=keep)
    if swept := by_form(seen.swept):
        # One record form, the one with the most levels: the curve of gamma is of one solve.
        report("Step 4: gamma alone, the earlier steps held")
        records = Records.of(max(swept, key=len), substeps=seen.settings.substeps)
        held = steps["third_order_nuts"]
        steps |= opening_steps(next(keys), records, linear, held, seen.settings, keep=keep)
    return kernel_fit, steps
