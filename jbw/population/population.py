"""`jbw.population_of`: what a fleet says of its units, of their scatter and of their trends.

What a population states are sentences of the catalogue, with the numbers of its record.
"""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray as xr

from jbw.errors import ConfigError, DataError
from jbw.inference.space.box import require_float64
from jbw.oscillator.laws import laws_named
from jbw.population.belonging import belonging
from jbw.population.coordinates import Pooled, laws_of, pooled, units_of_fleet
from jbw.population.model import FULL, ROUGH, sampler
from jbw.population.prior import TORQUE, WRENCH, CovariateDesign, Prior, design_of, prior_of
from jbw.population.record import FEWEST_FREE, Pooling, own_over_scatter, record_of
from jbw.population.trend import mask_of
from jbw.report.messages import population
from jbw.report.messages import population as messages

logger = logging.getLogger("jbw")
Report = Callable[[str], None]
ODD = 0.01  # probability, over the number of units, from which one does not belong
OWN = 2.0  # a unit's own error over the scatter, above which its normal summary stands for it
TOGETHER = 0.95  # correlation of torque and number of the tightening that hides one by the other
Record = Mapping[str, Any]


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
    design: CovariateDesign
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
    failed = [str(name) for name in root["unit"].values[root["verdict"].values == "failed"]]
    if len(failed) > num / 2 and not all_verdicts:
        raise DataError(
            f"{len(failed)} of {num} runs failed: {', '.join(failed)}.",
            why="What a failed run says of its unit must not be used.",
            remedy="Mend them first (jbw explain), or pool them all the same with --all-verdicts.",
        )
    coordinates = pooled(fleet, parameters)
    design = covariates_in(fleet)
    design = design._replace(saturates=mask_of(saturating, coordinates.names, design.columns))
    laws = laws_named(laws_of(fleet))
    products = {product.name: product.quantity.unit for law in laws for product in law.products}
    prior = prior_of(coordinates.names, products, coordinates.mean, design)
    units, key, every = units_of_fleet(fleet, coordinates), jax.random.key(seed), np.ones(num)
    if not summaries:
        report(messages.scatter_stage(num))
        rough = sampler(units, design, prior, ROUGH)(key, every)
        units = units._replace(weighed=own_over_scatter(coordinates, rough).max(axis=1) <= OWN)
    report(messages.sampling_stage(num, int(units.weighed.sum())))
    draws = sampler(units, design, prior, FULL)(key, every)
    belongs = belonging(key, units, design, prior, draws, report)
    record = record_of(fleet, Pooling(coordinates, units, design, prior, draws), belongs)
    record["statements"] = statements(record)
    return Population(coordinates, design, prior, draws, record)


def covariates_in(fleet: xr.DataTree) -> CovariateDesign:
    """Covariates that vary between the units of a fleet."""
    root = fleet.to_dataset()
    return design_of(root["torque"].values.tolist(), root["sequence"].values.tolist())


def require_torque(design: CovariateDesign, torque: float | None) -> None:
    """Refuse a torque that no trend is known for."""
    if torque is None:
        return
    if not torque > 0.0:
        raise ConfigError(f"A torque must be above zero, but is {torque:g} N m.")
    if TORQUE not in design.columns:
        raise DataError(
            "All units of the fleet have one torque, or state none: no trend with it is known.",
            remedy="Collect units of several torques, or leave --torque out.",
        )


def statements(record: Record) -> list[str]:
    """Sentences of a record: how far to trust it first, then what it says."""
    topics = (_few_units, _failed, _confounded, _no_logarithm, _trends, _ratios, _runs, _odd,
              _stands, _weak, _saturates, _wrench)  # fmt: skip
    return [sentence for topic in topics for sentence in topic(record)]


def _few_units(record: Record) -> Iterator[str]:
    num, columns = len(record["units"]), record["columns"]
    free = num - len(columns)
    if record["status"] == "not assessed":
        yield population.mostly_prior(num, free, trend=len(columns) > 1)
    elif free < FEWEST_FREE:
        yield population.wide_intervals(num, free)
    if record["status"] == "failed":
        sampling = record["sampling"]
        yield population.not_converged(sampling["r_hat"], sampling["divergences"])


def _failed(record: Record) -> Iterator[str]:
    if failed := record["failed"]:
        yield population.failed_runs(failed, len(record["units"]))


def _confounded(record: Record) -> Iterator[str]:
    correlation = record["correlation"]
    if correlation is not None and abs(correlation) > TOGETHER:
        yield population.confounded(correlation)


def _no_logarithm(record: Record) -> Iterator[str]:
    for name, units in record["no_logarithm"].items():
        yield population.no_logarithm(name, units)


def _trends(record: Record) -> Iterator[str]:
    for name, row in record["parameters"].items():
        slope = row.get("slope_torque")
        if slope is not None and not _holds_zero(slope):
            yield population.trend(name, slope, rises=slope["q005"] > 0)


def _ratios(record: Record) -> Iterator[str]:
    for name, slope in record["ratios"].items():
        yield population.ratio_trend(name, slope, depends=not _holds_zero(slope))


def _runs(record: Record) -> Iterator[str]:
    scattering = [
        (name, row["run_scatter"], row["scatter"]["median"])
        for name, row in record["parameters"].items()
        if row["run_scatter"] is not None
    ]
    if scattering:
        yield population.scatter(scattering)


def _odd(record: Record) -> Iterator[str]:
    limit = ODD / len(record["units"])
    if odd := [name for name, p in record["belongs"].items() if p < limit]:
        yield population.outliers(odd)


def _stands(record: Record) -> Iterator[str]:
    num, weighed = len(record["units"]), record["weighed"]
    if weighed:
        yield population.weighed(len(weighed), num, min(weighed.values()))
    if rest := [name for name in record["units"] if name not in weighed]:
        yield population.approximated(rest)


def _weak(record: Record) -> Iterator[str]:
    weak = [n for n, row in record["parameters"].items() if row["own_over_scatter"] > OWN]
    if weak:
        yield population.weak(weak, OWN)


def _saturates(record: Record) -> Iterator[str]:
    if (torque := record.get("saturation_torque")) is not None:
        yield population.saturates(record["saturating"], torque)


def _wrench(record: Record) -> Iterator[str]:
    """Berkson's error of a torque that is set, and the attenuation of one that is read."""
    if TORQUE not in record["columns"]:
        return
    rows = record["parameters"].items()
    name, slope = max(
        ((name, abs(row["slope_torque"]["median"])) for name, row in rows), key=lambda pair: pair[1]
    )
    attenuation = WRENCH**2 / (np.var(np.log(record["torque"])) + WRENCH**2)
    yield population.wrench(name, WRENCH, WRENCH * slope, float(attenuation))


def _holds_zero(slope: Mapping[str, float]) -> bool:
    """Whether a 99 % interval holds zero."""
    return slope["q005"] <= 0.0 <= slope["q995"]
