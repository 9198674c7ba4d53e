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
from jbw.population.coordinates import Pooled, pooled, unit_names, units_of_fleet
from jbw.population.model import Units, draws_of, log_weights
from jbw.population.prior import WRENCH, Design, Prior, design_of, prior_of
from jbw.population.trend import expected, mask_of

logger = logging.getLogger("jbw")
Report = Callable[[str], None]

FEWEST = 3  # units, below which a scatter is its prior's
ODD = 0.01  # probability, over the number of units, from which one does not belong
OWN = 2.0  # a unit's own error over the scatter, above which its normal summary stands for it
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
    saturating: Sequence[str] = (),
    summaries: bool = False,
    all_verdicts: bool = False,
    seed: int = 0,
    report: Report = logger.info,
) -> Population:
    r"""The population that the units of a fleet come from.

    Units scatter normally, in logarithms, about a line in ln torque and in ln of the number of the
    tightening, as far as these vary. A unit that knows itself better than the population does is
    its draws, weighed anew; one whose own error is more than twice the scatter is the normal
    summary of its posterior, for hardly a draw would count.

    Args:
        fleet: From `jbw.fleet_of` or `jbw.read_fleet`.
        parameters: What is pooled; frequency, damping and the laws' products when None.
        saturating: Coordinates that follow a saturating curve of the torque, not a power.
        summaries: Take the normal summary of every unit.
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
    design = design._replace(saturates=mask_of(saturating, found.names, design.columns))
    laws = laws_named(json.loads(fleet.attrs["laws"]))
    products = [one.name for law in laws for one in law.products]
    prior = prior_of(found.names, products, found.mean, design)
    units = units_of_fleet(fleet, found)
    draws = draws_of(jax.random.key(seed), units, design, prior, report)
    known = _own_over_scatter(found, draws).max(axis=1) <= OWN
    if known.any() and not summaries:
        units = units._replace(weighed=known)
        draws = draws_of(jax.random.key(seed), units, design, prior, report)
    record = _record(fleet, found, design, draws) | _shares(units, design, draws, fleet)
    record["statements"] = list(_statements(record))
    return Population(found, design, prior, draws, record)


def _own_over_scatter(found: Pooled, draws: dict[str, np.ndarray]) -> np.ndarray:
    """Each unit's own error over the median scatter, axes (unit, d)."""
    own = np.sqrt(np.diagonal(found.cov, axis1=1, axis2=2))
    return own / np.median(draws["tau"], axis=(0, 1))


def _shares(
    units: Units, design: Design, draws: dict[str, np.ndarray], fleet: xr.DataTree
) -> dict[str, Any]:
    r"""Of each unit that its draws stand for, their Kish share $(\sum w)^2 / (S \sum w^2)$.

    Under the population's median.
    """
    which = np.flatnonzero(units.weighed)
    line, scatter = (np.median(draws[name], axis=(0, 1)) for name in ("line", "scatter"))
    bent = np.median(draws["u"]) if "u" in draws else None
    means = expected(line, design.x, design, bent)
    w = np.asarray(log_weights(units, which, means, np.linalg.cholesky(scatter)))
    w = np.exp(w - w.max(axis=1, keepdims=True))
    share = w.sum(axis=1) ** 2 / (w.shape[1] * (w**2).sum(axis=1))
    names = np.array(unit_names(fleet))[which]
    return {"weighed": dict(zip(names.tolist(), share.tolist(), strict=True))}


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
    fleet: xr.DataTree, found: Pooled, design: Design, draws: dict[str, np.ndarray]
) -> dict[str, Any]:
    units, symbols = (json.loads(fleet.attrs[key]) for key in ("units", "symbols"))
    line, tau = (draws[name].reshape(-1, *draws[name].shape[2:]) for name in ("line", "tau"))
    ratio = _own_over_scatter(found, draws).max(axis=0)
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
            "own_over_scatter": float(ratio[i]),
        }
    apart = _apart(found, design, draws)
    names = unit_names(fleet)
    record = {
        "units": names,
        "torque": fleet.to_dataset()["torque"].values.tolist(),
        "columns": list(design.columns),
        "saturating": [n for n, bent in zip(found.names, design.saturates, strict=True) if bent],
        "reference_torque": None if np.isnan(design.reference) else design.reference,
        "parameters": rows,
        "belongs": dict(zip(names, map(float, apart), strict=True)),
        "sampling": _sampling(draws),
    }
    if "u" in draws:
        record["saturation_torque"] = _interval(design.reference * draws["u"])
    record["status"] = _status(record)
    return record


def _interval(values: np.ndarray) -> dict[str, float]:
    low, median, high = np.quantile(values, QUANTILES)
    return {"median": float(median), "q005": float(low), "q995": float(high)}


def _apart(found: Pooled, design: Design, draws: dict[str, np.ndarray]) -> np.ndarray:
    """Probability that a unit of the population lies as far from the line as each does."""
    flat = {n: v.reshape(-1, *v.shape[2:]) for n, v in draws.items() if n != "diverging"}
    some = np.linspace(0, len(flat["tau"]) - 1, min(200, len(flat["tau"]))).astype(int)
    some = {name: values[some] for name, values in flat.items()}
    middle = np.asarray(expected(some["line"], design.x, design, some.get("u")))
    total = np.linalg.inv(some["scatter"][None] + found.cov[:, None])
    off = found.mean[:, None] - np.swapaxes(middle, 0, 1)
    squared = np.einsum("ksi,ksij,ksj->ks", off, total, off)
    return chi2.sf(squared, len(found.names)).mean(1)


def _sampling(draws: dict[str, np.ndarray]) -> dict[str, float]:
    from numpyro.diagnostics import effective_sample_size, split_gelman_rubin

    values = np.concatenate(
        [draws["tau"], draws["line"].reshape(*draws["line"].shape[:2], -1)]
        + [draws[name][..., None] for name in ("u",) if name in draws],
        axis=-1,
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
    if weighed := record["weighed"]:
        yield (
            f"{len(weighed)} of {num} units stand with their own draws, weighed anew: "
            f"{100 * min(weighed.values()):.0f} % of them count at least."
        )
    if weak := [n for n, row in record["parameters"].items() if row["own_over_scatter"] > OWN]:
        yield (
            f"Of {', '.join(weak)} a unit's own error is more than {OWN:g} times the scatter: the "
            "normal shape of its posterior decides there."
        )
    if (at := record.get("saturation_torque")) is not None:
        yield (
            f"{', '.join(record['saturating'])} was said to saturate with torque, and does so over "
            f"{at['median']:.2g} [{at['q005']:.2g}, {at['q995']:.2g}] N m: a power is told from it "
            "only by torques far apart."
        )
    if "torque" in columns:
        at = np.log([t for t in record["torque"]])
        part = WRENCH**2 / (np.var(at) + WRENCH**2)
        yield (
            f"A wrench that is off by {100 * WRENCH:.0f} % takes about {100 * part:.1g} % off "
            "every slope."
        )
