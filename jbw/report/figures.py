"""The figures of a run, by number and by name, as pictures and as SVG.

Every figure takes the run's DataTree and, optionally, the axes to draw on, and returns its axes.
`figures.figure_1`, `figure_2` and `figure_4` to `figure_13` are the paper's, with the run's own
numbers (its figure 3 shows the rig); the others go beyond it. `FIGURES` has all by name,
`jbw.report.figure_list` what each of them asks and shows.

`jbw.report.interactive` makes one page of responses, loops and curves to zoom into. Of a campaign
before any run, `jbw.report.overview` draws the channels; of compared samplers,
`jbw.report.comparison` the means and rates. ArviZ's own plots take a run's tree as it is, as in
`arviz.plot_rank(tree)`; they are not used here since they need pyplot, load JAX and take no axes.
"""

import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from jbw.errors import DataError
from jbw.report import style
from jbw.report.figure_list import FIGURE_LIST

FIGURES: dict[str, Callable[..., Any]] = {entry.name: entry.draw for entry in FIGURE_LIST}


def __getattr__(name: str) -> Callable[..., Any]:
    if name in FIGURES:
        return FIGURES[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def figure_of(drawn: Any) -> Figure:
    """Return the figure that holds what a figure function returned."""
    return np.asarray(drawn, dtype=object).reshape(-1)[0].figure


def save_figures(tree: xr.DataTree, folder: Path, dpi: int = 130) -> list[Path]:
    """Write every figure that the result allows as PNG, and return the paths.

    Args:
        tree: The run's result.
        folder: Where to write; made when absent.
        dpi: Points per inch.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for entry in FIGURE_LIST:
        try:
            figure = figure_of(entry.draw(tree))
        except DataError:
            # A run that left out a step has no such figure; the page says why.
            continue
        path = folder / f"{entry.slug}.png"
        figure.savefig(path, dpi=dpi, facecolor="white")
        written.append(path)
    return written


def svg(figure: Figure, name: str) -> str:
    """Return a figure as an SVG element whose colours follow the page's light or dark theme.

    Args:
        figure: The figure.
        name: Makes its ids unlike those of the page's other figures.
    """
    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "path", "svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", transparent=True, dpi=160, metadata={"Date": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    # Glyphs are shared between figures by their id; a prefix keeps each figure whole by itself.
    text = re.sub(r'(\bid="|xlink:href="#|url\(#)', rf"\g<1>{name}-", text)
    for role in ("INK", "SOFT", "GRID", "BLUE", "VERMILLION", "GREEN", "ORANGE", "SKY", "PURPLE"):
        text = text.replace(getattr(style, role), f"var(--{role.lower()})")
    return text
