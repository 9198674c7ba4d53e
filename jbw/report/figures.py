"""The figures of a run, by number and by name, as pictures and as SVG.

Every figure takes the run's DataTree and, optionally, the axes to draw on, and returns its axes.
`figures.figure_1`, `figure_2` and `figure_4` to `figure_13` are the paper's, with the run's own
numbers (its figure 3 shows the rig); the others go beyond it. `FIGURES` has all by name,
`FIGURE_LIST` what each of them asks and shows.

`jbw.report.page` makes one page of responses, loops and curves to zoom into. Of a campaign before
any run, `jbw.report.overview` draws the channels; of compared samplers, `jbw.report.studies` the
means and rates. ArviZ's own plots take a run's tree as it is, as in `arviz.plot_rank(tree)`; they
are not used here since they need pyplot, load JAX and take no axes.
"""

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
from jbw.report.diagrams import oscillator, procedure
from jbw.report.identifiability import information_spectrum, profile_curves
from jbw.report.kernel import harmonic_spectrum, kernel_bands
from jbw.report.loops import amplitude_curves, backbone, validation_loops, verification_loops
from jbw.report.posterior import (
    opening_density,
    ridge,
    routes,
    running_means,
    third_order_densities,
    trace_rank,
)
from jbw.report.records import verification_decay, verification_multisine, verification_sweep
from jbw.report.responses import (
    linear_frf,
    softening,
    verification_curves,
    verification_frf,
    verification_groups,
)


class Entry(NamedTuple):
    """One figure of the report.

    Args:
        slug: Its file name, without ending.
        draw: The function of (tree, ax).
        question: What it answers, its title on the page.
        caption: What is drawn and what to look for.
    """

    slug: str
    draw: Callable[..., Any]
    question: str
    caption: str

    @property
    def name(self) -> str:
        """Its name: figure_1 to figure_13 as in the paper, or its own."""
        kind, _, rest = self.slug.partition("_")
        return rest if kind == "extra" else f"figure_{int(rest[:2])}"


FIGURE_LIST = (
    Entry(
        "figure_01_oscillator",
        oscillator,
        "What stands for the structure, and what do the bolts do to it?",
        "One mode with a hysteretic element for the joint; medians of the main posterior with half "
        "of their 99 % intervals. Right, the element's force along cycles of a quarter, half and "
        "all of the largest fitted displacement: the harder the cycle, the softer and the wider.",
    ),
    Entry(
        "figure_02_procedure",
        procedure,
        "What did each step of the procedure find?",
        "From the linear regime to the prediction of hysteresis loops; medians with half of their "
        "99 % intervals, and for every sampler its verdict, the least number of effective draws "
        "and the largest R-hat.",
    ),
    Entry(
        "figure_04_linear_frf",
        linear_frf,
        "How does the structure behave when the joint is stuck?",
        "Frequency response at the lowest level with the line fit of Step 2, and the coherence. "
        "The fit should run through the points on both sides of the peak; a coherence below one "
        "at the peak tells of leakage or of hysteresis already at work.",
    ),
    Entry(
        "figure_05_softening",
        softening,
        "Does the resonance move with the level?",
        "Measured frequency responses, one line a level, each peak marked. A joint that slips "
        "pulls the peak to lower frequencies and blunts it as the level rises.",
    ),
    Entry(
        "figure_06_third_harmonic",
        harmonic_spectrum,
        "Does a tone come back with a third harmonic?",
        "Left, the response spectrum to one probing tone, ω and 3ω circled; the third harmonic "
        "has to stand clear of the floor. Right, the third-order kernel from every repeat: the "
        "scatter of the points is what the likelihood of Step 3 sees.",
    ),
    Entry(
        "figure_07_third_order_posterior",
        third_order_densities,
        "What does the third-order kernel say about ζ, α and δ?",
        "Densities relative to the prior, so that 1 means nothing learnt; bars are 99 % "
        "intervals with their medians. Narrow peaks that differ from one sampler to the other "
        "are chains that did not move, not knowledge.",
    ),
    Entry(
        "figure_08_kernel_bands",
        kernel_bands,
        "Does the model reproduce the measured kernel?",
        "Measured H₃ of every repeat beside the 99 % parameter bands of each sampler; below, both "
        "against a sampler's median, where small differences show. The bands "
        "carry the parameters' uncertainty only, no noise: single repeats scatter beyond them, "
        "but their middle should not lie outside.",
    ),
    Entry(
        "figure_09_running_means",
        running_means,
        "Have the running means settled?",
        "The paper's conv(n), one line a chain. A flat line alone proves little: lines that "
        "settle at different heights have not explored the same posterior.",
    ),
    Entry(
        "figure_10_opening_posterior",
        opening_density,
        "What does the opening of the loop say about γ?",
        "Density of γ relative to its prior, with the other parameters held at their estimates "
        "and with all of them free. The gap between the two is the price of holding parameters "
        "that were not known that well.",
    ),
    Entry(
        "figure_11_verification_frf",
        verification_frf,
        "Does the model predict the frequency response at every level?",
        "Measured FRFs against the 99 % parameter band of the model, each draw simulated under "
        "the measured input and passed through the same estimator; the lowest row is the "
        "magnitude over the model's median. Tests marked as not fitted are predictions.",
    ),
    Entry(
        "figure_12_verification_sweep",
        verification_sweep,
        "Does the model predict repeats that it never saw?",
        "From the left: the whole record, some periods around the largest response, and the same "
        "less the model's median, at a scale that shows the bands. The parameter "
        "band holds the model's uncertainty, the predictive band adds the noise and is the one "
        "that should hold 99 % of the measured points.",
    ),
    Entry(
        "figure_13_validation_loops",
        validation_loops,
        "Does the model reproduce the hysteresis loops?",
        "Restoring force against displacement; below, less the secant of the measured loop, "
        "which shows its opening. The enclosed area is the energy lost in the joint per cycle "
        "and per unit mass.",
    ),
    Entry(
        "extra_curves",
        verification_curves,
        "Does the model follow the response curves from level to level?",
        "Measured harmonics, filled circles where fitted and open triangles where held out, with "
        "the model's 99 % parameter bands, its median a line, dashed where held out; where runs "
        "shift, the bands hold the scatter of the runs. Below, how far the measured curve lies "
        "from the median, over the curve's peak.",
    ),
    Entry(
        "extra_loops",
        verification_loops,
        "Does the model follow the force along a prescribed displacement?",
        "Measured loops and the model's 99 % parameter band, beside the best linear spring. The "
        "energy lost is the work of the force over the whole record.",
    ),
    Entry(
        "extra_groups",
        verification_groups,
        "Does the model predict tests of kinds that were added to jbw?",
        "Means of the repeats over the coordinate of such a test, with the model's 99 % bands.",
    ),
    Entry(
        "extra_multisine",
        verification_multisine,
        "What does the model leave of a multisine?",
        "Left, the response around its largest swing; right, the amplitudes of the lines of one "
        "period, and of what the model and the best linear oscillator leave of them.",
    ),
    Entry(
        "extra_decay",
        verification_decay,
        "Does the model predict free decays that it never saw?",
        "From the left: the whole record in the band of the mode, some late periods, and what is "
        "left less the model's median. Of a held-out record the model sees the first part, up to "
        "the dashed line, and predicts the rest; an error of frequency builds up towards its end.",
    ),
    Entry(
        "extra_amplitude",
        amplitude_curves,
        "How do frequency and damping depend on the amplitude?",
        "Points are read from the envelopes without any model of the joint; the bands are the "
        "model's, from the equivalent stiffness and the energy lost in its steady loop. Points "
        "that leave the band on a curve tell of a joint that the law does not describe.",
    ),
    Entry(
        "extra_backbone",
        backbone,
        "What do frequency and damping become as the joint slips?",
        "Natural frequency and equivalent damping of the identified joint against amplitude. "
        "Beyond the amplitudes that were fitted (grey) the law is trusted, not tested.",
    ),
    Entry(
        "extra_ridge",
        ridge,
        "Can α and δ be told apart?",
        "Draws of α against δ. Where they lie along the dashed curve, only the product α δ is "
        "determined; strong sweeps, fitted with all parameters free, break the tie.",
    ),
    Entry(
        "extra_routes",
        routes,
        "Do the routes agree with each other?",
        "Medians and 99 % intervals of every parameter by every route, within the prior box "
        "(grey). Vertical lines are the truth, where it is known.",
    ),
    Entry(
        "extra_identifiability",
        information_spectrum,
        "Which parameters and combinations do the data know?",
        "Left, the directions in which the data say more than the prior, from the derivatives of "
        "the fit; at the line of 1 they say nothing. Right, the same for every parameter and for "
        "the products αδ and αγ, before sampling and after it. A product far to the left of its "
        "factors is what the data know; the factors are then the prior's.",
    ),
    Entry(
        "extra_profiles",
        profile_curves,
        "How far can each parameter move while the others make up for it?",
        "Least χ² with the parameter held, less the least of all. A parabola that passes the "
        "dashed line on both sides gives a 99 % interval; a curve that stays below it up to the "
        "bound is a limit that the data do not set.",
    ),
    Entry(
        "extra_trace_rank",
        trace_rank,
        "Did the chains of the main posterior mix?",
        "Good traces look alike and show no trend; good ranks stay near 1 for every chain.",
    ),
)


FIGURES: dict[str, Callable[..., Any]] = {entry.name: entry.draw for entry in FIGURE_LIST}


def __getattr__(name: str) -> Callable[..., Any]:
    if name in FIGURES:
        return FIGURES[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def figure_of(drawn: Any) -> Figure:
    """Return the figure that holds what a figure function returned."""
    return np.asarray(drawn, dtype=object).reshape(-1)[0].figure


def save_figures(tree: xr.DataTree, folder: Path, dpi: int = 130) -> None:
    """Write every figure that the result allows as PNG into a folder, made when absent."""
    folder.mkdir(parents=True, exist_ok=True)
    for entry in FIGURE_LIST:
        try:
            figure = figure_of(entry.draw(tree))
        except DataError:
            # A run that left out a step has no such figure; the page says why.
            continue
        figure.savefig(folder / f"{entry.slug}.png", dpi=dpi, facecolor="white")


def svg(figure: Figure, name: str) -> str:
    """Return a figure as an SVG element whose colours follow the page's light or dark theme.

    The name makes its ids unlike those of the page's other figures.
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
