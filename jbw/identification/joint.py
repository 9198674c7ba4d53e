"""All parameters set to update: the joint posterior of everything that was measured."""

from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter

import jax
import xarray as xr
from jaxtyping import Array, Key

from jbw.campaign.settings import Identify
from jbw.identification.derived import with_derived
from jbw.identification.drawing import sample_joint, stuck
from jbw.identification.posterior_checks import posterior_checks
from jbw.identification.prepare import prepare
from jbw.identification.step import Step, finished
from jbw.inference.samplers.checkpointing import Keep, nowhere
from jbw.observables.dataset import Dataset


def joint_step(
    key: Key[Array, ""],
    data: Dataset,
    earlier: Mapping[str, Step],
    settings: Identify,
    *,
    name: str = "joint",
    keep: Keep = nowhere,
) -> tuple[Step, Dataset]:
    """Joint posterior of all parameters of the joint, the gain and the noise.

    Args:
        key: Random key.
        data: What was measured.
        earlier: The paper's steps, when they were run.
        settings: The campaign's [identify] table.
        name: Name of the step.
        keep: Where the chains outlive the process.

    Returns:
        The step, its posterior with the noise by group and the laws' products besides the
        parameters; and the dataset as it was sampled: with the offsets of the runs, the effective
        values of coloured residuals, and the solver's steps that it took.

    Reference:
        Eq. (37), with every parameter set to update.
    """
    started = perf_counter()
    keys = jax.random.split(key, 5)
    ready = prepare(keys[:2], data, settings, _means(earlier))
    prior, best, data = ready.box, ready.fit, ready.data
    chains = sample_joint(keys[2], data, prior, best, settings, keep, name=name)
    posterior = with_derived(keys[3], chains, data)
    beside = posterior_checks(keys[4], posterior["posterior"].to_dataset(), prior, best, data)
    for group, dataset in beside.groups.items():
        posterior[group] = xr.DataTree(dataset)
    step = finished(
        name, posterior, prior, best, started,
        findings=beside.findings, statements=[*ready.words, *beside.words],
        held={held: float(value) for held, value in data.held.items()},
        chi_square=ready.chi_square,
    )  # fmt: skip
    words = stuck(step.posterior, step.verdict)
    return replace(step, statements=(*step.statements, *words)), data


def _means(earlier: Mapping[str, Step]) -> dict[str, float]:
    """Posterior means of the paper's steps, which are where to start."""
    found: dict[str, float] = {}
    for step in ("third_order_nuts", "opening_nuts"):
        if step in earlier:
            group = earlier[step].posterior["posterior"]
            found |= {str(n): float(v.mean()) for n, v in group.data_vars.items()}
    return found
