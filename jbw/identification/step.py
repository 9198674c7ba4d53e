"""What every posterior of the procedure ends as."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from time import perf_counter

import xarray as xr

from jbw.inference.fit.fitting import Fit
from jbw.inference.posterior.verdict import Finding, Verdict, judge, verdict
from jbw.inference.space.box import Box
from jbw.oscillator.laws import laws_named, vocabulary
from jbw.quantities import OSCILLATOR, attrs_of


def attrs(laws: tuple[str, ...] = ()) -> dict[str, dict[str, str]]:
    """Attributes of the variables of a posterior, by name: units, symbol and meaning.

    Args:
        laws: Names of the laws of the joint, where they are not in the register by these.
    """
    table = [*OSCILLATOR, *vocabulary().values()]
    for law in laws_named(laws):
        table += law.table
    return attrs_of(table)


@dataclass(frozen=True)
class Step:
    """One posterior of the procedure.

    Attributes:
        name: Its name in the results, such as "third_order_nuts".
        posterior: The groups that the sampler left.
        verdict: How far it can be trusted.
        fit: The least-squares fit it started from.
        box: Its prior.
        statements: What it identifies and what it does not, in words.
        held: Parameters of the joint that were not updated, at the values they were held at.
        wall_s: Duration, compiling included [s].
    """

    name: str
    posterior: xr.DataTree
    verdict: Verdict
    fit: Fit
    box: Box
    statements: tuple[str, ...]
    held: dict[str, float]
    wall_s: float

    @property
    def means(self) -> dict[str, float]:
        """Posterior means of everything drawn."""
        return means_of(self.posterior)


def means_of(tree: xr.DataTree) -> dict[str, float]:
    """Posterior means by name."""
    group = tree["posterior"].to_dataset()
    return {str(name): float(draws.mean()) for name, draws in group.data_vars.items()}


def finished(
    name: str,
    posterior: xr.DataTree,
    box: Box,
    fit: Fit,
    started: float,
    *,
    findings: Iterable[Finding] = (),
    statements: Iterable[str] = (),
    held: Mapping[str, float] | None = None,
    chi_square: tuple[float, int] | None = None,
) -> Step:
    """Judge a posterior and put it beside what it came from.

    Args:
        name: Name of the step.
        posterior: The groups that the sampler left.
        box: Its prior.
        fit: The fit it started from.
        started: `perf_counter()` at the start of the step [s].
        findings: What else was looked at.
        statements: Sentences besides those that the fit itself gives.
        held: Parameters that were not updated.
        chi_square: Chi-square and its degrees of freedom, where the noise is known from repeats.
    """
    judged = verdict(posterior, box, chi_square=chi_square)
    said = [*statements]
    if fit.weak is not None:
        said.append(f"By the initial fit, {fit.weak.text}.")
    said += [
        f"The best fit of {parameter} lies at the {side} bound of its prior."
        for parameter, side in fit.at_bound.items()
    ]
    return Step(
        name,
        posterior,
        judge((*judged.findings, *findings)),
        fit,
        box,
        tuple(said),
        {name: float(value) for name, value in (held or {}).items()},
        perf_counter() - started,
    )
