"""`jbw.population_of`: what a fleet says of its units, of their scatter and of their trends."""

import json
import logging
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray as xr
from scipy.stats import chi2

from jbw.errors import ConfigError, DataError
from jbw.inference.posterior.summary import QUANTILES
from jbw.inference.space.box import require_float64
from jbw.oscillator.laws import laws_named
from jbw.population.coordinates import Pooled, pooled, unit_names
from jbw.population.model import draws_of
from jbw.population.prior import WRENCH, Design, Prior, design_of, prior_of

logger = logging.getLogger("jbw")
Report = Callable[[str], None]

FEWEST = 3  # units, below which a scatter is its prior's
ODD = 0.01  # probability, over the number of units, from which one does not belong
OWN = 2.0  # a unit's own error over the scatter, above which its normal summary decides
GOOD_R_HAT, FEW_DIVERGENT = 1.01, 0.001


class Population(NamedTuple):
    """What `population_of` finds.

    Attributes:
        pooled: The coordinates and each unit's summary in them.
        design: Covariates.
        prior: Priors.
        draws: `line`, `tau` and `scatter`, axes (chain, draw).
        record: All numbers as plain values, as `population.json` holds them.
    """

    pooled: Pooled
    design: Design
    prior: Prior
    draws: dict[str, np.ndarray]
    record: dict[str, Any]


def population_of(
    fleet: xr.DataTree,
    *,
    parameters: Sequence[str] | None = None,
    all_verdicts: bool = False,
    seed: int = 0,
    report: Report = logger.info,
) -> Population:
    r"""The population that the units of a fleet come from.

    Each unit is the normal summary of its own posterior, in logarithms; what its run took for a
    prior is taken for flat beside it. Units scatter normally about a line in ln torque and in ln of
    the number of the tightening, as far as these vary.

    Args:
        fleet: From `jbw.fleet_of` or `jbw.read_fleet`.
        parameters: What is pooled; frequency, damping and the laws' products when None.
        all_verdicts: Pool though most runs failed.
        seed: Of the sampler.
        report: Called with one sentence at every stage.

    Raises:
        ConfigError: A name that the fleet does not have.
        DataError: One unit alone, most runs failed, a prior that cuts a posterior, or covariates
            that some units state and others do not.
    """
    require_float64()
    num = fleet.sizes["unit"]
    if num < 2:
        raise DataError("One unit makes no population.", remedy="Collect the runs of several.")
    root = fleet.to_dataset()
    failed = [str(one) for one in root["unit"].values[root["verdict"].values == "failed"]]
    if len(failed) > num / 2 and not all_verdicts:
        raise DataError(
            f"{len(failed)} of {num} runs failed: {', '.join(failed)}.",
            why="What a failed run says of its unit must not be used.",
            remedy="Mend them first (jbw explain), or pool them all the same with --all-verdicts.",
        )
    found = pooled(fleet, parameters)
    design = design_of(root["torque"].values.tolist(), root["sequence"].values.tolist())
    laws = laws_named(json.loads(fleet.attrs["laws"]))
    products = [one.name for law in laws for one in law.products]
    prior = prior_of(found.names, products, found.mean, design)
    draws = draws_of(jax.random.key(seed), found.mean, found.cov, design.x, prior, report)
    record = _record(fleet, found, design, prior, draws)
    return Population(found, design, prior, draws, record)


def require_torque(found: Population, torque: float | None) -> None:
    """Refuse a torque that no trend is known for."""
    if torque is None:
        return
    if not torque > 0.0:
        raise ConfigError(f"A torque must be above zero, but is {torque:g} N m.")
    if "torque" not in found.design.columns:
        raise DataError(
            "All units of the fleet have one torque, or state none: no trend with it is known.",
            remedy="Collect units of several torques, or leave --torque out.",
        )


def _record(
    fleet: xr.DataTree, found: Pooled, design: Design, prior: Prior, draws: dict[str, np.ndarray]
) -> dict[str, Any]:
    units, symbols = (json.loads(fleet.attrs[key]) for key in ("units", "symbols"))
    line, tau = (draws[name].reshape(-1, *draws[name].shape[2:]) for name in ("line", "tau"))
    own = np.sqrt(np.diagonal(found.cov, axis1=1, axis2=2))
    rows = {}
    for i, name in enumerate(found.names):
        rows[name] = {
            "unit": units.get(name, "1"),
            "symbol": symbols.get(name, name),
            "mean": _interval(np.exp(line[:, i, 0])),
            "scatter": _interval(tau[:, i]),
            **{
                f"slope_{column}": _interval(line[:, i, j])
                for j, column in enumerate(design.columns)
                if j
            },
            "own_over_scatter": float(np.max(own[:, i]) / np.median(tau[:, i])),
        }
    apart = _apart(found, design, line, draws["scatter"].reshape(-1, *draws["scatter"].shape[2:]))
    names = unit_names(fleet)
    record = {
        "units": names,
        "torque": fleet.to_dataset()["torque"].values.tolist(),
        "columns": list(design.columns),
        "reference_torque": None if np.isnan(design.reference) else design.reference,
        "parameters": rows,
        "belongs": dict(zip(names, map(float, apart), strict=True)),
        "sampling": _sampling(draws),
    }
    record["status"] = _status(record)
    record["statements"] = list(_statements(record))
    return record


def _interval(values: np.ndarray) -> dict[str, float]:
    low, median, high = np.quantile(values, QUANTILES)
    return {"median": float(median), "q005": float(low), "q995": float(high)}


def _apart(found: Pooled, design: Design, line: np.ndarray, scatter: np.ndarray) -> np.ndarray:
    """Probability that a unit of the population lies as far from the line as each does."""
    some = np.linspace(0, len(line) - 1, min(200, len(line))).astype(int)
    middle = np.einsum("sdp,kp->ksd", line[some], design.x)
    total = np.linalg.inv(scatter[some][None] + found.cov[:, None])
    off = found.mean[:, None] - middle
    squared = np.einsum("ksi,ksij,ksj->ks", off, total, off)
    return chi2.sf(squared, len(found.names)).mean(1)


def _sampling(draws: dict[str, np.ndarray]) -> dict[str, float]:
    from numpyro.diagnostics import effective_sample_size, split_gelman_rubin

    values = np.concatenate(
        [draws["tau"], draws["line"].reshape(*draws["line"].shape[:2], -1)], axis=-1
    )
    return {
        "r_hat": float(np.max(split_gelman_rubin(values))),
        "ess": float(np.min(effective_sample_size(values))),
        "divergences": int(draws["diverging"].sum()),
        "num_draws": int(draws["tau"].shape[0] * draws["tau"].shape[1]),
    }


def _status(record: dict[str, Any]) -> str:
    sampling, num = record["sampling"], len(record["units"])
    if num < FEWEST or num - len(record["columns"]) < 1:
        return "not assessed"
    good = sampling["r_hat"] < GOOD_R_HAT
    few = sampling["divergences"] <= FEW_DIVERGENT * sampling["num_draws"]
    return "ok" if good and few else "failed"


def _statements(record: dict[str, Any]):
    num, columns = len(record["units"]), record["columns"]
    if record["status"] == "not assessed":
        yield (
            f"{num} units say too little of a scatter"
            f"{' and a trend' if len(columns) > 1 else ''}: what stands here is mostly the priors'."
        )
    elif num - len(columns) < 3:
        yield f"{num} units leave {num - len(columns)} degrees of freedom: intervals are wide."
    for name, row in record["parameters"].items():
        if (slope := row.get("slope_torque")) is not None:
            way = "rises" if slope["q005"] > 0 else "falls" if slope["q995"] < 0 else None
            if way:
                yield f"{name} {way} with torque, by its power {slope['median']:.2g} " + (
                    f"[{slope['q005']:.2g}, {slope['q995']:.2g}]."
                )
    limit = ODD / num
    if odd := [name for name, p in record["belongs"].items() if p < limit]:
        yield f"Does not belong with the others: {', '.join(odd)}."
    if weak := [n for n, row in record["parameters"].items() if row["own_over_scatter"] > OWN]:
        yield (
            f"Of {', '.join(weak)} a unit's own error is more than {OWN:g} times the scatter: the "
            "normal shape of its posterior decides there."
        )
    if "torque" in columns:
        at = np.log([t for t in record["torque"]])
        part = WRENCH**2 / (np.var(at) + WRENCH**2)
        yield (
            f"A wrench that is off by {100 * WRENCH:.0f} % takes about {100 * part:.1g} % off "
            "every slope."
        )
