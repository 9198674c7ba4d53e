"""What every law of a comparison is weighed by: its row of numbers, its loops, its residuals.

Of tests that no law was fitted to, what each law predicts counts within what was fitted and beyond.
Between the levels that were fitted and above them other laws may be best, and a laboratory that
asks for the next level wants the second.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Key

from jbw.errors import DataError, JbwError
from jbw.identification import evidence
from jbw.identification.across_kinds import across_kinds
from jbw.identification.assemble import Report
from jbw.identification.evidence import Candidate, likelihood_at
from jbw.identification.joint import every_parameter
from jbw.identification.prior_widths import log_evidence_wide
from jbw.identification.reached import threshold_sentences
from jbw.identification.unseen_runs import LeftOut, left_out, left_out_of_fits, runs_of
from jbw.inference.compiled import forget_when_many
from jbw.inference.thresholds import BEYOND
from jbw.measurement.channels import rms
from jbw.measurement.records import Test, belongs_to
from jbw.observables import dataset
from jbw.oscillator.oscillator import oscillator_of
from jbw.report.messages import stages
from jbw.report.messages import study as messages
from jbw.verification.predict import Request, predict
from jbw.verification.predicted import is_measured
from jbw.verification.predictive_basis import basis_of

# Of the posterior, and of what it makes of runs unseen.
Keys = Key[Array, " two"] | Sequence[Key[Array, ""]]
NUM_POINTS = 101  # of half a loop
MOST_PARTS = 100  # of a record, of which the rms is shown
NUM_DRAWS = 20  # an error is that of the median of so many


class Weighed(NamedTuple):
    """A law with what its posterior says."""

    candidate: Candidate
    draws: xr.DataTree
    left_out: LeftOut | None  # None where there is one run alone
    wide: float | None  # log evidence under priors twice as wide
    log_likelihood: float  # the largest [nats]
    hopeless: bool = False  # then draws and scores are of fits alone


def weigh(
    keys: Key[Array, " two"], candidates: Sequence[Candidate], report: Report
) -> tuple[dict[str, Weighed], dict[str, str]]:
    """Posterior of each law, and what it makes of each run unseen; laws that have none, and why.

    Of hopeless laws the fits alone.
    """
    weighed: dict[str, Weighed] = {}
    refused: dict[str, str] = {}
    runs = runs_of(candidates[0].fitted.data)
    likelihoods = {
        candidate.name: likelihood_at(candidate.fitted.fit, candidate.fitted.data)
        for candidate in candidates
    }
    hopeless = evidence.hopeless(candidates, likelihoods)
    for i, candidate in enumerate(candidates):
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


def loops(named: Mapping[str, Candidate], y_peak: float) -> xr.Dataset:
    """Steady loops at the largest displacement [m]: the force beside that of the stuck spring.

    On the way down from y = Y and up again, at the fit of each law; dampers do not act so slowly.
    """
    down = y_peak * np.cos(np.linspace(0.0, np.pi, NUM_POINTS))
    force = []
    for candidate in named.values():
        theta = dataset.as_arrays(candidate.fitted.fit.theta, candidate.fitted.data)
        joint = oscillator_of(theta, candidate.laws).slow
        stuck = sum(law.stiffness() for law in joint.laws)
        if not joint.laws:
            force.append(np.zeros(2 * NUM_POINTS))
            continue
        joint_force = np.asarray(joint.force_unloading(y_peak, jnp.asarray(down)) - stuck * down)
        force.append(np.concatenate([joint_force, -joint_force]))
    return xr.Dataset(
        {
            "displacement": ("point", np.concatenate([down, -down]), {"units": "m"}),
            "force": (("law", "point"), force, {"units": "N/kg"}),
        },
        {"law": list(named)},
    )


def residuals(named: Mapping[str, Candidate], highest: str | None) -> xr.Dataset:
    """What every law leaves along one group of data, over its rms: of the highest level, if known.

    Otherwise of the group with the largest response.
    """
    data = next(iter(named.values())).fitted.data
    sizes = dataset.size_by_label(data)
    pairs = zip(data.labels, data.runs, strict=True)
    labels = [label for label, run in pairs if run == highest and label in sizes] or list(sizes)
    if not labels:
        return xr.Dataset()
    label = max(labels, key=lambda name: sizes[name])
    rows = []
    for candidate in named.values():
        residual = dataset.left_by_label(candidate.fitted.fit.residual, candidate.fitted.data)[
            label
        ]
        relative = np.abs(residual) * np.sqrt(len(residual)) / sizes[label]
        parts = np.array_split(relative, min(MOST_PARTS, len(relative)))
        rows.append([np.sqrt(np.mean(part**2)) for part in parts])
    return xr.Dataset(
        {"left": (("law", "part"), rows, {"units": "1"})}, {"law": list(named)}, {"group": label}
    )


def unseen(tests: Sequence[Test], runs: Sequence[str]) -> list[Test]:
    """Measured tests of which no run was fitted."""
    return [
        test
        for test in tests
        if is_measured(test) and not any(belongs_to(r, test.name) for r in runs)
    ]


def errors_across_kinds(candidate: Candidate) -> dict[str, float] | None:
    """Error of a law on each kind of test as the other kinds predict it; None of one kind."""
    fitted = candidate.fitted
    predicted = across_kinds(fitted.fit, fitted.box, fitted.data)
    if predicted is None:
        return None
    return dict(
        zip(map(str, predicted["kind"].values), predicted["error"].values.tolist(), strict=True)
    )


def held_out(
    tests: Sequence[Test], groups: Mapping[str, xr.Dataset], laws: Sequence[str], seed: int
) -> xr.Dataset | None:
    """Error of every law on every test, and the largest displacement over that fitted; or None.

    NaN where a law predicts none. `groups` are those of `law_groups`.
    """
    if not tests:
        return None
    shape = len(laws), len(tests)
    error, reach = np.full(shape, np.nan), np.full(shape, np.nan)
    for i, law in enumerate(laws):
        law_tree = xr.DataTree.from_dict(
            {"/": groups[f"/laws/{law}"], "/posterior": groups[f"/laws/{law}/posterior"]}
        )
        try:
            basis = basis_of(law_tree)
        except JbwError:
            continue
        for j, test in enumerate(tests):
            try:
                prediction = predict(basis, test, Request(num_draws=NUM_DRAWS, seed=seed)).attrs
            except JbwError:
                continue
            error[i, j] = prediction.get("nrmse", np.nan)
            reach[i, j] = prediction.get("extrapolation", np.nan)
    dims = ("law", "test")
    return xr.Dataset(
        {
            "error": (dims, error, {"units": "1", "long_name": "error over rms"}),
            "extrapolation": (dims, reach, {
                "units": "1", "long_name": messages.VARIABLES["extrapolation"]}),
        },
        {"law": list(laws), "test": [test.name for test in tests]},
    )  # fmt: skip


def errors_apart(errors: xr.Dataset | None, law: str, best: str) -> dict[str, Any]:
    """Error of a law on tests within the motion fitted, and beyond it as the best law has it."""
    if errors is None:
        return {"error_held_out": None, "error_beyond": None}
    law_errors = errors["error"].sel(law=law).values
    beyond = errors["extrapolation"].sel(law=best).values > BEYOND
    finite = np.isfinite(law_errors)
    apart = (law_errors[finite & ~beyond], law_errors[finite & beyond])
    error_by_reach = [rms(part.tolist()) if len(part) else None for part in apart]
    return dict(zip(("error_held_out", "error_beyond"), error_by_reach, strict=True))
