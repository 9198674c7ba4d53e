"""All parameters set to update: the joint posterior of everything that was measured."""

from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter
from typing import Any

import jax
import numpy as np
import xarray as xr
from jaxtyping import Array, Key

from jbw.identification.coordinates import box_of
from jbw.identification.drawing import sample_joint, stuck
from jbw.identification.looks import looks
from jbw.identification.noise import with_derived
from jbw.identification.settling import settled
from jbw.identification.starts import fit_from, linear_look
from jbw.identification.step import Step, finished
from jbw.inference.fitting import Fit
from jbw.inference.keeping import Keep, nowhere
from jbw.observables.decay import Decays
from jbw.observables.evidence import Evidence
from jbw.observables.linear import READ, LineReading


def joint_step(
    key: Key[Array, ""],
    data: Evidence,
    earlier: Mapping[str, Step],
    settings: Mapping[str, Any],
    *,
    keep: Keep = nowhere,
) -> tuple[Step, Evidence]:
    """Joint posterior of all parameters of the joint, the gain and the noise.

    Args:
        key: Random key.
        data: What was measured.
        earlier: The paper's steps, when they were run.
        settings: The campaign's [identify] table.
        keep: Where the chains outlive the process.

    Returns:
        The step "joint", its posterior with the noise by group and the products alpha*delta and
        alpha*gamma besides the parameters; and the evidence as it was sampled: with the offsets
        of the runs, the worth of coloured residuals, and the solver's steps that it took.

    Reference:
        Eq. (37), with every parameter set to update.
    """
    started = perf_counter()
    keys = jax.random.split(key, 5)
    known = {**linear_look(data), **_means(earlier)}
    prior = box_of(settings, data, known)
    first = fit_from(keys[0], data, prior, known)
    chi_square = explained(first, data)
    prior, best, data, words = settled(keys[1], data, prior, first, settings)
    best = replace(best, waterfall=first.waterfall)  # the later fits have one start
    chains = sample_joint(keys[2], data, prior, best, settings, keep)
    posterior = with_derived(keys[3], chains, data)
    beside = looks(keys[4], posterior["posterior"].to_dataset(), prior, best, data)
    for name, dataset in beside.groups.items():
        posterior[name] = xr.DataTree(dataset)
    step = finished(
        "joint", posterior, prior, best, started,
        findings=beside.findings, statements=[*words, *beside.words],
        held={name: float(value) for name, value in data.held.items()}, chi_square=chi_square,
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


def explained(first: Fit, data: Evidence) -> tuple[float, int] | None:
    """Chi-square of a fit over the groups whose noise is known from repeats, and its degrees."""
    rows, position = [], 0
    for part in data.parts:
        if isinstance(part, Decays):
            continue
        sizes, counted, width = np.array([len(READ)]), np.array([True]), len(READ)
        if not isinstance(part, LineReading):
            sizes = np.asarray(part.repeats.size)
            counted = np.asarray(part.repeats.num_repeats) > 1
            width = part.repeats.directions.shape[-1]
        block = first.residual[position : position + len(sizes) * width].reshape(-1, width)
        rows += list(zip(np.sum(block[counted] ** 2, axis=1), sizes[counted], strict=True))
        position += block.size
    if not rows:
        return None
    total, count = (sum(column) for column in zip(*rows, strict=True))
    return float(total), max(int(count) - len(first.x), 1)
