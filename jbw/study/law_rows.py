"""What every law of a comparison is weighed by, and its row of numbers."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import xarray as xr
from jaxtyping import Array, Key

from jbw.errors import DataError, JbwError
from jbw.identification import evidence
from jbw.identification.assemble import Report
from jbw.identification.evidence import Candidate
from jbw.identification.floors import rms
from jbw.identification.joint import every_parameter
from jbw.identification.prior_widths import log_evidence_wide
from jbw.identification.reached import threshold_sentences
from jbw.identification.unseen_runs import LeftOut, left_out, left_out_of_fits, runs_of
from jbw.inference.compiled import forget_when_many


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
    likelihoods = {one.name: evidence.largest_likelihood(one) for one in found}
    hopeless = evidence.hopeless(found, likelihoods)
    for i, one in enumerate(found):
        forget_when_many()
        name, (own, other) = one.name, (jax.random.fold_in(key, i) for key in keys)
        unseen = f"{len(runs)} runs predicted from each other's rest"
        report(f"{name}: {unseen}{' by fits alone' if name in hopeless else '; evidence'}")
        most = likelihoods[name]
        try:
            if name in hopeless:
                known = left_out_of_fits(one) if len(runs) > 1 else None
                weighed[name] = Weighed(one, evidence.about_fit(own, one), known, None, most, True)
                continue
            drawn = evidence.posterior(own, one)
            known = left_out(other, one, drawn) if len(runs) > 1 else None
            wide = log_evidence_wide(own, one, drawn.attrs.get("log_evidence"))
        except JbwError as error:
            refused[name] = str(error)
        else:
            weighed[name] = Weighed(one, drawn, known, wide, most)
    if not weighed:
        raise DataError(f"No law can be weighed by these data: {next(iter(refused.values()))}")
    return weighed, refused


def row_of(weighed: Weighed) -> dict[str, Any]:
    """Numbers of one law, plain values."""
    one, tree, left = weighed.candidate, weighed.draws, weighed.left_out
    names, posterior = one.fitted.box.names, tree["posterior"].to_dataset()
    every = every_parameter(posterior, one.fitted.data)
    return {
        "laws": list(one.laws),
        "meet": one.meet,
        "num_parameters": len(names),
        "error": one.error,
        "error_left_out": None if left is None else rms(list(left.error.values())),
        "error_highest": None,
        "elpd": None if left is None else float(sum(left.elpd.values())),
        "khat": None if left is None else left.khat,
        "log_likelihood": weighed.log_likelihood,
        "hopeless": weighed.hopeless,
        "log_evidence": tree.attrs.get("log_evidence"),
        "log_evidence_error": tree.attrs.get("log_evidence_error"),
        "log_evidence_wide": weighed.wide,
        "khat_evidence": tree.attrs.get("khat"),
        "at_bound": list(one.at_bound),
        "reached": threshold_sentences(every, one.fitted.y_peak, one.laws),
        "parameters": {
            str(name): {"mean": float(posterior[name].mean()), "sd": float(posterior[name].std())}
            for name in names
        },
    }
