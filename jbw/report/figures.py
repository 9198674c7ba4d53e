"""The figures of a run, by number and by name, as pictures and as SVG.

`figures.figure_1`, `figure_2` and `figure_4` to `figure_13` are the paper's, with the run's own
numbers (its figure 3 shows the rig); the others go beyond it. ArviZ's own plots take a run's tree
as it is, as in `arviz.plot_rank(tree)`; unused here, they need pyplot and JAX and take no axes.
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

from jbw.report import (
    diagrams,
    identifiability,
    kernel,
    looking,
    loops,
    posterior,
    records,
    responses,
    stabilisation,
    style,
)


class Entry(NamedTuple):
    """One figure of the report."""

    slug: str  # its file name, without ending
    name: str  # figure_1 to figure_13 as in the paper, or its own
    draw: Callable[..., Any]  # of (tree, ax); its docstring begins with the other two
    question: str  # what it answers, its title on the page
    caption: str  # what is drawn and what to look for


def _entry(slug: str, draw: Callable[..., Any]) -> Entry:
    kind, _, rest = slug.partition("_")
    name = rest if kind == "extra" else f"figure_{int(rest[:2])}"
    question, caption, *_ = f"{draw.__doc__}\n\n".split("\n\n")
    return Entry(slug, name, draw, question, " ".join(caption.split()))


FIGURE_LIST = (
    _entry("figure_01_oscillator", diagrams.oscillator),
    _entry("figure_02_procedure", diagrams.procedure),
    _entry("extra_look", looking.look_figure),
    _entry("figure_04_linear_frf", responses.linear_frf),
    _entry("extra_stabilisation", stabilisation.diagram),
    _entry("figure_05_softening", responses.softening),
    _entry("figure_06_third_harmonic", kernel.harmonic_spectrum),
    _entry("figure_07_third_order_posterior", posterior.third_order_densities),
    _entry("figure_08_kernel_bands", kernel.kernel_bands),
    _entry("figure_09_running_means", posterior.running_means),
    _entry("figure_10_opening_posterior", posterior.opening_density),
    _entry("figure_11_verification_frf", responses.verification_frf),
    _entry("figure_12_verification_sweep", records.verification_sweep),
    _entry("figure_13_validation_loops", loops.validation_loops),
    _entry("extra_curves", responses.verification_curves),
    _entry("extra_loops", loops.verification_loops),
    _entry("extra_groups", responses.verification_groups),
    _entry("extra_multisine", records.verification_multisine),
    _entry("extra_decay", records.verification_decay),
    _entry("extra_amplitude", loops.amplitude_curves),
    _entry("extra_backbone", loops.backbone),
    _entry("extra_ridge", posterior.ridge),
    _entry("extra_routes", posterior.routes),
    _entry("extra_identifiability", identifiability.information_spectrum),
    _entry("extra_profiles", identifiability.profile_curves),
    _entry("extra_trace_rank", posterior.trace_rank),
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
        path = folder / f"{entry.slug}.png"
        try:
            figure_of(entry.draw(tree)).savefig(path, dpi=dpi, facecolor="white")
        except OSError:
            raise
        except Exception:
            # A run that left out a step has no such figure, and one that fails costs no other: the
            # page says why.
            path.unlink(missing_ok=True)


def svg(figure: Figure, name: str) -> str:
    """A figure as SVG in the page's light or dark theme; the name keeps its ids apart."""
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
