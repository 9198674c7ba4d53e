"""Which parameters and combinations the data know: their spectrum, their profiles."""

# Greek letters and the true minus sign are meant.
# ruff: noqa: RUF001

import re
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes

from jbw.errors import DataError
from jbw.report.result import branch, node
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
from jbw.report.text import SYMBOLS, axis_label, symbol

GROUP = "identifiability"
THRESHOLD = 6.63  # of chi-square with one degree of freedom at 99 %
LEAST = 1e-6  # of the prior's standard deviation: bars of less would squeeze the others
ACROSS = 3  # profiles side by side


def information_spectrum(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw the standard deviation over the prior's, by direction and by parameter (2 axes)."""
    known = branch(tree, GROUP, "direction_ratio", "parameter_ratio")
    count = max(known.sizes["direction"], len(_names(known)))
    axes = panels(ax, 1, 2, height=1.3 + 0.3 * count)
    _directions(axes[0, 0], known)
    _quantities(axes[0, 1], known)
    for each in axes.flat:
        each.axvline(1.0, color=INK, lw=0.9)
        each.set_xscale("log")
        each.set_xlabel("standard deviation over the prior's [-]")
        each.grid(False, axis="y")
    legend(axes, ax)
    return axes


def _directions(ax: Axes, known: xr.Dataset) -> None:
    """Draw the spectrum as bars, the strongest direction on top."""
    ratio = np.maximum(np.asarray(known["direction_ratio"], float), LEAST)
    texts = [_in_lines(spelled(str(text))) for text in known["direction_text"].values]
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


def _quantities(ax: Axes, known: xr.Dataset) -> None:
    """Draw parameters and combinations: by the fit, and by the draws where there are any."""
    names = _names(known)
    before = np.maximum(_column(known, "ratio"), LEAST)
    rows = np.arange(len(names))
    ax.plot(before, rows, "o", ms=6, mfc="none", color=BLUE, label="by the fit, before sampling")
    if "parameter_contraction" in known:
        left = np.sqrt(np.maximum(1 - _column(known, "contraction"), LEAST**2))
        ax.plot(left, rows, ".", ms=7, color=GREEN, label="by the draws")
    ax.set_yticks(rows, [symbol(name) for name in names])
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


def spelled(text: str) -> str:
    """Return a combination with its parameters as symbols: alpha*delta as α·δ."""
    letters = ("omega_n", "zeta", "alpha", "delta", "gamma")
    found = re.sub(r"[A-Za-z_]+", lambda m: SYMBOLS[m[0]] if m[0] in letters else m[0], text)
    return plain(found.replace("*", "·").replace("-", "−"))


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
    posterior = node(tree, "posterior")
    stored = {} if posterior is None else posterior.to_dataset().data_vars
    unit = str(stored[name].attrs.get("units", "")) if name in stored else ""
    ax.set_xlabel(axis_label(symbol(name), unit))
