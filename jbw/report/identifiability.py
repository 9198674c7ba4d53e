"""Figures and tables of the parameters and combinations that the data determine."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.errors import DataError
from jbw.inference.thresholds import THRESHOLD
from jbw.report import style
from jbw.report.messages import figures as captions
from jbw.report.messages import identified
from jbw.report.messages import tables as notes
from jbw.report.result import arrays, branch, names_of
from jbw.report.style import Panels, finish, panels, stacks, title
from jbw.report.table import Cell, Column, Table, by_sd, digits, named, shares, table
from jbw.report.text import NOTHING, Names, axis_label, number, percent, plain, quantity, symbol
from jbw.report.words import combination
from jbw.results.run import StoredDirection, StoredIdentifiability, StoredProfile, StoredShift

GROUP = "identifiability"
# smallest displayed value, relative to the prior's standard deviation; shorter bars would make the
# others too short
LEAST = 1e-6
LISTED = 3  # largest number of names of a combination in its label


def information_spectrum(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Which parameters and combinations do the data determine?

    Left, combinations of parameters (directions) that the data determine more precisely than the
    prior, from the derivatives of the fit. At a value of 1 the data add nothing to the prior.
    Right, the same ratio for every parameter and for the products αδ and αγ, before and after
    sampling. If a product lies far to the left of its factors, the data determine the product, and
    the prior determines the factors.
    """
    group = branch(tree, GROUP, "direction_ratio", "parameter_ratio")
    names = names_of(tree)
    kinds = [kind for kind in ("parameter", "combination") if kind in group.coords]
    quantities = [str(name) for kind in kinds for name in group[kind].values]
    axes = panels(ax, 1, 2, height=1.3 + 0.3 * max(group.sizes["direction"], len(quantities)))
    directions, right = axes[0]
    # Bars are ordered with the best determined combination on top.
    ratio = np.maximum(np.asarray(group["direction_ratio"], float), LEAST)
    texts = [plain(combination(str(text), names)) for text in group["direction_text"].values]
    start = 0.5 * ratio.min()
    directions.barh(
        np.arange(len(ratio)), ratio - start, 0.6, left=start, color=style.BLUE, alpha=0.8
    )
    title(directions, captions.DIRECTIONS)
    # The values are those of the fit, and those of the draws if there are draws.
    rows = np.arange(len(quantities))
    before = np.maximum(_column(group, "ratio"), LEAST)
    look = {"ms": 6, "mfc": "none", "color": style.BLUE, "label": captions.BEFORE_SAMPLING}
    right.plot(before, rows, "o", **look)
    if "parameter_contraction" in group:
        after = np.sqrt(np.maximum(1 - _column(group, "contraction"), LEAST**2))
        right.plot(after, rows, ".", ms=7, color=style.GREEN, label="by the draws")
    title(right, "Parameters and combinations")
    symbols = [symbol(name, names) for name in quantities]
    for panel, labels in ((directions, list(map(_in_lines, texts))), (right, symbols)):
        panel.set_yticks(range(len(labels)), labels)
        panel.set_ylim(len(labels) - 0.4, -0.6)
        panel.axvline(1.0, color=style.INK, lw=0.9)
        panel.set_xscale("log")
        panel.grid(False, axis="y")
    return finish(axes, ax, captions.OVER_PRIOR)


def _in_lines(text: str, most: int = 22) -> str:
    """Wrap text into lines: a combination after · or /, a list after its commas.

    A long list is shortened to its first names and the number of the others.
    """
    names = re.split(r", | and ", text)
    if len(names) > LISTED + 1:
        text = f"{', '.join(names[:LISTED])} and {len(names) - LISTED} more"
    lines = [""]
    for part in re.split(r"(?<=[·/])|(?<=, )|(?= and )", text):
        lines = [*lines, part] if len(lines[-1] + part) > most else [*lines[:-1], lines[-1] + part]
    return "\n".join(line.strip() for line in lines if line)


def _column(group: xr.Dataset, what: str) -> Float[np.ndarray, " quantity"]:
    dims = [dim for dim in ("parameter", "combination") if f"{dim}_{what}" in group]
    return np.concatenate([np.asarray(group[f"{dim}_{what}"], float) for dim in dims])


def profile_curves(tree: xr.DataTree, ax: Any = None) -> Panels:
    """How far can each parameter move while the others compensate?

    Least χ² with one parameter held at each value, minus the least χ² of all values. If a curve
    crosses the dashed line on both sides of its minimum, the crossings are the ends of a 99 %
    interval. If it stays below the line up to a prior bound, the data do not limit the parameter on
    this side.

    Panels: one per parameter.
    """
    group = branch(tree, GROUP)
    if "profile_value" not in group:
        raise DataError(
            "The run has no profile likelihoods; set profiles = true in [identify] and identify "
            "again."
        )
    names = names_of(tree)
    group = group.dropna("parameter", how="all", subset=["profile_value"])
    axes, stack = stacks(ax, group.sizes["parameter"], 1, height=2.1)
    for i, (panel,) in enumerate(stack):
        name = str(group["parameter"].values[i])
        values, rise = arrays(group.isel(parameter=i), "profile_value", "profile_chi_square")
        panel.plot(values, rise, ".-", color=style.BLUE, lw=1.2, ms=5, label="profile")
        # This line is the threshold of the 99 % interval.
        panel.axhline(THRESHOLD, color=style.VERMILION, lw=0.9, ls="--", label="99 %")
        panel.axhline(0.0, color=style.SOFT, lw=0.7)
        panel.set_ylim(-0.6, 2.2 * THRESHOLD)
        panel.locator_params(axis="x", nbins=3)
        panel.set_xlabel(axis_label(symbol(name, names), quantity(name, names).unit))
    return finish(axes, ax, ylabels="rise of χ² [-]")


def directions_table(found: StoredIdentifiability, quantities: Names) -> Table:
    """Return the table of the information spectrum, with the best determined combination first."""

    def direction(row: StoredDirection) -> Cell:
        return Cell(combination(row.combination, quantities), typed=row.combination)

    return table(
        notes.SPECTRUM,
        found.spectrum,
        Column("direction, strongest first", direction, align="left"),
        digits("information /\nprior's", "information"),
        shares("sd / prior's", "ratio"),
    )


def quantities_table(found: StoredIdentifiability, quantities: Names) -> Table:
    """Return the table of how precisely each parameter is determined, before and after sampling."""
    return table(
        "Parameters and combinations",
        [*found.parameters.values(), *found.combinations.values()],
        named("parameter or combination", quantities),
        by_sd("fit", "value", only="terminal"),
        digits("sd", "sd", 2, only="terminal"),
        shares(notes.SD_OVER_VALUE, "relative"),
        shares(notes.SD_OVER_PRIOR, "ratio"),
        Column(
            "contraction,\nby the draws",
            lambda row: percent(found.contraction.get(row.name)),
            identified.CONTRACTION,
        ),
        Column(
            "follows its bounds,\nin sds",
            lambda row: _shift(found.box_sensitivity.get(row.name), quantities),
            identified.FOLLOWS,
        ),
        Column(notes.PROFILE_INTERVAL, lambda row: _interval(found.profiles.get(row.name))),
        note=" ".join(filter(None, (identified.OF_THE_FIT, _waterfall(found.waterfall.costs)))),
    )


def _waterfall(costs: Sequence[float | None]) -> str:
    """Return the sentence on the final costs of fits from several starting points."""
    if len(costs) < 2:
        return ""
    shown = ["none" if cost is None else number(cost, digits=4) for cost in costs]
    return identified.costs(shown)


def _shift(move: StoredShift | None, quantities: Names) -> str:
    """Return as text how far a prior bound shifts a posterior mean [sd], and the bound."""
    if move is None or not move.box:
        return NOTHING
    size = "∞" if move.shift is None else number(move.shift, 0.1)
    return f"{size} by {symbol(move.box, quantities)} {move.end}"


def _interval(profile: StoredProfile | None) -> str:
    """Return the interval of a profile likelihood as text; an open end has no number."""
    if profile is None:
        return NOTHING
    low, high = profile.interval
    ends = zip((low, high), profile.open, strict=True)
    return " to ".join("open" if far else number(end, (high - low) / 5) for end, far in ends)
