"""Which parameters and combinations the data know: spectrum, profiles, tables."""

import re
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes

from jbw.errors import DataError
from jbw.inference.thresholds import THRESHOLD
from jbw.report.result import branch, names_of
from jbw.report.style import (
    BLUE,
    GREEN,
    INK,
    SOFT,
    VERMILLION,
    Panels,
    legend,
    panels,
    plain,
    title,
)
from jbw.report.table import Cell, Column, Row, Table, by_sd, digits, named, shares, table
from jbw.report.text import NOTHING, Names, axis_label, number, percent, quantity, symbol
from jbw.report.words import combination

GROUP = "identifiability"
LEAST = 1e-6  # of the prior's standard deviation: bars of less would squeeze the others
ACROSS = 3  # profiles side by side
CONTRACTION = (
    "1 less the variance of the draws over the prior's, of logarithms where values are positive; "
    "100 % is known, 0 % is the prior"
)
FOLLOWS = (
    "the largest move of the posterior mean when a tenth of a box is cut off at either end; a "
    "parameter that is its prior moves by 0.17"
)


def information_spectrum(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw the standard deviation over the prior's, by direction and by parameter (2 axes)."""
    known = branch(tree, GROUP, "direction_ratio", "parameter_ratio")
    count = max(known.sizes["direction"], len(_names(known)))
    axes = panels(ax, 1, 2, height=1.3 + 0.3 * count)
    names = names_of(tree)
    _directions(axes[0, 0], known, names)
    _quantities(axes[0, 1], known, names)
    for each in axes.flat:
        each.axvline(1.0, color=INK, lw=0.9)
        each.set_xscale("log")
        each.set_xlabel("standard deviation over the prior's [-]")
        each.grid(False, axis="y")
    legend(axes, ax)
    return axes


def _directions(ax: Axes, known: xr.Dataset, names: Names) -> None:
    """Draw the spectrum as bars, the strongest direction on top."""
    ratio = np.maximum(np.asarray(known["direction_ratio"], float), LEAST)
    texts = [str(text) for text in known["direction_text"].values]
    texts = [_in_lines(plain(combination(text, names))) for text in texts]
    rows = np.arange(len(ratio))
    left = 0.5 * ratio.min()
    ax.barh(rows, ratio - left, 0.6, left=left, color=BLUE, alpha=0.8)
    ax.set_yticks(rows, texts)
    ax.set_ylim(len(ratio) - 0.4, -0.6)
    title(ax, "Directions, strongest first, by the fit")


def _in_lines(text: str, most: int = 22) -> str:
    """Break a combination after its signs where it is longer than a label should be."""
    lines = [""]
    for part in re.split(r"(?<=[·/])", text):
        lines = [*lines, part] if len(lines[-1] + part) > most else [*lines[:-1], lines[-1] + part]
    return "\n".join(filter(None, lines))


def _quantities(ax: Axes, known: xr.Dataset, called: Names) -> None:
    """Draw parameters and combinations: by the fit, and by the draws where there are any."""
    names = _names(known)
    before = np.maximum(_column(known, "ratio"), LEAST)
    rows = np.arange(len(names))
    ax.plot(before, rows, "o", ms=6, mfc="none", color=BLUE, label="by the fit, before sampling")
    if "parameter_contraction" in known:
        left = np.sqrt(np.maximum(1 - _column(known, "contraction"), LEAST**2))
        ax.plot(left, rows, ".", ms=7, color=GREEN, label="by the draws")
    ax.set_yticks(rows, [symbol(name, called) for name in names])
    ax.set_ylim(len(names) - 0.4, -0.6)
    title(ax, "Parameters and combinations")


def _names(known: xr.Dataset) -> list[str]:
    """Return the parameters and then the combinations."""
    dims = [dim for dim in ("parameter", "combination") if dim in known.coords]
    return [str(name) for dim in dims for name in known[dim].values]


def _column(known: xr.Dataset, what: str) -> Float[np.ndarray, " quantity"]:
    """Return one number for every parameter and combination."""
    dims = [dim for dim in ("parameter", "combination") if f"{dim}_{what}" in known]
    return np.concatenate([np.asarray(known[f"{dim}_{what}"], float) for dim in dims])


def profile_curves(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw the rise of chi-square along every parameter, the others at their best.

    One axes a parameter, three side by side; `ax` holds as many as fill the last line.
    """
    known = branch(tree, GROUP)
    if "profile_value" not in known:
        raise DataError(
            "The run followed no profile likelihoods; set profiles = true in [identify]."
        )
    values, rise = (
        np.asarray(known[name], float) for name in ("profile_value", "profile_chi_square")
    )
    chosen = [i for i in range(len(values)) if np.any(np.isfinite(values[i]))]
    lines = -(-len(chosen) // ACROSS)
    axes = panels(ax, lines, ACROSS, height=0.4 + 1.9 * lines)
    for each in axes.flat[len(chosen) :]:
        each.set_visible(False)
    for each, i in zip(axes.flat, chosen, strict=False):
        _profile(each, tree, str(known["parameter"].values[i]), values[i], rise[i])
    for row in axes:
        row[0].set_ylabel("rise of χ² [-]")
    legend(axes, ax)
    return axes


def _profile(
    ax: Axes,
    tree: xr.DataTree,
    name: str,
    values: Float[np.ndarray, " point"],
    rise: Float[np.ndarray, " point"],
) -> None:
    """Draw one profile and the threshold of its 99 % interval."""
    ax.plot(values, rise, ".-", color=BLUE, lw=1.2, ms=5, label="profile")
    ax.axhline(THRESHOLD, color=VERMILLION, lw=0.9, ls="--", label="99 %")
    ax.axhline(0.0, color=SOFT, lw=0.7)
    ax.set_ylim(-0.6, 2.2 * THRESHOLD)
    ax.locator_params(axis="x", nbins=3)
    known = quantity(name, names_of(tree))
    ax.set_xlabel(axis_label(known.symbol, known.unit))


def directions_table(found: Row, known: Names) -> Table:
    """The information spectrum, a row a direction, the strongest first.

    Args:
        found: `identifiability` of a summary.
        known: The run's quantities.
    """
    return table(
        "Information spectrum, strongest direction first",
        found.get("spectrum") or [],
        Column(
            "direction, strongest first",
            lambda row: Cell(combination(row["combination"], known), typed=row["combination"]),
            align="left",
        ),
        digits("information /\nprior's", "information"),
        digits("sd / prior's", "ratio", 2),
    )


def quantities_table(found: Row, known: Names) -> Table:
    """What is known of every parameter and combination, before and after sampling.

    Args:
        found: `identifiability` of a summary.
        known: The run's quantities.
    """
    facts = {**(found.get("parameters") or {}), **(found.get("combinations") or {})}
    rows = [
        {"name": name, **row}
        | {
            key: (found.get(key) or {}).get(name)
            for key in ("contraction", "box_sensitivity", "profiles")
        }
        for name, row in facts.items()
    ]
    return table(
        "Parameters and combinations",
        rows,
        named("parameter or combination", known),
        replace(by_sd("fit", "value"), only="terminal"),
        replace(digits("sd", "sd", 2), only="terminal"),
        shares("sd / value,\nby the fit", "relative"),
        digits("sd / prior's,\nby the fit", "ratio", 2),
        Column("contraction,\nby the draws", lambda row: percent(row["contraction"]), CONTRACTION),
        Column("follows its box,\nin sds", partial(_shift, known=known), FOLLOWS),
        Column("99 % interval\nof the profile", _interval),
        note=f"The fit's numbers come from its derivatives and hold near it. {_waterfall(found)}",
    )


def _waterfall(found: Row) -> str:
    """The costs from all starts of the fit as a sentence; nothing for one start."""
    costs = (found.get("waterfall") or {}).get("costs") or []
    if len(costs) < 2:
        return ""
    listed = ", ".join("none" if cost is None else number(cost, digits=4) for cost in costs)
    return f"Costs from the starts of the fit, lowest first: {listed}."


def _shift(row: Row, known: Names) -> str:
    """How far a mean follows the box, and which bound moves it."""
    shift = row["box_sensitivity"]
    if shift is None or not shift.get("box"):
        return NOTHING
    size = "∞" if shift.get("shift") is None else number(shift["shift"], 0.1)
    return f"{size} by {symbol(shift['box'], known)} {shift['end']}"


def _interval(row: Row) -> str:
    """The interval of a profile; an open side has no number."""
    profile = row["profiles"]
    if profile is None:
        return NOTHING
    low, high = profile["interval"]
    ends = zip((low, high), profile["open"], strict=True)
    return " to ".join("open" if far else number(end, (high - low) / 5) for end, far in ends)
