"""All figures of a run, by number and by name, as image files and as SVG.

`figures.figure_1`, `figure_2` and `figure_4` to `figure_13` are those of the paper, with the run's
own results (figure 3 of the paper shows the rig); the others are additional. ArviZ's own plots
accept a run's tree, such as `arviz.plot_rank(tree)`. They are not used here, since they need pyplot
and JAX and take no axes.
"""

import io
import json
import logging
import re
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from jbw.errors import DataError, reason_of
from jbw.report import (
    assembly,
    diagrams,
    identifiability,
    looking,
    loops,
    posterior,
    records,
    responses,
    style,
)
from jbw.report.messages import opening as messages
from jbw.run.netcdf import read_tree

under_way = logging.getLogger("jbw.progress")
DPI = 130  # resolution of a PNG
EMBEDDED = 42  # embeds fonts of a PDF as TrueType, which journals require
# Without a date, two runs write identical bytes.
DATES: dict[str, dict[str, None]] = {
    "png": {},
    "svg": {"Date": None},
    "pdf": {"CreationDate": None},
}


class ReportFigure(NamedTuple):
    """One figure of the report: its name, function, texts and group."""

    slug: str  # file name without suffix
    name: str  # "figure_1" to "figure_13" as in the paper of Teloli et al., or another name
    # Function of (tree, ax) that draws the figure; its docstring begins with question and caption.
    draw: Callable[..., Any]
    question: str  # question that the figure answers, which is its title on the page
    caption: str  # what the figure shows and what to look for
    group: str = "structure"  # group of the figure on the page, a key of `GROUPS`
    # function of (tree) that draws the tests which `draw` leaves out
    rest: Callable[..., Any] | None = None


# Names of the groups of figures on the page, with their headings, in the order of the page.
GROUPS = {
    "tests": "Model against the tests",
    "structure": "Structure and procedure",
    "posterior": "Posterior and sampling",
}


def _entry(
    slug: str, group: str, draw: Callable[..., Any], *, parted: bool = False
) -> ReportFigure:
    kind, _, rest = slug.partition("_")
    name = rest if kind == "extra" else f"figure_{int(rest[:2])}"
    question, caption, *_ = f"{draw.__doc__}\n\n".split("\n\n")
    rest = partial(draw, part="rest") if parted else None
    return ReportFigure(slug, name, draw, question, " ".join(caption.split()), group, rest)


FIGURE_LIST = (
    _entry("figure_01_oscillator", "structure", diagrams.oscillator),
    _entry("figure_02_procedure", "structure", diagrams.procedure),
    _entry("extra_assembly", "tests", assembly.structure),
    _entry("extra_joint_loops", "tests", assembly.joint_loops),
    _entry("extra_mode_backbones", "tests", assembly.mode_backbones),
    _entry("extra_look", "structure", looking.look_figure),
    _entry("figure_04_linear_frf", "structure", responses.linear_frf),
    _entry("extra_stabilisation", "structure", responses.stabilisation_diagram),
    _entry("figure_05_softening", "structure", responses.softening),
    _entry("figure_06_third_harmonic", "tests", responses.harmonic_spectrum),
    _entry("figure_07_third_order_posterior", "posterior", posterior.third_order_densities),
    _entry("figure_08_kernel_bands", "tests", responses.kernel_bands),
    _entry("figure_09_running_means", "posterior", posterior.running_means),
    _entry("figure_10_opening_posterior", "posterior", posterior.opening_density),
    _entry("figure_11_verification_frf", "tests", responses.verification_frf, parted=True),
    _entry("figure_12_verification_sweep", "tests", records.verification_sweep, parted=True),
    _entry("figure_13_validation_loops", "tests", loops.validation_loops),
    _entry("extra_curves", "tests", responses.verification_curves),
    _entry("extra_loops", "tests", loops.verification_loops),
    _entry("extra_groups", "tests", responses.verification_groups),
    _entry("extra_multisine", "tests", records.verification_multisine),
    _entry("extra_decay", "tests", records.verification_decay),
    _entry("extra_amplitude", "tests", loops.amplitude_curves),
    _entry("extra_backbone", "tests", loops.backbone),
    _entry("extra_ridge", "posterior", posterior.ridge),
    _entry("extra_routes", "posterior", posterior.routes),
    _entry("extra_identifiability", "posterior", identifiability.information_spectrum),
    _entry("extra_profiles", "posterior", identifiability.profile_curves),
    _entry("extra_trace_rank", "posterior", posterior.trace_rank),
)
FIGURES: dict[str, Callable[..., Any]] = {entry.name: entry.draw for entry in FIGURE_LIST}


def __getattr__(name: str) -> Callable[..., Any]:
    if name in FIGURES:
        return FIGURES[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def figure_of(drawn: Any) -> Figure:
    """Return the matplotlib figure that contains the axes which a figure function returned."""
    return np.asarray(drawn, dtype=object).reshape(-1)[0].figure


class DrawnFigure(NamedTuple):
    """The outcome of drawing one figure: images as SVG, or the reason why it failed."""

    svg: str = ""  # SVG in the page's themes
    rest: str = ""  # SVG with the tests that the first image leaves out, if any
    missing: str = ""  # reason why there is no image, as a sentence


class Files(NamedTuple):
    """The folder and the formats in which figures are saved as files."""

    folder: Path
    formats: Sequence[str]

    def write(self, figure: Figure, slug: str) -> None:
        """Write a figure to a file in every requested format."""
        for ending in self.formats:
            with matplotlib.rc_context({"svg.hashsalt": slug, "pdf.fonttype": EMBEDDED}):
                figure.savefig(
                    self.folder / f"{slug}.{ending}", dpi=DPI, facecolor="white",
                    metadata=DATES[ending],
                )  # fmt: skip
            # The next format reuses this layout, which takes long to compute.
            figure.set_layout_engine("none")

    def remove(self, slug: str) -> None:
        """Remove the files of a figure that failed."""
        for ending in self.formats:
            (self.folder / f"{slug}.{ending}").unlink(missing_ok=True)


class Beside(Protocol):
    """A second process that draws figures of a saved result at the same time as this process."""

    def ask(self, result: Path, names: Sequence[str], files: "Files | None") -> bool:
        """Ask the second process to draw figures by name; return False if it cannot draw them."""
        ...

    def drawn(self) -> Mapping[str, Sequence[str]]:
        """Return the figures that the second process drew, by name; empty if drawing failed."""
        ...


def draw_figures(
    tree: xr.DataTree, files: Files | None = None, beside: tuple[Beside, Path] | None = None
) -> dict[str, DrawnFigure]:
    """Draw every figure for which a result has data, and return the images by name.

    Args:
        tree: Result of the run.
        files: Folder and formats for additional files; the folder is created if necessary.
        beside: A second process and the file of the saved result. The process draws all groups
            except that of the tests, which takes as long as the other groups together. Figures that
            it does not return are drawn here.
    """
    drawn, elsewhere = {}, []
    if files is not None:
        files.folder.mkdir(parents=True, exist_ok=True)
    if beside is not None:
        process, result = beside
        names = [entry.name for entry in FIGURE_LIST if entry.group != "tests"]
        elsewhere = names if process.ask(result, names, files) else []
    for entry in FIGURE_LIST:
        if entry.name not in elsewhere:
            under_way.info("figure %s", entry.slug)
            drawn[entry.name] = _drawn(entry, tree, files)
    if elsewhere and beside is not None:
        drawn |= {name: DrawnFigure(*texts) for name, texts in beside[0].drawn().items()}
    for entry in FIGURE_LIST:
        if entry.name not in drawn:
            drawn[entry.name] = _drawn(entry, tree, files)
    return drawn


def draw_when_asked() -> None:
    """Run the second process: draw the figures that a line of standard input names."""
    # The process that asks for figures handles an interrupt and ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Standard output must contain nothing but the answer.
    answer, sys.stdout = sys.stdout, sys.stderr
    if not (line := sys.stdin.readline()):
        return
    asked = json.loads(line)
    tree = read_tree(Path(asked["result"]))
    files = None if asked["folder"] is None else Files(Path(asked["folder"]), asked["formats"])
    drawn = {
        entry.name: _drawn(entry, tree, files)
        for entry in FIGURE_LIST
        if entry.name in asked["names"]
    }
    print(json.dumps(drawn), file=answer, flush=True)


def _drawn(entry: ReportFigure, tree: xr.DataTree, files: Files | None) -> DrawnFigure:
    """Draw one figure; if this fails, return the reason, so that the rest of the report remains."""
    drawn = DrawnFigure()

    def written(figure: Figure, end: str = "") -> str:
        if files is not None:
            files.write(figure, f"{entry.slug}{end}")
        return svg(figure, f"{entry.name}{end.replace('_', '-')}")

    try:
        drawn = DrawnFigure(svg=written(figure_of(entry.draw(tree))))
        if entry.rest is None:
            return drawn
        with suppress(DataError):  # There are no more tests.
            return drawn._replace(rest=written(figure_of(entry.rest(tree)), "_rest"))
        return drawn
    except DataError as cause:  # A run that omitted a step has no figure of it.
        return drawn._replace(missing=cause.what)
    except Exception as cause:
        if files is not None and isinstance(cause, OSError):  # The file cannot be written.
            raise
        if files is not None and not drawn.svg:
            files.remove(entry.slug)
        return drawn._replace(missing=f"{messages.UNDRAWN}{reason_of(cause)}")


def svg(figure: Figure, name: str) -> str:
    """Return a figure as SVG for the page's light and dark themes; `name` makes its ids unique."""
    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "path", "svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", transparent=True, dpi=160, metadata={"Date": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    # Figures share glyphs by id; a prefix makes each figure independent of the others.
    text = re.sub(r'(\bid="|xlink:href="#|url\(#)', rf"\g<1>{name}-", text)
    for role in ("INK", "SOFT", "GRID", "BLUE", "VERMILION", "GREEN", "ORANGE", "SKY", "PURPLE"):
        text = text.replace(getattr(style, role), f"var(--{role.lower()})")
    return text
