"""The identifiability of parameters, from the fit and, after sampling, from posterior draws."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import jax
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jbw.campaign.load import Campaign
from jbw.campaign.settings import Identify
from jbw.identification.assemble import Report, measured_in
from jbw.identification.coordinates import combinations
from jbw.identification.prepare import Fitted, fit_joint
from jbw.inference.fit.fitting import Fit
from jbw.inference.fit.identifiability import (
    Sensitivity,
    box_sensitivity,
    contraction,
    sensitivity_statements,
)
from jbw.inference.fit.profiles import (
    Information,
    Profile,
    directions_sentence,
    information,
    profile_statements,
    profiles,
    statements,
    ties,
)
from jbw.inference.space.box import Product, alone, require_float64, value_of
from jbw.inference.space.stated import as_wide
from jbw.observables.dataset import stacked
from jbw.report.messages import identified
from jbw.results.run import StoredIdentifiability
from jbw.results.stored import finite

logger = logging.getLogger("jbw")
# A start has found the optimum if its final cost exceeds the lowest by less than this fraction.
REACHED = 0.01
# A difference of cost below this (0.1 in chi-square) is no reason to prefer one of two optima.
NOTHING = 0.05
# a column of the result: dimensions, values, unit
Column = tuple[str | tuple[str, str], Any, str]


@dataclass(frozen=True)
class Identifiability:
    """The accuracy with which the data determine each parameter and each product of parameters."""

    fitted: Fitted  # the fit and the data to which it was fitted
    # Products of parameters, examined like the parameters themselves.
    products: tuple[Product, ...]
    # what the data determine before sampling: combinations, parameters and products
    information: Information
    profiles: dict[str, Profile]  # profile of every parameter, if profiles were requested
    # Only after sampling: 1 - posterior / prior variance, and the change of each mean when
    # the prior range shrinks by a tenth.
    contraction: dict[str, float] = field(default_factory=dict)
    sensitivity: dict[str, Sensitivity] = field(default_factory=dict)
    statements: tuple[str, ...] = ()  # sentences that state the results of the analysis

    def summary(self) -> dict[str, Any]:
        """Return the result as plain values for `summary.json`; unknown numbers are None."""
        return self.stored().plain()

    def stored(self) -> StoredIdentifiability:
        """Return the result in the form in which a run's summary stores it."""
        costs, names = self.fitted.fit.waterfall, self.information.names
        facts = ("value", "sd", "relative", "ratio")
        rows = {
            name: {"text": row.text, **{fact: finite(getattr(row, fact)) for fact in facts}}
            for name, row in self.information.known.items()
        }
        spectrum = [
            {
                "combination": direction.text,
                "information": direction.information,
                "ratio": direction.ratio,
                "sd": finite(direction.sd),
                "loadings": dict(zip(names, direction.loadings.tolist(), strict=True)),
            }
            for direction in self.information.directions
        ]
        parts = ("interval", "open", "values", "chi_square")
        followed = {
            name: {part: np.asarray(getattr(profile, part)).tolist() for part in parts}
            for name, profile in self.profiles.items()
        }
        record = {
            "statements": list(self.statements),
            "spectrum": spectrum,
            "parameters": {name: rows[name] for name in names},
            "combinations": {product.name: rows[product.name] for product in self.products},
            "contraction": {name: finite(value) for name, value in self.contraction.items()},
            "box_sensitivity": {
                name: {**asdict(move), "shift": finite(move.shift)}
                for name, move in self.sensitivity.items()
            },
            "profiles": followed,
            "waterfall": {"costs": [finite(cost) for cost in costs], "reached": reached(costs)},
        }
        return StoredIdentifiability.read(record)


def identifiability(
    campaign: Campaign,
    *,
    profiles: bool = False,
    seed: int | None = None,
    report: Report = logger.info,
) -> Identifiability:
    """Fit the joint to a campaign and report how well data constrain parameters, without sampling.

    Args:
        campaign: A campaign from `jbw.load_campaign` or the virtual rig.
        profiles: Whether to compute the profile of every parameter too.
        seed: Seed of the starts; when None that of the campaign, or 0.
        report: A function that is called with one sentence at every stage.

    Raises:
        ConfigError: The session is in float32, or settings do not fit the tests.
        DataError: The joint cannot be fitted to the tests.

    Examples:
        Two strong sweeps determine every direction of the parameters:

        >>> import jbw; jbw.enable_x64()
        >>> campaign = jbw.rig.measure(tests=["sweep_0p20V"], repeats=2, fs=256.0, noise_ratio=0.02)
        >>> found = jbw.identifiability(campaign)
        >>> print(found.statements[0])
        The data constrain 6 of 6 combinations of the parameters more tightly than the prior does.
    """
    require_float64()
    seen = measured_in(campaign, report)
    # The identifiability is stated for the parameters that Teloli et al. use.
    seen = replace(seen, settings=seen.settings.model_copy(update={"coordinates": "paper"}))
    key = jax.random.key(campaign.settings.seed if seed is None else seed)
    return look(fit_joint(key, seen, report), with_profiles=profiles, report=report)


def look(fitted: Fitted, *, with_profiles: bool, report: Report = logger.info) -> Identifiability:
    """Return the precision of a fit's parameters and of their products, before sampling."""
    products = combinations(fitted.box.names, fitted.data.laws)
    before = information(_of_data(fitted), as_wide(fitted.box, fitted.data.stated), products)
    followed: dict[str, Profile] = {}
    if with_profiles:
        followed = profiles(stacked, fitted.box, fitted.data, fitted.fit, report=report)
    sentences = [
        *fitted.statements,
        *statements(before, products),
        *profile_statements(followed),
        _waterfall(fitted.fit.waterfall),
    ]
    return Identifiability(fitted, products, before, followed, statements=tuple(sentences))


def _of_data(fitted: Fitted) -> Fit:
    """Return a fit without those residuals and derivatives that come from stated priors."""
    size = len(fitted.fit.residual) - len(fitted.data.stated.names)
    fit = fitted.fit
    return replace(fit, residual=fit.residual[:size], jacobian=fit.jacobian[:size])


def look_again(
    fitted: Fitted, posterior: xr.Dataset, settings: Identify, report: Report = logger.info
) -> Identifiability:
    """Return the precision of each parameter in the fit and in the posterior draws."""
    before = look(fitted, with_profiles=settings.profiles, report=report)
    box, products = fitted.box, before.products
    draws = {name: posterior[name].values for name in box.names}
    looked_at = (*map(alone, box.names), *products)
    narrowed = contraction(draws, as_wide(box, fitted.data.stated), looked_at)
    values = {product.name: value_of(product, draws) for product in looked_at}
    sensitivity = box_sensitivity(values, box)
    texts = {product.name: product.text for product in looked_at}
    # After sampling, posterior draws decide which parameters are determined.
    sentences = [
        *fitted.statements,
        directions_sentence(before.information),
        *ties(before.information, products),
        *profile_statements(before.profiles),
        _waterfall(fitted.fit.waterfall),
        *sensitivity_statements(sensitivity, texts),
    ]
    return replace(
        before, contraction=narrowed, sensitivity=sensitivity, statements=tuple(sentences)
    )


def reached(costs: NDArray[np.float64]) -> int:
    """Count the starts of a fit that reached the lowest cost (to 1 % or to numerical noise)."""
    lowest = float(np.min(costs))
    return int(np.sum(costs <= lowest + max(REACHED * lowest, NOTHING)))


def _waterfall(costs: NDArray[np.float64]) -> str:
    return identified.waterfall(len(costs), reached(costs))


def as_group(found: Identifiability) -> xr.Dataset:
    """Return the numbers on identifiability as the group /identifiability of a run's result.

    Shorter profiles end with NaN.
    """
    directions, names = found.information.directions, list(found.information.names)
    products = [product.name for product in found.products]
    texts, power, ratio, loadings = (
        [getattr(direction, fact) for direction in directions]
        for fact in ("text", "information", "ratio", "loadings")
    )
    columns: dict[str, Column] = {
        "direction_text": ("direction", texts, ""),
        "direction_information": ("direction", power, "1"),
        "direction_ratio": ("direction", ratio, "1"),
        "loadings": (("direction", "parameter"), loadings, "1"),
        "cost": ("start", found.fitted.fit.waterfall, "1"),
    }
    columns |= _rows(found, "parameter", names)
    columns |= _rows(found, "combination", products)
    columns |= _profile_columns(found.profiles, names)
    variables = {
        name: (dims, np.asarray(values), {"units": units, "long_name": _meaning(name)})
        for name, (dims, values, units) in columns.items()
    }
    coords = {"parameter": names, "combination": products}
    return xr.Dataset(variables, {name: labels for name, labels in coords.items() if labels})


def _meaning(column: str) -> str:
    return identified.COLUMNS.get(column) or identified.COLUMNS[column.partition("_")[2]]


def _rows(answer: Identifiability, dim: str, names: Sequence[str]) -> dict[str, Column]:
    if not names:
        return {}
    knowledge = [answer.information.known[name] for name in names]
    rows = {
        "relative": [row.relative for row in knowledge],
        "ratio": [row.ratio for row in knowledge],
    }
    if answer.contraction:
        rows["contraction"] = [answer.contraction[name] for name in names]
        rows["shift"] = [answer.sensitivity[name].shift for name in names]
    return {f"{dim}_{what}": (dim, values, "1") for what, values in rows.items()}


def _profile_columns(profiles: Mapping[str, Profile], names: Sequence[str]) -> dict[str, Column]:
    if not profiles:
        return {}
    longest = max(len(profile.values) for profile in profiles.values())
    values, rise = np.full((2, len(names), longest), np.nan)
    for i, profile in enumerate(profiles[name] for name in names):
        values[i, : len(profile.values)] = profile.values
        rise[i, : len(profile.values)] = profile.chi_square
    interval = [profiles[name].interval for name in names]
    dims, unit = ("parameter", "point"), "unit of the parameter"
    return {
        "profile_value": (dims, values, unit),
        "profile_chi_square": (dims, rise, "1"),
        "profile_interval": (("parameter", "end"), interval, unit),
    }
