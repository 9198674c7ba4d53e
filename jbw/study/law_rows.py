"""What every law of a comparison is weighed by, and its row of numbers."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import xarray as xr
from jaxtyping import Array, Key

from jbw.errors import DataError, JbwError
from jbw.identification import evidence
from jbw.identification.assemble import Report
from jbw.identification.evidence import Candidate, likelihood_at
from jbw.identification.floors import rms
from jbw.identification.joint import every_parameter
from jbw.identification.prior_widths import log_evidence_wide
from jbw.identification.reached import threshold_sentences
from jbw.identification.unseen_runs import LeftOut, left_out, left_out_of_fits, runs_of
from jbw.inference.compiled import forget_when_many
from jbw.report.messages import stages

# Of the posterior, and of what it makes of runs unseen.
Keys = Key[Array, " two"] | Sequence[Key[Array, ""]]


class Weighed(NamedTuple):
    """A law with what its posterior says."""

    candidate: Candidate
    draws: xr.DataTree
    left_out: LeftOut | None  # None where there is one run alone
    wide: float | None  # log evidence under priors twice as wide
    log_likelihood: float  # the largest [nats]
    hopeless: bool = False  # then draws and scores are of fits alone


def weigh(
    keys: Key[Array, " two"], found: Sequence[Candidate], report: Report
) -> tuple[dict[str, Weighed], dict[str, str]]:
    """Posterior of each law, and what it makes of each run unseen; laws that have none, and why.

    Of hopeless laws the fits alone.
    """
    weighed: dict[str, Weighed] = {}
    refused: dict[str, str] = {}
    runs = runs_of(found[0].fitted.data)
    likelihoods = {
        candidate.name: likelihood_at(candidate.fitted.fit, candidate.fitted.data)
        for candidate in found
    }
    hopeless = evidence.hopeless(found, likelihoods)
    for i, candidate in enumerate(found):
        forget_when_many()
        name, law_keys = candidate.name, [jax.random.fold_in(key, i) for key in keys]
        judged = _by_fit if name in hopeless else _by_draws
        report(stages.scoring(name, len(runs), by_fit=name in hopeless))
        try:
            weighed[name] = judged(law_keys, candidate, likelihoods[name], several=len(runs) > 1)
        except JbwError as error:
            refused[name] = str(error)
    if not weighed:
        raise DataError(f"No law can be weighed by these data: {next(iter(refused.values()))}")
    return weighed, refused


def _by_draws(keys: Keys, candidate: Candidate, most: float, *, several: bool) -> Weighed:
    """A law by its posterior, its runs left out where there are several."""
    drawn, moments = evidence.posterior(keys[0], candidate)
    held_out = left_out(keys[1], candidate, drawn, moments) if several else None
    wide = log_evidence_wide(keys[0], candidate, drawn)
    return Weighed(candidate, drawn, held_out, wide, most)


def _by_fit(keys: Keys, candidate: Candidate, most: float, *, several: bool) -> Weighed:
    """A hopeless law by its fits alone."""
    held_out = left_out_of_fits(candidate) if several else None
    return Weighed(
        candidate, evidence.about_fit(keys[0], candidate), held_out, None, most, hopeless=True
    )


def row_of(weighed: Weighed) -> dict[str, Any]:
    """Numbers of one law, plain values."""
    candidate, tree, held_out = weighed.candidate, weighed.draws, weighed.left_out
    names, posterior = candidate.fitted.box.names, tree["posterior"].to_dataset()
    every = every_parameter(posterior, candidate.fitted.data)
    return {
        "laws": list(candidate.laws),
        "meet": candidate.meet,
        "num_parameters": len(names),
        "error": candidate.error,
        "error_left_out": None if held_out is None else rms(list(held_out.error.values())),
        "error_highest": None,
        "error_across": None,
        "elpd": None if held_out is None else float(sum(held_out.elpd.values())),
        "khat": None if held_out is None else held_out.khat,
        "elpd_doubt": None if held_out is None else held_out.doubt,
        "log_likelihood": weighed.log_likelihood,
        "hopeless": weighed.hopeless,
        "log_evidence": tree.attrs.get("log_evidence"),
        "log_evidence_error": tree.attrs.get("log_evidence_error"),
        "log_evidence_wide": weighed.wide,
        "khat_evidence": tree.attrs.get("khat"),
        "at_bound": list(candidate.at_bound),
        "reached": threshold_sentences(every, candidate.fitted.y_peak, candidate.laws),
        "parameters": {
            str(name): {"mean": float(posterior[name].mean()), "sd": float(posterior[name].std())}
            for name in names
        },
    }
