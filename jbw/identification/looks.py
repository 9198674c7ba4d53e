"""What is looked at beside the chains: residuals, the solver, runs, effects, levels left out."""

from typing import NamedTuple

import xarray as xr
from jaxtyping import Array, Key

from jbw.identification.accuracy import residual_finding, solver_finding
from jbw.identification.effects import effects, effects_sentence, response_finding
from jbw.identification.leaving_out import (
    consistency_finding,
    leave_one_out,
    left_out_dataset,
    left_out_sentence,
)
from jbw.identification.runs import runs_dataset, runs_sentence
from jbw.identification.starts import largest_displacement
from jbw.identification.worth import counted_by_label
from jbw.inference.box import Box
from jbw.inference.finding import Finding
from jbw.inference.fitting import Fit
from jbw.observables.evidence import Evidence
from jbw.observables.weighing import error_by_label, left_by_label


class Looks(NamedTuple):
    """What was seen.

    Attributes:
        groups: Labelled arrays to keep beside the draws, by name.
        findings: For the verdict.
        words: For the reader, a sentence each.
    """

    groups: dict[str, xr.Dataset]
    findings: list[Finding]
    words: list[str]


def looks(
    key: Key[Array, ""], posterior: xr.Dataset, prior: Box, best: Fit, data: Evidence
) -> Looks:
    """Everything that a joint posterior is looked at for, beside its chains.

    Args:
        key: Random key.
        posterior: The draws, with the joint's own parameters among them.
        prior: The box that was sampled.
        best: The fit.
        data: The evidence, as it was sampled.
    """
    seen = Looks({}, [], [])
    left = left_by_label(best.residual, data)
    judged = (
        residual_finding(left, counted_by_label(data), error_by_label(left, data)),
        solver_finding(posterior[list(prior.names)], data),
    )
    seen.findings.extend(finding for finding in judged if finding is not None)
    if (runs := runs_dataset(key, posterior, prior.names, data)) is not None:
        seen.groups["runs"] = runs
        seen.words.append(runs_sentence(runs))
    held = {name: float(value) for name, value in data.held.items()}
    y_peak = largest_displacement(data, best.theta.get("omega_n", held.get("omega_n", 1.0)))
    if (bands := response_finding(posterior, held, y_peak)) is not None:
        seen.findings.append(bands)
    if (found := effects(posterior, held, y_peak)) is not None:
        seen.words.append(effects_sentence(found, y_peak))
    if (left_out := leave_one_out(best, prior, data)) is not None:
        seen.groups["leave_one_out"] = left_out_dataset(left_out)
        seen.findings.append(consistency_finding(left_out))
        seen.words.append(left_out_sentence(left_out))
    return seen
