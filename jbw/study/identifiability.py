"""Which parameters the data know: before sampling by the fit, afterwards by the draws too."""

import logging
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jbw.campaign.load import Campaign, force_per_unit
from jbw.campaign.settings import Identify
from jbw.identification.assemble import measured
from jbw.identification.coordinates import combinations
from jbw.identification.prepare import Fitted, fit_joint
from jbw.identification.procedure import Identification, Report
from jbw.inference.fit.identifiability import (
    Sensitivity,
    box_sensitivity,
    contraction,
    listed,
    sensitivity_statements,
)
from jbw.inference.fit.information import Information, information, statements
from jbw.inference.fit.profiles import Profile, profile_statements, profiles
from jbw.inference.space.box import Product, alone, require_float64, value_of
from jbw.observables.dataset import stacked

logger = logging.getLogger("jbw")
NARROWED = 0.5  # of the prior's variance
REACHED = 0.01  # of the best cost: a start that came so near found the optimum
NOTHING = 0.05  # of cost: a difference of chi-square of 0.1 prefers neither


@dataclass(frozen=True)
class Identifiability:
    """Which parameters and products the data know.

    Attributes:
        fitted: The fit and what it was fitted to.
        products: Combinations that are looked at beside the parameters.
        information: Spectrum of the information, before sampling.
        profiles: Profile of every parameter, where they were asked for.
        contraction: After sampling: 1 less the variance over the prior's, by name.
        sensitivity: After sampling: what a tenth less of the box does to every mean.
        statements: All of it in words.
    """

    fitted: Fitted
    products: tuple[Product, ...]
    information: Information
    profiles: dict[str, Profile]
    contraction: dict[str, float] = field(default_factory=dict)
    sensitivity: dict[str, Sensitivity] = field(default_factory=dict)
    statements: tuple[str, ...] = ()

    def summary(self) -> dict[str, Any]:
        """Plain values, as under `identifiability` in summary.json; None for what is not known."""
        costs, names = self.fitted.fit.waterfall, self.information.names
        facts = ("value", "sd", "relative", "ratio")
        rows = {
            name: {"text": row.text, **{fact: plain(getattr(row, fact)) for fact in facts}}
            for name, row in self.information.known.items()
        }
        spectrum = [
            {
                "combination": each.text,
                "information": each.information,
                "ratio": each.ratio,
                "sd": plain(each.sd),
                "loadings": dict(zip(names, each.loadings.tolist(), strict=True)),
            }
            for each in self.information.directions
        ]
        followed = {
            name: {
                "interval": list(each.interval),
                "open": list(each.open),
                "values": each.values.tolist(),
                "chi_square": each.chi_square.tolist(),
            }
            for name, each in self.profiles.items()
        }
        return {
            "statements": list(self.statements),
            "spectrum": spectrum,
            "parameters": {name: rows[name] for name in names},
            "combinations": {each.name: rows[each.name] for each in self.products},
            "contraction": {name: plain(value) for name, value in self.contraction.items()},
            "box_sensitivity": {
                name: {**asdict(each), "shift": plain(each.shift)}
                for name, each in self.sensitivity.items()
            },
            "profiles": followed,
            "waterfall": {"costs": [plain(cost) for cost in costs], "reached": reached(costs)},
        }


def plain(value: float) -> float | None:
    """A number for JSON; None where it is not known or infinite."""
    return float(value) if np.isfinite(value) else None


def identifiability(
    campaign: Campaign,
    *,
    profiles: bool = False,
    seed: int | None = None,
    report: Report = logger.info,
) -> Identifiability:
    """Fit the joint to a campaign and say what the data know of it, without sampling.

    Args:
        campaign: From `jbw.load_campaign` or the virtual rig.
        profiles: Whether to follow the profile of every parameter too.
        seed: Seed of the starts; the campaign's, or 0, when None.
        report: Called with one sentence at every stage.

    Returns:
        The information spectrum, the profiles, and both in words.

    Raises:
        ConfigError: A float32 session, or settings that do not fit the tests.
        DataError: Tests that the joint cannot be fitted to.
    """
    require_float64()
    gain = force_per_unit(campaign)
    seen = measured(campaign.tests, campaign.settings, laws=campaign.laws, gain=gain, report=report)
    seed = campaign.settings.seed if seed is None else seed
    fitted = fit_joint(seen, seed=seed, report=report)
    return look(fitted, with_profiles=profiles, report=report)


def look(fitted: Fitted, *, with_profiles: bool, report: Report = logger.info) -> Identifiability:
    """What a fit says before sampling."""
    products = combinations(fitted.box.names, fitted.data.laws)
    found = information(fitted.fit, fitted.box, products)
    followed: dict[str, Profile] = {}
    if with_profiles:
        followed = profiles(stacked, fitted.box, fitted.data, fitted.fit, report=report)
    said = [
        *fitted.statements,
        *statements(found, products),
        *profile_statements(followed),
        _waterfall_words(fitted.fit.waterfall),
    ]
    return Identifiability(fitted, products, found, followed, statements=tuple(said))


def look_again(
    found: Identification, settings: Identify, report: Report = logger.info
) -> Identifiability | None:
    """What the fit said and what the draws say of the main posterior; None if it is no joint's."""
    fitted = found.fitted
    if fitted is None:
        return None
    before = look(fitted, with_profiles=settings.profiles, report=report)
    box, products = fitted.box, before.products
    group = found.main.posterior["posterior"].to_dataset()
    draws = {name: group[name].values for name in box.names}
    looked_at = (*map(alone, box.names), *products)
    narrowed = contraction(draws, box, looked_at)
    values = {each.name: value_of(each, draws) for each in looked_at}
    sensitivity = box_sensitivity(values, box)
    texts = {each.name: each.text for each in looked_at}
    said = [
        *before.statements,
        *_contraction_words(narrowed, texts),
        *sensitivity_statements(sensitivity, texts),
    ]
    return replace(before, contraction=narrowed, sensitivity=sensitivity, statements=tuple(said))


def reached(costs: NDArray[np.float64]) -> int:
    """How many starts ended within a hundredth of the lowest cost, or no further than noise."""
    lowest = float(np.min(costs))
    return int(np.sum(costs <= lowest + max(REACHED * lowest, NOTHING)))


def _waterfall_words(costs: NDArray[np.float64]) -> str:
    if len(costs) == 1:
        return "The fit had one start, which explained the data."
    near = reached(costs)
    if near == 1:
        return (
            f"Of {len(costs)} starts of the fit, one alone reached the lowest cost: a lower one "
            "may have been missed."
        )
    return f"{near} of {len(costs)} starts of the fit ended within 1 % of the lowest cost."


def _contraction_words(narrowed: Mapping[str, float], texts: Mapping[str, str]) -> list[str]:
    """Which marginals the data hardly narrowed, in words."""
    wide = [
        f"{texts[name]} ({max(value, 0.0):.0%})"
        for name, value in narrowed.items()
        if value < NARROWED
    ]
    if not wide:
        return ["After sampling, every parameter has less than half of its prior variance left."]
    return [
        f"After sampling, the data have taken less than half of the prior variance of "
        f"{listed(wide)}."
    ]


def as_group(found: Identifiability) -> xr.Dataset:
    """The group /identifiability of the run's tree.

    Returns:
        Variables along direction, parameter, combination and start; and along parameter and point
        where there are profiles, NaN beyond the end of a shorter one.
    """
    directions, names = found.information.directions, found.information.names
    variables = {
        "direction_text": _variable("direction", [d.text for d in directions], "", "combination"),
        "direction_information": _variable(
            "direction", [d.information for d in directions], "1", "information over the prior's"
        ),
        "direction_ratio": _variable(
            "direction", [d.ratio for d in directions], "1", "sd over the prior's, by the fit"
        ),
        "loadings": _variable(
            ("direction", "parameter"),
            [d.loadings for d in directions],
            "1",
            "share of each parameter, in prior standard deviations",
        ),
        "cost": _variable("start", found.fitted.fit.waterfall, "1", "cost reached from a start"),
    }
    variables |= _rows(found, "parameter", names)
    variables |= _rows(found, "combination", tuple(each.name for each in found.products))
    variables |= _profile_variables(found.profiles, names)
    coords = {"parameter": list(names), "combination": [each.name for each in found.products]}
    return xr.Dataset(variables, {name: each for name, each in coords.items() if each})


def _variable(dims: str | tuple[str, ...], values: Any, units: str, name: str) -> xr.Variable:
    return xr.Variable(dims, np.asarray(values), {"units": units, "long_name": name})


def _rows(found: Identifiability, dim: str, names: tuple[str, ...]) -> dict[str, xr.Variable]:
    """What is known of each parameter, or of each combination."""
    if not names:
        return {}
    known = [found.information.known[name] for name in names]
    rows = {
        f"{dim}_relative": ([row.relative for row in known], "sd over value, by the fit"),
        f"{dim}_ratio": ([row.ratio for row in known], "sd over the prior's, by the fit"),
    }
    if found.contraction:
        rows |= {
            f"{dim}_contraction": (
                [found.contraction[name] for name in names],
                "1 less the variance of the draws over the prior's, of logs of what is positive",
            ),
            f"{dim}_shift": (
                [found.sensitivity[name].shift for name in names],
                "largest move of the mean by a tenth less of the box, in posterior sds",
            ),
        }
    return {name: _variable(dim, values, "1", words) for name, (values, words) in rows.items()}


def _profile_variables(
    profiles: Mapping[str, Profile], names: tuple[str, ...]
) -> dict[str, xr.Variable]:
    if not profiles:
        return {}
    longest = max(len(each.values) for each in profiles.values())
    values, rise = np.full((2, len(names), longest), np.nan)
    interval = np.full((len(names), 2), np.nan)
    for i, name in enumerate(names):
        if name in profiles:
            one = profiles[name]
            values[i, : len(one.values)], rise[i, : len(one.values)] = one.values, one.chi_square
            interval[i] = one.interval
    dims = ("parameter", "point")
    return {
        "profile_value": _variable(dims, values, "unit of the parameter", "value held"),
        "profile_chi_square": _variable(dims, rise, "1", "rise of chi-square, the others free"),
        "profile_interval": _variable(
            ("parameter", "end"), interval, "unit of the parameter", "99 % interval by the profile"
        ),
    }
