"""The figures by number and by name; each answers one question and returns its axes.

Every figure takes the run's DataTree and, optionally, the axes to draw on. `figure_4` to
`figure_13` are the paper's; the others go beyond it.
"""

# Greek letters and the true minus sign are meant.
# ruff: noqa: RUF001

import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from jbw.errors import DataError
from jbw.report import style
from jbw.report.convergence import running_means, trace_rank
from jbw.report.decay import amplitude_curves, verification_decay
from jbw.report.kernel import harmonic_spectrum, kernel_bands
from jbw.report.linear import linear_frf, softening, verification_frf
from jbw.report.loops import validation_loops
from jbw.report.posterior import opening_density, ridge, routes, third_order_densities
from jbw.report.sweep import verification_sweep

figure_4, figure_5, figure_6 = linear_frf, softening, harmonic_spectrum
figure_7, figure_8, figure_9 = third_order_densities, kernel_bands, running_means
figure_10, figure_11, figure_12 = opening_density, verification_frf, verification_sweep
figure_13 = validation_loops


class Plate(NamedTuple):
    """One figure of the report.

    Args:
        name: Its name: figure_4 to figure_13 as in the paper, or its own.
        draw: The function of (tree, ax).
        slug: Its file name, without ending.
        question: What it answers, its title on the page.
        caption: What is drawn and what to look for.
    """

    name: str
    draw: Callable[..., Any]
    slug: str
    question: str
    caption: str


PLATES = (
    Plate(
        "figure_4",
        figure_4,
        "figure_04_linear_frf",
        "How does the structure behave when the joint is stuck?",
        "Frequency response at the lowest level with the line fit of Step 2, and the coherence. "
        "The fit should run through the points on both sides of the peak; a coherence below one "
        "at the peak tells of leakage or of hysteresis already at work.",
    ),
    Plate(
        "figure_5",
        figure_5,
        "figure_05_softening",
        "Does the resonance move with the level?",
        "Measured frequency responses, one line a level, each peak marked. A joint that slips "
        "pulls the peak to lower frequencies and blunts it as the level rises.",
    ),
    Plate(
        "figure_6",
        figure_6,
        "figure_06_third_harmonic",
        "Does a tone come back with a third harmonic?",
        "Left, the response spectrum to one probing tone, ω and 3ω circled; the third harmonic "
        "has to stand clear of the floor. Right, the third-order kernel from every repeat: the "
        "scatter of the points is what the likelihood of Step 3 sees.",
    ),
    Plate(
        "figure_7",
        figure_7,
        "figure_07_third_order_posterior",
        "What does the third-order kernel say about ζ, α and δ?",
        "Densities relative to the prior, so that 1 means nothing learnt; bars are 99 % "
        "intervals with their medians. Narrow peaks that differ from one sampler to the other "
        "are chains that did not move, not knowledge.",
    ),
    Plate(
        "figure_8",
        figure_8,
        "figure_08_kernel_bands",
        "Does the model reproduce the measured kernel?",
        "Measured H₃ of every repeat beside the 99 % parameter bands of each sampler; below, both "
        "against a sampler's median, where small differences show. The bands "
        "carry the parameters' uncertainty only, no noise: single repeats scatter beyond them, "
        "but their middle should not lie outside.",
    ),
    Plate(
        "figure_9",
        figure_9,
        "figure_09_running_means",
        "Have the running means settled?",
        "The paper's conv(n), one line a chain. A flat line alone proves little: lines that "
        "settle at different heights have not explored the same posterior.",
    ),
    Plate(
        "figure_10",
        figure_10,
        "figure_10_opening_posterior",
        "What does the opening of the loop say about γ?",
        "Density of γ relative to its prior, with the other parameters held at their estimates "
        "and with all of them free. The gap between the two is the price of holding parameters "
        "that were not known that well.",
    ),
    Plate(
        "figure_11",
        figure_11,
        "figure_11_verification_frf",
        "Does the model predict the frequency response at every level?",
        "Measured FRFs against the 99 % parameter band of the model, each draw simulated under "
        "the measured input and passed through the same estimator; the lowest row is the "
        "magnitude over the model's median. Tests marked as not fitted are predictions.",
    ),
    Plate(
        "figure_12",
        figure_12,
        "figure_12_verification_sweep",
        "Does the model predict repeats that it never saw?",
        "From the left: the whole record, some periods around the largest response, and the same "
        "less the model's median, at a scale that shows the bands. The parameter "
        "band holds the model's uncertainty, the predictive band adds the noise and is the one "
        "that should hold 99 % of the measured points.",
    ),
    Plate(
        "figure_13",
        figure_13,
        "figure_13_validation_loops",
        "Does the model reproduce the hysteresis loops?",
        "Restoring force against displacement; below, less the secant of the measured loop, "
        "which shows its opening. The enclosed area is the energy lost in the joint per cycle "
        "and per unit mass.",
    ),
    Plate(
        "decay",
        verification_decay,
        "extra_decay",
        "Does the model predict free decays that it never saw?",
        "From the left: the whole record in the band of the mode, some late periods, and what is "
        "left less the model's median. Of a held-out record the model sees the first part, up to "
        "the dashed line, and predicts the rest; an error of frequency builds up towards its end.",
    ),
    Plate(
        "amplitude",
        amplitude_curves,
        "extra_amplitude",
        "How do frequency and damping depend on the amplitude?",
        "Points are read from the envelopes without any model of the joint; the bands are the "
        "model's, from the equivalent stiffness and the energy lost in its steady loop. Points "
        "that leave the band on a curve tell of a joint that the law does not describe.",
    ),
    Plate(
        "ridge",
        ridge,
        "extra_ridge",
        "Can α and δ be told apart?",
        "Draws of α against δ. Where they lie along the dashed curve, only the product α δ is "
        "determined; strong sweeps, fitted with all parameters free, break the tie.",
    ),
    Plate(
        "routes",
        routes,
        "extra_routes",
        "Do the routes agree with each other?",
        "Medians and 99 % intervals of every parameter by every route, within the prior box "
        "(grey). Vertical lines are the truth, where it is known.",
    ),
    Plate(
        "trace_rank",
        trace_rank,
        "extra_trace_rank",
        "Did the chains of the main posterior mix?",
        "Good traces look alike and show no trend; good ranks stay near 1 for every chain.",
    ),
)

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
