"""In which logarithms a fleet is pooled, and how units are found again from them."""

import json
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.errors import ConfigError, DataError, did_you_mean
from jbw.oscillator.law import Law
from jbw.oscillator.laws import laws_named
from jbw.population.model import Units

STRUCTURE = ("omega_n", "zeta")
GAIN = "gain"  # the source's, no coordinate of a joint
NUM_KEPT = 400  # draws of a unit, evenly from its own
CUT = 0.01  # of a unit's posterior beyond the bounds of its prior, from which it is not pooled


class Pooled(NamedTuple):
    """What is pooled of a fleet.

    Attributes:
        names: The coordinates, of whose logarithms the population is made.
        mean: Of each unit's own posterior.
        cov: Its covariance.
        powers: Each coordinate's exponents of the parameters, the rows by which logarithms add up.
        parameters: Their names: of the structure and of the laws.
    """

    names: tuple[str, ...]
    mean: Float[np.ndarray, "unit coordinate"]
    cov: Float[np.ndarray, "unit coordinate coordinate"]
    powers: Float[np.ndarray, "coordinate parameter"]
    parameters: tuple[str, ...]


def unit_names(fleet: xr.DataTree) -> list[str]:
    """Names of the units, in order."""
    return [str(one) for one in fleet.to_dataset()["unit"].values]


def pooled(fleet: xr.DataTree, names: Sequence[str] | None = None) -> Pooled:
    """The coordinates of a fleet: those named, else of the structure and what weak motion knows.

    Of a law its products, which are known where its parameters trade, and the parameters that are
    in none of them.

    Raises:
        ConfigError: A name that the fleet does not have.
        DataError: One that some units do not know, or whose posterior the prior cuts.
    """
    laws = laws_named(json.loads(fleet.attrs["laws"]))
    held = [str(name) for name in fleet.coords["parameter"].values]
    parameters = (*STRUCTURE, *(name for law in laws for name in law.names()))
    if names is None:
        names = [*STRUCTURE, *(name for law in laws for name in _known_of(law))]
    lacking = json.loads(fleet.attrs["left_out"])
    for name in names:
        if name in lacking:
            raise DataError(
                f"{name} has no logarithm in {', '.join(lacking[name])}: not known, or not "
                "positive.",
                remedy="Pool others with --parameters, or leave these units out.",
            )
        if name not in held:
            raise ConfigError(
                f"The fleet holds no {name}.",
                remedy=f"{did_you_mean(name, held)}It holds {', '.join(held)}.",
            )
    root = fleet.to_dataset()
    for name in names:
        cut = root["unit"].values[root["beyond"].sel(parameter=name).values > CUT]
        if len(cut):
            raise DataError(
                f"The prior cuts the posterior of {name} in {', '.join(map(str, cut))}.",
                why="A posterior that ends at a bound is no normal one, and pooling would take the "
                "bound for knowledge.",
                remedy=f"Widen [identify.prior] {name} of their campaigns and identify them again.",
            )
    known = {one.name: dict(one.powers) for law in laws for one in law.products}
    rows = [known.get(name, {name: 1}) for name in names]
    powers = np.array([[float(row.get(one, 0)) for one in parameters] for row in rows])
    mean = root["mean"].sel(parameter=list(names)).values
    cov = root["covariance"].sel(parameter=list(names), other=list(names)).values
    return Pooled(tuple(names), mean, cov, powers, parameters)


def _known_of(law: type[Law]) -> list[str]:
    factors = {name for one in law.products for name in one.powers}
    return [*(one.name for one in law.products), *(n for n in law.names() if n not in factors)]


def units_of_fleet(fleet: xr.DataTree, found: Pooled) -> Units:
    """Summaries and draws of every unit in the pooled coordinates, none of them weighed yet.

    A run's prior is uniform in what it sampled: over logarithms its density is their product.
    """
    lower = fleet.to_dataset()["lower"]
    draws, log_prior = [], []
    for name in unit_names(fleet):
        logs = fleet[name].to_dataset()["draws"]
        every = logs.values[np.linspace(0, logs.sizes["draw"] - 1, NUM_KEPT).astype(int)]
        logs = dict(zip(map(str, logs["parameter"].values), every.T, strict=True))
        sampled = lower["parameter"].values[~np.isnan(lower.sel(unit=name).values)]
        draws.append(np.stack([logs[each] for each in found.names], axis=-1))
        log_prior.append(sum(logs[str(one)] for one in sampled if one != GAIN))
    shape = len(draws), NUM_KEPT
    prior = np.broadcast_to(np.stack([np.broadcast_to(one, NUM_KEPT) for one in log_prior]), shape)
    return Units(found.mean, found.cov, np.stack(draws), prior, np.zeros(len(draws), bool))
