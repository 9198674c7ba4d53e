"""The logarithmic coordinates in which a fleet is pooled, and each unit's posterior in them."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.errors import ConfigError, DataError, did_you_mean
from jbw.oscillator.law import Law
from jbw.oscillator.laws import laws_named
from jbw.population.model import UnitPosteriors
from jbw.population.unit import GAIN
from jbw.results.attributes import StoredFleet

STRUCTURE = ("omega_n", "zeta")
NUM_KEPT = 400  # number of draws that are kept of each unit, evenly spaced among all its draws
# A unit is not pooled if more than this fraction of its posterior lies beyond the prior's bounds.
CUT = 0.01
# A coordinate is pooled in addition to the products of a law if the standard deviation of the
# coordinate's logarithm is less than this value in every unit.
KNOWN = 0.2

Rows = Float[np.ndarray, "coordinate parameter"]


class Pooled(NamedTuple):
    """The quantities in which a fleet is pooled, with their mean and covariance for each unit.

    Attributes:
        names: Coordinates, whose logarithms have the population's distribution.
        mean: Mean of each unit's own posterior.
        cov: Covariance of each unit's own posterior.
        powers: Exponents of the parameters in each coordinate; logarithms add up by these rows.
        parameters: Names of the parameters of the structure and of the laws.
        common: Exponents of the laws' remaining coordinates, which have one value at every torque.
            For Bouc-Wen's law this is its share of the stiffness, where no unit determines it.
    """

    names: tuple[str, ...]
    mean: Float[np.ndarray, "unit coordinate"]
    cov: Float[np.ndarray, "unit coordinate coordinate"]
    powers: Rows
    parameters: tuple[str, ...]
    common: Rows


def unit_names(fleet: xr.DataTree) -> list[str]:
    """Return the names of the units of a fleet, in order."""
    return [str(name) for name in fleet.to_dataset()["unit"].values]


def parameters_of(fleet: xr.DataTree) -> tuple[str, ...]:
    """Return the names of the parameters of the structure and of the fleet's laws."""
    laws = laws_named(laws_of(fleet))
    return (*STRUCTURE, *(name for law in laws for name in law.names()))


def pooled(fleet: xr.DataTree, names: Sequence[str] | None = None) -> Pooled:
    """Return a fleet's pooled quantities: the named ones, or all that every unit determines.

    The usual coordinates of a law are its products, which the data determine where parameters
    trade; the parameters that are in no product; and further coordinates where every unit
    determines those too.

    Raises:
        ConfigError: The fleet has no quantity of that name.
        DataError: Some units do not determine a named quantity, or the prior cuts its posterior.
    """
    parameters = parameters_of(fleet)
    names = _usual(fleet, parameters) if names is None else list(names)
    for name in names:
        _require_held(fleet, name)
    for name in names:
        _require_whole(fleet, name)
    root = fleet.to_dataset()
    powers = rows_of(laws_of(fleet), names, parameters)
    common = list(_independent_of(fleet, powers, parameters))
    return Pooled(
        tuple(names),
        root["mean"].sel(parameter=names).values,
        root["covariance"].sel(parameter=names, other=names).values,
        powers,
        parameters,
        rows_of(laws_of(fleet), common, parameters),
    )


def laws_of(fleet: xr.DataTree) -> tuple[str, ...]:
    """Return the names of the fleet's laws."""
    return StoredFleet.of(fleet).laws


def monomials_of(laws: Sequence[str]) -> dict[str, Mapping[str, float]]:
    """Return the exponents of the parameters in each product and coordinate of given laws."""
    return {
        monomial.name: monomial.powers
        for law in laws_named(laws)
        for monomial in (
            *law.products,
            *(m for coordinate in law.coordinates.values() for m in coordinate.inverse),
        )
    }


def rows_of(laws: Sequence[str], names: Sequence[str], parameters: Sequence[str]) -> Rows:
    """Return the exponents of the parameters in each named quantity, as rows of a matrix."""
    powers = monomials_of(laws)
    rows = [
        [powers.get(name, {name: 1}).get(parameter, 0) for parameter in parameters]
        for name in names
    ]
    return np.array(rows, float).reshape(len(names), len(parameters))


def _usual(fleet: xr.DataTree, parameters: Sequence[str]) -> list[str]:
    laws = laws_named(laws_of(fleet))
    names = [*STRUCTURE, *(name for law in laws for name in _identifiable_of(law))]
    root = fleet.to_dataset()
    held = {str(name) for name in root["parameter"].values}
    for name in _independent_of(fleet, rows_of(laws_of(fleet), names, parameters), parameters):
        if name in held:
            variance = root["covariance"].sel(parameter=name, other=name).values
            if np.sqrt(variance.max()) < KNOWN:
                names.append(name)
    return names


def _independent_of(fleet: xr.DataTree, powers: Rows, parameters: Sequence[str]) -> Iterator[str]:
    """Yield coordinates of the laws that are independent of given ones and of each other."""
    for name in monomials_of(laws_of(fleet)):
        longer = np.concatenate([powers, rows_of(laws_of(fleet), [name], parameters)])
        if np.linalg.matrix_rank(longer) > np.linalg.matrix_rank(powers):
            yield name
            powers = longer


def _require_held(fleet: xr.DataTree, name: str) -> None:
    held = [str(parameter) for parameter in fleet.coords["parameter"].values]
    if lacking := StoredFleet.of(fleet).left_out.get(name):
        raise DataError(
            f"{name} has no logarithm in {', '.join(lacking)}: it is unknown or not positive.",
            remedy=f"Pool quantities other than {name} with --parameters, or leave out "
            f"{', '.join(lacking)}.",
        )
    if name not in held:
        raise ConfigError(
            f"The fleet has no {name}.",
            remedy=f"{did_you_mean(name, held)}The fleet has {', '.join(held)}.",
        )


def _require_whole(fleet: xr.DataTree, name: str) -> None:
    cut, by = cut_of(fleet, name)
    units = [unit for unit, far in zip(unit_names(fleet), cut, strict=True) if far > CUT]
    if units:
        bounds = ", ".join(dict.fromkeys(by[cut > CUT].tolist()))
        raise DataError(
            f"The prior cuts the posterior of {name} in {', '.join(units)}.",
            why="A posterior that ends at a bound is not normal, and pooling would treat the bound "
            "as data.",
            remedy=f"Widen [identify.prior] {bounds} in the campaigns of {', '.join(units)}, and "
            "identify these campaigns again.",
        )


def cut_of(fleet: xr.DataTree, name: str) -> tuple[Float[np.ndarray, " unit"], Any]:
    r"""Return the fraction of each unit's posterior that a prior cuts off, and the prior's name.

    For a quantity that was not sampled itself, it is the part cut from each sampled parameter,
    times the share $\rho^2$ of the quantity's variance that this parameter explains. A product is
    thus not cut where its factors trade up to their bounds.
    """
    root = fleet.to_dataset()
    beyond, whole = root["beyond"], root["covariance"]
    beyond_sampled = beyond.sel(parameter=name).values
    covariance = whole.sel(parameter=name).values
    variance = np.diagonal(whole.values, axis1=1, axis2=2)
    product = whole.sel(parameter=name, other=name).values[:, None] * variance
    through = np.nan_to_num(beyond.values) * covariance**2 / np.where(product > 0, product, np.inf)
    by = root["parameter"].values.astype(str)[through.argmax(axis=1)]
    sampled = ~np.isnan(beyond_sampled)
    return np.where(sampled, beyond_sampled, through.max(axis=1)), np.where(sampled, name, by)


def _identifiable_of(law: type[Law]) -> list[str]:
    factors = {name for product in law.products for name in product.powers}
    return [
        *(product.name for product in law.products),
        *(n for n in law.names() if n not in factors),
    ]


def units_of_fleet(fleet: xr.DataTree, pooled_coordinates: Pooled) -> UnitPosteriors:
    r"""Return the posteriors of all units of a fleet, expressed in its pooled quantities.

    A run's prior is uniform in the sampled parameters, so that over their logarithms its density is
    their product. A normal summary is freed from it in closed form, over the logarithms of all
    sampled parameters,

    $$N(m, C) / e^{1^T \varphi} \propto N(m - C 1, C)$$

    The prior remains for the gain of the source and for quantities without a logarithm in the
    fleet.
    """
    root = fleet.to_dataset()
    parameters = root["parameter"].values.astype(str)
    sampled = ~np.isnan(root["lower"].values) & (parameters != GAIN)
    covariance = root["covariance"].sel(parameter=list(pooled_coordinates.names)).values
    mean = pooled_coordinates.mean - np.einsum("kij,kj->ki", covariance, sampled)
    draws, log_prior = [], []
    for name, is_sampled in zip(unit_names(fleet), sampled, strict=True):
        logs = fleet[name].to_dataset()["draws"].sel(parameter=parameters)
        every = logs.isel(draw=np.linspace(0, logs.sizes["draw"] - 1, NUM_KEPT).astype(int))
        draws.append(every.sel(parameter=list(pooled_coordinates.names)).values)
        log_prior.append(every.values @ is_sampled)
    weighed = np.zeros(len(draws), bool)
    return UnitPosteriors(
        mean, pooled_coordinates.cov, np.stack(draws), np.stack(log_prior), weighed
    )
