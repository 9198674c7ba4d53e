"""The comparison of samplers on one posterior of a campaign: `jbw.compare`."""

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key

from jbw.campaign.load import Campaign
from jbw.errors import ConfigError, JbwError
from jbw.identification.assemble import measured_in
from jbw.identification.procedure import Known, Posterior, Report, posterior_of
from jbw.identification.step import attrs
from jbw.inference.posterior.summary import diagnose, posterior_draws, shape_of
from jbw.inference.posterior.verdict import converged, verdict
from jbw.inference.samplers.chunked_run import SoFar, Supervision
from jbw.inference.samplers.register import SAMPLERS, sampler_named
from jbw.inference.samplers.sampling import SamplingRequest, draw_posterior
from jbw.inference.space.box import require_float64
from jbw.inference.space.problem import Target
from jbw.inference.space.reparametrisation import in_box
from jbw.inference.space.ridge import along_ridge
from jbw.parts import Parts, unkept
from jbw.report.studies import comparison
from jbw.results.attributes import DrawnPosterior
from jbw.results.studies import StoredSamplers
from jbw.study.store import save_outputs, write_figure, write_json

QUANTILES = {"q010": 0.01, "q500": 0.5, "q990": 0.99}
QUANTITIES = ("mean", "sd", *QUANTILES)
GOOD_R_HAT = 1.01

Row = dict[str, float | None]
logger = logging.getLogger("jbw")
Watch = Callable[[str, SoFar], None]


@dataclass(frozen=True)
class Comparison:
    """The result of a comparison of samplers by `compare`."""

    posterior: Posterior  # posterior from which the samplers drew
    trees: dict[str, xr.DataTree]  # the draws of every sampler
    record: dict[str, Any]  # all numbers as plain values, as in `compare.json`

    @cached_property
    def result(self) -> StoredSamplers:
        """The content of `record` as typed objects."""
        return StoredSamplers.read(self.record)


class Drawn(NamedTuple):
    """The draws of a sampler's last call, and the durations of its calls."""

    tree: xr.DataTree
    cold_s: float  # seconds of the first call, with compilation
    # seconds of the second call, with another random key, if there was one
    warm_s: float | None = None


def compare(
    campaign: Campaign | Posterior,
    *,
    step: str = "joint",
    samplers: Sequence[str] | None = None,
    seed: int | None = None,
    num_chains: int = 4,
    twice: bool = True,
    known: Known | None = None,
    report: Report = logger.info,
    watch: Watch = lambda name, so_far: None,
    parts: Parts = unkept,
) -> Comparison:
    """Draw from one posterior of a campaign with several samplers and compare their estimates.

    Args:
        campaign: Campaign from `jbw.load_campaign` or the virtual rig, or an available posterior.
        step: "joint", or "third_order" (Step 3) or "opening" (Step 4) of the paper's procedure.
        samplers: Names as in `[identify] sampler`; when None, all that suit the posterior:
            quadrature for up to four parameters, and neither nested sampling nor the published
            walk if an evaluation steps through time.
        seed: Seed of everything random; the campaign's, or 0, when None.
        num_chains: Chains of each sampler.
        twice: Whether every sampler except quadrature runs a second time, to measure its time
            without compilation.
        known: Facts from a finished run about its prior and Step 3.
        report: Function that is called with one sentence at every stage.
        watch: Function that is called with a sampler's name and the progress of its chains.
        parts: Store of each sampler's draws, so that a killed comparison can continue.

    Returns:
        Draws and numbers. The record gives the reason for each sampler that cannot draw from this
        posterior.

    Raises:
        ConfigError: The step or a sampler is unknown, or JAX works in float32.
        DataError: The tests do not allow the step.

    Examples:
        Quadrature is exact, and importance sampling finds the same damping ratio:

        >>> import jbw; jbw.enable_x64()
        >>> from dataclasses import replace
        >>> rig = jbw.rig.measure(tests=["noise_0p005V"], repeats=2, fs=128.0)
        >>> samplers = ["quadrature", "importance"]
        >>> found = jbw.compare(replace(rig, laws=()), samplers=samplers, num_chains=2, twice=False)
        >>> for name, row in found.record["samplers"].items():
        ...     print(name, f"{row['parameters']['zeta']['mean']:.3%}")
        quadrature 0.446%
        importance 0.446%
    """
    require_float64()
    unknown = [name for name in samplers or () if name not in SAMPLERS]
    if unknown:
        raise ConfigError(
            f"Argument `samplers` may contain only {', '.join(SAMPLERS)}, but contains "
            f"{unknown[0]!r}."
        )
    record: dict[str, Any] = {}
    if isinstance(campaign, Posterior):
        posterior, seed = campaign, seed or 0
    else:
        seed = campaign.settings.seed if seed is None else seed
        seen = measured_in(campaign, report)
        posterior = posterior_of(step, seen, seed=seed, known=known, report=report)
        record["campaign"] = campaign.name
    key = jax.random.fold_in(jax.random.key(seed), len(SAMPLERS))
    drawn: dict[str, Drawn] = {}
    refused: dict[str, str] = {}
    for name in samplers or suited(posterior):
        report(f"Drawing by {name}")
        try:
            draw = partial(_drawn, key, posterior, name, num_chains, twice, watch)
            drawn[name] = parts(f"draws by {name}", draw, Drawn)
        except JbwError as error:
            refused[name] = str(error)
    record |= {
        "posterior": posterior.name,
        "parameters": list(posterior.box.names),
        "seed": seed,
        **_numbers_of(drawn, posterior),
        "refused": refused,
    }
    return Comparison(posterior, {name: sample.tree for name, sample in drawn.items()}, record)


def suited(posterior: Posterior) -> tuple[str, ...]:
    """Return the names of the samplers that `compare` uses by default for a posterior."""
    size = len(posterior.box.names)
    suitable = [
        sampler
        for sampler in SAMPLERS.values()
        if sampler.suits(size) and (sampler.suits_costly or not posterior.stepped)
    ]
    # The exact sampler comes first, because the other samplers are compared with it.
    return tuple(
        sampler.name
        for sampler in sorted(suitable, key=lambda sampler: sampler.most_parameters is None)
    )


def _drawn(
    key: Key[Array, ""],
    posterior: Posterior,
    sampler: str,
    num_chains: int,
    twice: bool,
    watch: Watch,
) -> Drawn:
    entry = sampler_named(sampler)
    num_warmup, num_samples = entry.draws if posterior.stepped else entry.cheap_draws
    best = posterior.fit
    coordinates = None
    if posterior.stepped:  # All chains start at the fit, as in an identification.
        coordinates = in_box(posterior.box, best.theta, best.covariance, num_chains)
    # These chains start along the ridge of the fit, but chains of other samplers start from the
    # whole prior.
    elif not entry.from_prior:
        coordinates = along_ridge(best.theta, best.covariance, posterior.box)
    parallel = "parallel" if jax.device_count() > 1 and num_chains % 2 == 0 else "sequential"
    request = SamplingRequest(
        sampler, num_warmup, num_samples, num_chains,
        parallel if posterior.stepped else "vectorized", {"adapt_mass": True},
    )  # fmt: skip
    target = Target(posterior.log_likelihood, posterior.box, posterior.data)
    supervision = Supervision(progress=lambda so_far: watch(sampler, so_far))
    # No second call is needed, because an exact sampler would return the same result.
    exact = entry.most_parameters is not None
    calls, seconds = jax.random.split(key)[: 2 if twice and not exact else 1], []
    for key in calls:
        started = perf_counter()
        tree = draw_posterior(
            key, target, request, coordinates,
            supervision=supervision, attrs=attrs(posterior.laws),
        )  # fmt: skip
        seconds.append(perf_counter() - started)
    return Drawn(tree, *seconds)


def _numbers_of(drawn: Mapping[str, Drawn], posterior: Posterior) -> dict[str, Any]:
    if not drawn:
        return {"reference": None, "samplers": {}}
    rows = {
        sampler: {
            name: numbers(np.asarray(sample.tree["posterior"][name]))
            for name in posterior.box.names
        }
        for sampler, sample in drawn.items()
    }
    exact = "quadrature" in drawn and converged(DrawnPosterior.of(drawn["quadrature"].tree))
    chains = {name: row for name, row in rows.items() if name != "quadrature"} or rows
    reference = "quadrature" if exact else reference_of(chains)
    truth = exact_numbers(drawn["quadrature"].tree) if exact else rows[reference]
    for sampler, parameters in rows.items():
        for name, row in parameters.items():
            if sampler != reference:
                row |= distances(row, truth[name])
            elif exact:
                row |= truth[name]
    base = drawn[reference].tree.attrs
    numbers_by_name = {
        name: _row(sample, rows[name], base, posterior) for name, sample in drawn.items()
    }
    numbers_by_name[reference]["z_log_evidence"] = None
    return {"reference": reference, "samplers": numbers_by_name}


def _row(
    sample: Drawn, rows: Mapping[str, Row], base: Mapping[Any, Any], posterior: Posterior
) -> dict[str, Any]:
    facts, ess = DrawnPosterior.of(sample.tree), worst_ess(rows)
    judged = verdict(sample.tree, posterior.box)
    return {
        "draws": math.prod(shape_of(posterior_draws(sample.tree))),
        "ess": ess,
        "num_evaluations": facts.num_evaluations,
        "wall_cold_s": round(sample.cold_s, 4),
        "wall_warm_s": None if sample.warm_s is None else round(sample.warm_s, 4),
        "ess_per_s_cold": None if ess is None else ess / sample.cold_s,
        "ess_per_s_warm": None if ess is None or sample.warm_s is None else ess / sample.warm_s,
        "log_evidence": facts.log_evidence,
        "log_evidence_error": facts.log_evidence_error,
        "z_log_evidence": distance(sample.tree.attrs, base, "log_evidence", "log_evidence_error"),
        "furthest": furthest(list(rows.values())),
        "verdict": judged.status,
        "failed": [finding.code for finding in judged.findings if finding.status == "failed"],
        "parameters": dict(rows),
    }


def save_comparison(folder: Path, found: Comparison) -> None:
    """Write the files of a comparison of samplers: compare.json, then compare.png."""
    figure = {"compare.png": lambda path: write_figure(path, comparison(found.result))}
    numbers = {"compare.json": lambda path: write_json(path, found.record)}
    save_outputs(folder, numbers, figure if found.trees else {})


def numbers(draws: Float[np.ndarray, "chain draw"]) -> Row:
    """Return a parameter's mean, sd, quantiles 1, 50, 99 %, their errors (mcse_), ESS and R-hat.

    Values that cannot be computed are None. Vehtari et al. (2021), Bayesian Analysis 16, 667.
    """
    # The import takes a second and is needed only here.
    from arviz_stats.base.array import array_stats

    # The annotations of `summary` allow tuples, which it never returns here.
    stats: Any = array_stats
    row = {"mean": np.mean(draws), "sd": np.std(draws, ddof=1)}
    row |= {name: np.quantile(draws, probability) for name, probability in QUANTILES.items()}
    diagnostics = diagnose(draws)
    row |= diagnostics
    if np.isfinite(diagnostics["ess_bulk"]):
        row |= {f"mcse_{name}": stats.mcse(draws, method=name) for name in ("mean", "sd")}
        for name, probability in QUANTILES.items():
            row[f"mcse_{name}"] = stats.mcse(draws, method="quantile", prob=probability)
    return {name: float(value) if np.isfinite(value) else None for name, value in row.items()}


def exact_numbers(tree: xr.DataTree) -> dict[str, Row]:
    """Return a posterior's numbers as computed by quadrature, with the errors of the quadrature."""
    table = tree["exact"].to_dataset()
    error = float(tree.attrs["quadrature_error"])
    rows: dict[str, Row] = {}
    for name in table["parameter"].values:
        column = table.sel(parameter=name)
        row = {"mean": float(column["mean"]), "sd": float(column["sd"])}
        for called, probability in QUANTILES.items():
            row[called] = float(column["quantiles"].sel(probability=probability, method="nearest"))
        errors = {f"mcse_{quantity}": error * row["sd"] for quantity in QUANTITIES}
        rows[str(name)] = {**row, **errors}
    return rows


def worst_ess(rows: Mapping[str, Row]) -> float | None:
    """Return the smallest effective sample size (bulk or tail) among all parameters."""
    sizes = [row[kind] for row in rows.values() for kind in ("ess_bulk", "ess_tail")]
    available = [value for value in sizes if value is not None]
    return min(available) if available and len(available) == len(sizes) else None


def reference_of(rows: Mapping[str, Mapping[str, Row]]) -> str:
    """Return the sampler of largest effective sample size, if possible with small R-hat."""

    def agrees(sampler: str) -> bool:
        r_hats = [row["r_hat"] for row in rows[sampler].values()]
        return all(value is not None and value < GOOD_R_HAT for value in r_hats)

    among = [sampler for sampler in rows if agrees(sampler)] or list(rows)
    return max(among, key=lambda sampler: worst_ess(rows[sampler]) or 0.0)


def distances(row: Row, reference: Row) -> dict[str, float | None]:
    """Return each estimate's standardised distance from a reference, with keys z_NAME."""
    return {f"z_{name}": distance(row, reference, name, f"mcse_{name}") for name in QUANTITIES}


def distance(
    row: Mapping[Any, Any], reference: Mapping[Any, Any], name: str, error: str
) -> float | None:
    r"""Return $(a - b) / \sqrt{\mathrm{mcse}_a^2 + \mathrm{mcse}_b^2}$, a standardised distance."""
    operands: list[Any] = [
        sampler_row.get(key) for key in (name, error) for sampler_row in (row, reference)
    ]
    if None in operands:
        return None
    a, b, *errors = operands
    size = float(np.hypot(*errors))
    return float(a - b) / size if size > 0 else None


def furthest(rows: Sequence[Row]) -> float | None:
    """Return the standardised distance of largest absolute value; None if there is none."""
    scores = [row.get(f"z_{name}") for row in rows for name in QUANTITIES]
    sizes = [abs(value) for value in scores if value is not None]
    return max(sizes) if sizes else None
