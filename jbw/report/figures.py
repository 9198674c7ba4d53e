"""The figures by number and by name; each answers one question and returns its axes.

Every figure takes the run's DataTree and, optionally, the axes to draw on, and returns its axes.
`figure_1`, `figure_2` and `figure_4` to `figure_13` are the paper's, with the run's own numbers
(its figure 3 shows the rig); the others go beyond it. `FIGURES` has all by name.

    figure_1   oscillator             the oscillator, and its hysteretic force
    figure_2   procedure              the steps, what each found, its verdict
    figure_4   linear_frf             FRF with the joint stuck, line fit, coherence
    figure_5   softening              FRFs of all levels
    figure_6   harmonic_spectrum      third harmonic of a tone, measured kernel
    figure_7   third_order_densities  prior and posterior of Step 3, every sampler
    figure_8   kernel_bands           measured kernel and the model's
    figure_9   running_means          conv(n)
    figure_10  opening_density        prior and posterior of gamma
    figure_11  verification_frf       FRFs and the model's bands
    figure_12  verification_sweep     sweeps and bands, whole and at the resonance
    figure_13  validation_loops       hysteresis loops and their areas
    curves     verification_curves    response curves by level
    loops      verification_loops     forced loops
    multisine  verification_multisine a steady multisine in time and frequency
    decay      verification_decay     free decays
    amplitude  amplitude_curves       frequency and damping read from decays
    backbone   backbone               frequency and damping against amplitude
    ridge      ridge                  alpha against delta
    routes     routes                 every parameter by every route
    identifiability  information_spectrum   what the data know
    profiles   profile_curves         profile likelihoods
    trace_rank trace_rank             traces and ranks of the main posterior

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
from jbw.report.convergence import running_means
from jbw.report.kernel import harmonic_spectrum, kernel_bands
from jbw.report.linear import linear_frf, softening, verification_frf
from jbw.report.loops import validation_loops
from jbw.report.plates import PLATES
from jbw.report.posterior import opening_density, third_order_densities
from jbw.report.procedure import procedure
from jbw.report.schematic import oscillator
from jbw.report.sweep import verification_sweep

figure_1, figure_2 = oscillator, procedure
figure_4, figure_5, figure_6 = linear_frf, softening, harmonic_spectrum
figure_7, figure_8, figure_9 = third_order_densities, kernel_bands, running_means
figure_10, figure_11, figure_12 = opening_density, verification_frf, verification_sweep
figure_13 = validation_loops

FIGURES: dict[str, Callable[..., Any]] = {plate.name: plate.draw for plate in PLATES}


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
    for plate in PLATES:
        try:
            figure = figure_of(plate.draw(tree))
        except DataError:
            # A run that left out a step has no such figure; the page says why.
            continue
        path = folder / f"{plate.slug}.png"
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
