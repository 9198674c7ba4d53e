"""What identifiability leaves in a run's folder: plain values, and one group of the tree."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jbw.identification.prepare import Fitted
from jbw.inference.fit.identifiability import Sensitivity
from jbw.inference.fit.information import Direction, Information
from jbw.inference.fit.profiles import Profile
from jbw.inference.space.box import Product

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
        """Everything in plain values, as under `identifiability` in summary.json."""
        return as_record(self)


def reached(costs: NDArray[np.float64]) -> int:
    """How many starts ended within a hundredth of the lowest cost, or no further than noise."""
    lowest = float(np.min(costs))
    return int(np.sum(costs <= lowest + max(REACHED * lowest, NOTHING)))


def as_record(found: Identifiability) -> dict[str, Any]:
    """Everything in plain values for JSON; None for what is infinite or not known.

    Args:
        found: What the data know.
    """
    costs, names = found.fitted.fit.waterfall, found.information.names
    rows = {
        name: {
            "text": row.text,
            "value": _plain(row.value),
            "sd": _plain(row.sd),
            "relative": _plain(row.relative),
            "ratio": _plain(row.ratio),
        }
        for name, row in found.information.known.items()
    }
    return {
        "statements": list(found.statements),
        "spectrum": [_direction(each, names) for each in found.information.directions],
        "parameters": {name: rows[name] for name in names},
        "combinations": {each.name: rows[each.name] for each in found.products},
        "contraction": {name: _plain(value) for name, value in found.contraction.items()},
        "box_sensitivity": {
            name: {**asdict(each), "shift": _plain(each.shift)}
            for name, each in found.sensitivity.items()
        },
        "profiles": {name: _profile(each) for name, each in found.profiles.items()},
        "waterfall": {"costs": [_plain(cost) for cost in costs], "reached": reached(costs)},
    }


def _plain(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _direction(row: Direction, names: tuple[str, ...]) -> dict[str, Any]:
    return {
        "combination": row.text,
        "information": row.information,
        "ratio": row.ratio,
        "sd": _plain(row.sd),
        "loadings": dict(zip(names, row.loadings.tolist(), strict=True)),
    }


def _profile(row: Profile) -> dict[str, Any]:
    return {
        "interval": list(row.interval),
        "open": list(row.open),
        "values": row.values.tolist(),
        "chi_square": row.chi_square.tolist(),
    }


def as_group(found: Identifiability) -> xr.Dataset:
    """The group /identifiability of the run's tree.

    Args:
        found: What the data know.

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
