"""What a population says in numbers, as `population.json` holds them, and in sentences of these."""

import json
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.inference.posterior.summary import QUANTILES
from jbw.population.coordinates import Pooled, laws_of, monomials_of, parameters_of, unit_names
from jbw.population.model import UnitPosteriors, log_weights
from jbw.population.prior import TORQUE, WRENCH, CovariateDesign, Prior
from jbw.population.trend import expected
from jbw.population.unit import GAIN
from jbw.report.messages import population as messages

FEWEST = 3  # units, below which a scatter is its prior's
FEWEST_FREE = 3  # degrees of freedom, below which a trend's intervals are
GOOD_R_HAT, FEW_DIVERGENT = 1.01, 0.002
Draws = dict[str, np.ndarray]
ODD = 0.01  # probability, over the number of units, from which one does not belong
OWN = 2.0  # a unit's own error over the scatter, above which its normal summary stands for it
TOGETHER = 0.95  # correlation of torque and number of the tightening that hides one by the other
Record = Mapping[str, Any]


class Pooling(NamedTuple):
    """Draws of a population model, and what it was made of."""

    pooled: Pooled
    units: UnitPosteriors
    design: CovariateDesign
    prior: Prior
    draws: Draws


def record_of(
    fleet: xr.DataTree, pooling: Pooling, belongs: Float[np.ndarray, " unit"]
) -> dict[str, Any]:
    """All numbers of a population; `belongs` as `belonging` has it."""
    pooled, units, design, prior, draws = pooling
    root, names = fleet.to_dataset(), unit_names(fleet)
    torque = root["torque"].values.tolist()
    record = {
        "units": names,
        "torque": [value if np.isfinite(value) else None for value in torque],
        "columns": list(design.columns),
        "correlation": _correlation(design),
        "saturating": [n for n, bent in zip(pooled.names, design.saturates, strict=True) if bent],
        "reference_torque": None if np.isnan(design.reference) else design.reference,
        "parameters": _rows(fleet, pooled, design, draws),
        "ratios": _ratios(fleet, pooled, design, prior, draws),
        "belongs": dict(zip(names, map(float, belongs), strict=True)),
        "weighed": _shares(units, design, draws, names),
        "failed": root["unit"].values[root["verdict"].values == "failed"].astype(str).tolist(),
        "no_logarithm": _no_logarithm(fleet),
        "sampling": _sampling(draws),
    }
    if "u" in draws:
        record["saturation_torque"] = interval(design.reference * draws["u"])
    record["status"] = status_of(record)
    return record


def own_over_scatter(pooled: Pooled, draws: Draws) -> Float[np.ndarray, "unit d"]:
    """Each unit's own error over the median scatter."""
    unit_sd = np.sqrt(np.diagonal(pooled.cov, axis1=1, axis2=2))
    return unit_sd / np.median(draws["tau"], axis=(0, 1))


def interval(values: np.ndarray) -> dict[str, float]:
    """Median and 99 % interval."""
    low, median, high = np.quantile(values, QUANTILES)
    return {"median": float(median), "q005": float(low), "q995": float(high)}


def _rows(
    fleet: xr.DataTree, pooled: Pooled, design: CovariateDesign, draws: Draws
) -> dict[str, dict[str, Any]]:
    """A row a coordinate: mean, scatter between units and between runs, powers."""
    units, symbols = (json.loads(fleet.attrs[key]) for key in ("units", "symbols"))
    line, tau = draws["line"], draws["tau"]
    ratio = own_over_scatter(pooled, draws).max(axis=0)
    rows = {}
    for i, name in enumerate(pooled.names):
        runs = fleet.to_dataset()["run_scatter"].sel(parameter=name).values
        runs = runs[np.isfinite(runs)]
        rows[name] = {
            "unit": units.get(name, "1"),
            "symbol": symbols.get(name, name),
            "mean": interval(np.exp(line[..., i, 0])),
            "scatter": interval(tau[..., i]),
            "run_scatter": float(np.sqrt(np.mean(runs**2))) if len(runs) else None,
            **{
                f"slope_{column}": interval(line[..., i, j])
                for j, column in enumerate(design.columns)
                if j
            },
            "own_over_scatter": float(ratio[i]),
        }
    return rows


def _ratios(
    fleet: xr.DataTree, pooled: Pooled, design: CovariateDesign, prior: Prior, draws: Draws
) -> dict[str, dict[str, float]]:
    """The power of torque of ratios of two products, by its text: gamma/delta of Bouc-Wen's law."""
    if TORQUE not in design.columns:
        return {}
    slope = draws["line"][..., design.columns.index(TORQUE)]
    monomials = monomials_of(laws_of(fleet))
    rows = {}
    for i, j in prior.same_unit:
        below, above = (monomials[pooled.names[index]] for index in (i, j))
        text = "/".join(
            "*".join(name for name in factors if factors[name] != other.get(name))
            for factors, other in ((above, below), (below, above))
        )
        rows[text] = interval(slope[..., j] - slope[..., i])
    return rows


def _shares(
    units: UnitPosteriors, design: CovariateDesign, draws: Draws, names: list[str]
) -> dict[str, float]:
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
    return dict(zip(np.array(names)[which].tolist(), share.tolist(), strict=True))


def _correlation(design: CovariateDesign) -> float | None:
    """Of ln torque with ln of the number of the tightening over the units, where both vary."""
    if len(design.columns) < 3:
        return None
    return float(np.corrcoef(design.x[:, 1], design.x[:, 2])[0, 1])


def _no_logarithm(fleet: xr.DataTree) -> dict[str, list[str]]:
    """Parameters that are not positive in some units, or not known there, and these units."""
    lacking = json.loads(fleet.attrs["left_out"])
    return {n: lacking[n] for n in parameters_of(fleet) if n in lacking and n != GAIN}


def _sampling(draws: Draws) -> dict[str, float]:
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


def status_of(record: Mapping[str, Any]) -> str:
    """`ok`, `failed` where the sampler did, `not assessed` where units are too few."""
    sampling, num, columns = record["sampling"], len(record["units"]), len(record["columns"])
    if num < FEWEST or (columns > 1 and num - columns < FEWEST_FREE):
        return "not assessed"
    good = sampling["r_hat"] < GOOD_R_HAT
    few = sampling["divergences"] <= FEW_DIVERGENT * sampling["num_draws"]
    return "ok" if good and few else "failed"


def statements(record: Record) -> list[str]:
    """Sentences of a record: how far to trust it first, then what it says."""
    topics = (
        _few_units, _failed, _confounded, _without_logarithm, _trends, _ratio_trends, _runs, _odd,
        _stands, _weak, _saturates, _wrench,
    )  # fmt: skip
    return [sentence for topic in topics for sentence in topic(record)]


def _few_units(record: Record) -> Iterator[str]:
    num, columns = len(record["units"]), record["columns"]
    free = num - len(columns)
    if record["status"] == "not assessed":
        yield messages.mostly_prior(num, free, trend=len(columns) > 1)
    elif free < FEWEST_FREE:
        yield messages.wide_intervals(num, free)
    if record["status"] == "failed":
        sampling = record["sampling"]
        yield messages.not_converged(sampling["r_hat"], sampling["divergences"])


def _failed(record: Record) -> Iterator[str]:
    if failed := record["failed"]:
        yield messages.failed_runs(failed, len(record["units"]))


def _confounded(record: Record) -> Iterator[str]:
    correlation = record["correlation"]
    if correlation is not None and abs(correlation) > TOGETHER:
        yield messages.confounded(correlation)


def _without_logarithm(record: Record) -> Iterator[str]:
    for name, units in record["no_logarithm"].items():
        yield messages.no_logarithm(name, units)


def _trends(record: Record) -> Iterator[str]:
    for name, row in record["parameters"].items():
        slope = row.get("slope_torque")
        if slope is not None and not _holds_zero(slope):
            yield messages.trend(name, slope, rises=slope["q005"] > 0)


def _ratio_trends(record: Record) -> Iterator[str]:
    for name, slope in record["ratios"].items():
        yield messages.ratio_trend(name, slope, depends=not _holds_zero(slope))


def _runs(record: Record) -> Iterator[str]:
    scattering = [
        (name, row["run_scatter"], row["scatter"]["median"])
        for name, row in record["parameters"].items()
        if row["run_scatter"] is not None
    ]
    if scattering:
        yield messages.scatter(scattering)


def _odd(record: Record) -> Iterator[str]:
    limit = ODD / len(record["units"])
    if odd := [name for name, p in record["belongs"].items() if p < limit]:
        yield messages.outliers(odd)


def _stands(record: Record) -> Iterator[str]:
    num, weighed = len(record["units"]), record["weighed"]
    if weighed:
        yield messages.weighed(len(weighed), num, min(weighed.values()))
    if rest := [name for name in record["units"] if name not in weighed]:
        yield messages.approximated(rest)


def _weak(record: Record) -> Iterator[str]:
    weak = [n for n, row in record["parameters"].items() if row["own_over_scatter"] > OWN]
    if weak:
        yield messages.weak(weak, OWN)


def _saturates(record: Record) -> Iterator[str]:
    if (torque := record.get("saturation_torque")) is not None:
        yield messages.saturates(record["saturating"], torque)


def _wrench(record: Record) -> Iterator[str]:
    """Berkson's error of a torque that is set, and the attenuation of one that is read."""
    if TORQUE not in record["columns"]:
        return
    rows = record["parameters"].items()
    name, slope = max(
        ((name, abs(row["slope_torque"]["median"])) for name, row in rows), key=lambda pair: pair[1]
    )
    attenuation = WRENCH**2 / (np.var(np.log(record["torque"])) + WRENCH**2)
    yield messages.wrench(name, WRENCH, WRENCH * slope, float(attenuation))


def _holds_zero(slope: Mapping[str, float]) -> bool:
    """Whether a 99 % interval holds zero."""
    return slope["q005"] <= 0.0 <= slope["q995"]
