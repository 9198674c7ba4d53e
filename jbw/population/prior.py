"""The priors of a population: the variation between units, its trend with torque and sequence."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jbw.errors import DataError

TORQUE = "torque"
ANYWHERE = 5.0  # prior sd of the mean of a logarithm over all units, so wide that it has no effect
# Priors of a logarithm: scale of the half-normal standard deviation between units, and mean and
# standard deviation of its slope on ln torque. Slip limits rise with the preload, and contact
# stiffness rises with the square root of the preload or faster. The slipping part and its loss
# therefore fall with torque to about the power 1; the frequency hardly rises.
SCATTER = {"omega_n": 5e-3, "zeta": 0.3}
SLOPE = {"omega_n": (0.0, 0.05), "zeta": (0.0, 0.5)}
JOINT_SCATTER, JOINT_SLOPE = 0.5, (-1.0, 1.0)
# Mean and standard deviation of the slope for coordinates that are not products of a law's
# parameters; the trend of such a coordinate may have either sign.
PARAMETER_SLOPE = (0.0, 1.0)
# prior standard deviation of a slope on ln of the tightening number, relative to the variation
# between units
BEDDING = 0.3
# prior standard deviation of the difference between the slopes of two products that have the same
# unit of measure (gamma/delta)
ALIKE = 0.3
# standard deviation of ln preload at a given torque, for bolts that are tightened by torque control
WRENCH = 0.1


class Prior(NamedTuple):
    """The priors of all pooled quantities.

    Attributes:
        mean: Prior means of the line's coefficients.
        sd: Prior standard deviations of the line's coefficients.
        tau: Scales of the half-normal priors of the variation between units.
        same_unit: Pairs of coordinates whose ratio hardly depends on torque: products with the same
            unit.
    """

    mean: Float[np.ndarray, "d covariate"]
    sd: Float[np.ndarray, "d covariate"]
    tau: Float[np.ndarray, " d"]
    same_unit: tuple[tuple[int, int], ...] = ()


class CovariateDesign(NamedTuple):
    """The covariates of the units as columns, preceded by a column of ones.

    Attributes:
        columns: Names of the columns: `mean`, then `torque` and `sequence`, as far as they vary.
        x: Columns of every unit: 1, ln(torque / reference), ln(sequence).
        reference: Geometric mean of the torques [N m]; NaN where torque is no covariate.
        saturates: Whether each coordinate follows a saturating curve of the torque, not a power;
            empty where none does.
    """

    columns: tuple[str, ...]
    x: Float[np.ndarray, "unit covariate"]
    reference: float
    saturates: Bool[np.ndarray, " d"] = np.zeros(0, bool)

    def at(self, torque: float | None) -> Float[np.ndarray, " covariate"]:
        """Return the covariates of a unit at its first tightening to the given torque."""
        row = np.zeros(len(self.columns))
        row[0] = 1.0
        if TORQUE in self.columns:
            row[1] = np.log((self.reference if torque is None else torque) / self.reference)
        return row


def design_of(torque: Sequence[float], sequence: Sequence[float]) -> CovariateDesign:
    """Return columns of logarithms of those covariates that vary between the units."""
    columns, x, reference = ["mean"], [np.ones(len(torque))], np.nan
    for name, values in ((TORQUE, np.asarray(torque)), ("sequence", np.asarray(sequence))):
        if np.isnan(values).all() or np.ptp(values[~np.isnan(values)]) == 0.0:
            continue
        if np.isnan(values).any() or (values <= 0.0).any():
            raise DataError(
                f"Every unit or no unit must state a positive {name}; the values are "
                f"{', '.join(f'{value:g}' for value in values)}.",
                remedy=f"State a positive `{name}` in [assembly] of every campaign, or with "
                "`jbw collect --covariates`.",
            )
        middle = np.exp(np.mean(np.log(values))) if name == TORQUE else 1.0
        reference = float(middle) if name == TORQUE else reference
        columns.append(name)
        x.append(np.log(values / middle))
    return CovariateDesign(tuple(columns), np.column_stack(x), reference)


def prior_of(
    names: Sequence[str],
    products: Mapping[str, str],
    mean: Float[np.ndarray, "unit d"],
    design: CovariateDesign,
) -> Prior:
    """Return a population's priors, from general knowledge of joints; the mean's prior is wide.

    Args:
        names: Names of the coordinates.
        products: Names of coordinates that may be products of a law's parameters, with their units.
        mean: Mean of every unit's posterior.
        design: Covariates of the units.
    """
    tau = np.array([SCATTER.get(name, JOINT_SCATTER) for name in names])
    middle, spread = [mean.mean(0)], [np.full(len(names), ANYWHERE)]
    for column in design.columns[1:]:
        if column == TORQUE:
            other = {name: JOINT_SLOPE for name in products}
            pairs = [SLOPE.get(n, other.get(n, PARAMETER_SLOPE)) for n in names]
            middle.append(np.array([pair[0] for pair in pairs]))
            spread.append(np.array([pair[1] for pair in pairs]))
        else:
            middle.append(np.zeros(len(names)))
            spread.append(BEDDING * tau)
    by_unit = [(i, products[name]) for i, name in enumerate(names) if name in products]
    same_unit = tuple(
        (i, j) for (i, first), (j, second) in combinations(by_unit, 2) if first == second
    )
    return Prior(np.column_stack(middle), np.column_stack(spread), tau, same_unit)


def precision_of(
    prior: Prior, design: CovariateDesign
) -> Float[np.ndarray, "coefficient coefficient"]:
    """Return the prior precision of the coefficients of a population's trend line."""
    d, p = prior.sd.shape
    precision = np.diag(np.ravel(prior.sd) ** -2.0)
    if TORQUE in design.columns:
        j = design.columns.index(TORQUE)
        for first, second in prior.same_unit:
            apart = np.zeros(d * p)
            apart[[second * p + j, first * p + j]] = 1.0, -1.0
            precision += np.outer(apart, apart) / ALIKE**2
    return precision
