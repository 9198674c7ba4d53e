"""`jbw.population_of`: what a fleet says of its units, of their scatter and of their trends."""

import logging
from collections.abc import Callable, Sequence
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
from jbw.population.prior import TORQUE, CovariateDesign, Prior, design_of, prior_of
from jbw.population.record import Pooling, own_over_scatter, record_of
from jbw.population.statements import OWN, statements
from jbw.population.trend import mask_of
from jbw.report.messages import population as messages

logger = logging.getLogger("jbw")
Report = Callable[[str], None]


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
