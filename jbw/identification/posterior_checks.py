"""What is checked beside the chains: residuals, the solver, runs, effects, levels left out."""

from typing import NamedTuple

import jax.numpy as jnp
import xarray as xr
from jaxtyping import Array, Key

from jbw.identification.accuracy import residual_finding, shape_finding, solver_finding
from jbw.identification.equivalent import effects, effects_sentence, response_finding
from jbw.identification.leaving_out import (
    consistency_finding,
    leave_one_out,
    left_out_dataset,
    left_out_sentence,
)
from jbw.identification.run_scatter import runs_dataset, runs_sentence
from jbw.inference.fit.fitting import Fit
from jbw.inference.posterior.finding import Finding
from jbw.inference.space.box import Box
from jbw.observables.dataset import Dataset, largest_displacement
from jbw.observables.weighting import error_by_label, fractions_counted, left_by_label


class Checks(NamedTuple):
    """What was seen.

    Attributes:
        groups: Labelled arrays to keep beside the draws, by name.
        findings: For the verdict.
        words: For the reader, a sentence each.
    """

    groups: dict[str, xr.Dataset]
    findings: list[Finding]
    words: list[str]


def posterior_checks(
    key: Key[Array, ""], posterior: xr.Dataset, prior: Box, best: Fit, data: Dataset
) -> Checks:
    """Everything that a joint posterior is checked for, beside its chains.

    Args:
        key: Random key.
        posterior: The draws, with the joint's own parameters among them.
        prior: The box that was sampled.
        best: The fit.
        data: The dataset, as it was sampled.
    """
    seen = Checks({}, [], [])
    left = left_by_label(best.residual, data)
    error = error_by_label(left, data)
    judged = (
        residual_finding(left, fractions_counted(data), error),
        shape_finding(error, data),
        solver_finding(posterior[list(prior.names)], data),
    )
    seen.findings.extend(finding for finding in judged if finding is not None)
    if (runs := runs_dataset(key, posterior, prior.names, data)) is not None:
        seen.groups["runs"] = runs
        seen.words.append(runs_sentence(runs))
    theta = {name: jnp.asarray(value) for name, value in best.theta.items()} | dict(data.held)
    for part in data.parts:
        seen.words.extend(part.statements(theta))
    held = {name: float(value) for name, value in data.held.items()}
    y_peak = largest_displacement(data, best.theta.get("omega_n", held.get("omega_n", 1.0)))
    if (bands := response_finding(posterior, held, y_peak, data.laws)) is not None:
        seen.findings.append(bands)
    if (found := effects(posterior, held, y_peak, data.laws)) is not None:
        seen.words.append(effects_sentence(found, y_peak))
    if (left_out := leave_one_out(best, prior, data)) is not None:
        seen.groups["leave_one_out"] = left_out_dataset(left_out)
        seen.findings.append(consistency_finding(left_out))
        seen.words.append(left_out_sentence(left_out))
    return seen
