"""The one-page brief of a run: verdict, frequency, damping, Q, and the measurements.

The page is A4 upright, drawn by matplotlib alone. Every text is measured before it is placed, and
broken or shortened to the available width. Nothing therefore overlaps or leaves the page, whatever
names contain.
"""

import datetime
import io
import warnings
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.patches import Rectangle
from matplotlib.textpath import TextToPath

from jbw import __version__
from jbw.errors import printable
from jbw.report import style
from jbw.report.loops import backbone
from jbw.report.messages import brief as messages
from jbw.report.opening import opening
from jbw.report.result import BACKBONE, laws_of, names_of, node
from jbw.report.style import GREEN, INK, ORANGE, RC, SOFT, VERMILION
from jbw.report.tables import every_test, tests_of_records
from jbw.report.text import NOTHING, interval, length_unit, number, percent, unit_text
from jbw.report.words import badge, in_symbols, law_words
from jbw.results.attributes import StoredBackbone
from jbw.results.run import RunSummary, StoredTest

WIDTH, HEIGHT = 8.27, 11.69  # A4 [in]
MARGIN = 0.7  # empty margin on every side of the page [in]
ROOM = WIDTH - 2 * MARGIN  # width of a line of text [in]
LEADING = 1.45  # distance of two lines of text, relative to their font size
POINT = 1 / 72  # typographic point [in]
FIGURE = 3.1  # height of the backbone with its legend [in]
FOOT = 0.5  # height reserved for the final lines [in]
# amplitudes in the rows of the table, as fractions of the largest fitted amplitude
PARTS = (0.1, 0.25, 0.5, 1.0)
SIZE = 9.0  # usual size of letters [pt]
FILLED, TINY = 0.97, 1e-9  # share of a column that a long number fills; width of an empty text
SMALLEST = 0.7  # smallest letters of a table, relative to the usual size
COLOURS = {"ok": GREEN, "usable": GREEN, "failed": VERMILION}
MEASURE = TextToPath()


class Cells(NamedTuple):
    """A small table: heading, positions of its columns [fraction of the line], names and rows."""

    heading: str
    # beginning and end of each column, and its alignment
    columns: Sequence[tuple[float, float, str]]
    names: Sequence[str]
    rows: Sequence[Sequence[str]]


def write_brief(
    summary: RunSummary, tree: xr.DataTree, today: datetime.date | None = None
) -> bytes:
    """Return the brief as a PDF file with one A4 page.

    Args:
        summary: Summary of a finished run.
        tree: Result tree of the same run.
        today: The printed date; the present day when None.
    """
    figure = draw_brief(summary, tree, today)
    buffer = io.BytesIO()
    metadata = {"Title": _name(summary), "Creator": f"jbw {__version__}", "Producer": None}
    with warnings.catch_warnings(), matplotlib.rc_context({"pdf.fonttype": 42}):
        # Matplotlib draws a letter that the font lacks as a box.
        warnings.filterwarnings("ignore", message="Glyph")
        figure.savefig(buffer, format="pdf", metadata={**metadata, "CreationDate": None})
    return buffer.getvalue()


def draw_brief(
    summary: RunSummary, tree: xr.DataTree, today: datetime.date | None = None
) -> Figure:
    """Draw the brief as a figure; the arguments are those of `write_brief`."""
    figure = Figure(figsize=(WIDTH, HEIGHT))
    quantities = names_of(tree, summary)
    top = HEIGHT - MARGIN
    top = _line(figure, top, _name(summary), size=16, weight="bold")
    day = (today or datetime.date.today()).isoformat()
    law = law_words(laws_of(tree))
    top = _line(figure, top, messages.heading(day, law, __version__), color=SOFT)
    top = _verdict(figure, top - 0.1, summary, quantities)
    reasons = {finding.reason for finding in summary.verdict.findings}
    for sentence in (text for text in opening(summary, tree)[:4] if text not in reasons):
        top = _paragraph(figure, top, in_symbols(sentence, quantities), most=2)
    if node(tree, BACKBONE) is not None:
        top = _draw_backbone(figure, top - 0.05, tree)
        top = _table(figure, top, _levels(tree), most=len(PARTS))
    modes = _modes(tree)
    if modes.rows:
        top = _table(figure, top, modes, most=4)
    _table(figure, top, _measured(summary, tree), floor=MARGIN + FOOT)
    _foot(figure, summary, tree)
    return figure


def _name(summary: RunSummary) -> str:
    return " ".join(printable(summary.campaign or "Bolted joint").split())


def _verdict(figure: Figure, top: float, summary: RunSummary, quantities: Any) -> float:
    """Draw a box that states how the results may be used, and the main reason against them."""
    word = badge(summary.verdict.status).word
    use, colour = messages.USE.get(word, messages.PROVISIONAL), COLOURS.get(word, ORANGE)
    start = top
    top = _line(figure, top - 0.08, use, size=12, weight="bold", color=colour, indent=0.15)
    against = sorted(summary.verdict.against, key=lambda finding: finding.status != "failed")
    for finding in against[:1]:
        text = " ".join(filter(None, (finding.reason, finding.action)))
        top = _paragraph(figure, top, in_symbols(text, quantities), most=3, indent=0.15)
    if len(against) > 1:
        remaining = messages.more_findings(len(against) - 1)
        top = _line(figure, top, remaining, size=8.5, color=SOFT, indent=0.15)
    top -= 0.06
    bar = Rectangle(
        (MARGIN / WIDTH, top / HEIGHT), 0.06 / WIDTH, (start - top) / HEIGHT, color=colour, lw=0,
        transform=figure.transFigure,
    )  # fmt: skip
    figure.add_artist(bar)
    return top - 0.1


def _draw_backbone(figure: Figure, top: float, tree: xr.DataTree) -> float:
    """Draw the backbone against amplitude: frequency, damping ratio, measured points, legend."""
    indent, gap, below = 0.62, 0.75, 0.78
    wide = (ROOM - indent - gap) / 2
    high = FIGURE - below
    axes = []
    with matplotlib.rc_context(RC):
        for i in range(2):
            x = MARGIN + indent + i * (wide + gap)
            place = (x / WIDTH, (top - high) / HEIGHT, wide / WIDTH, (high - 0.05) / HEIGHT)
            axes.append(figure.add_axes(place))
    backbone(tree, axes)
    for ax in axes:
        ax.tick_params(labelsize=8, color=SOFT)
        ax.grid(True, color=style.GRID, linewidth=0.6)
        ax.xaxis.label.set_size(8.5)
        ax.yaxis.label.set_size(8.5)
        if (legend := ax.get_legend()) is not None:
            legend.remove()
    handles, labels = axes[0].get_legend_handles_labels()
    named = {label: handle for label, handle in zip(labels, handles, strict=True)}
    figure.legend(
        named.values(), named, loc="upper left", ncols=4, fontsize=7.5, frameon=False,
        borderaxespad=0.0, handlelength=1.6, columnspacing=1.2,
        bbox_to_anchor=(MARGIN / WIDTH, (top - high - 0.42) / HEIGHT),
    )  # fmt: skip
    rows = -(-len(named) // 4)
    return top - high - 0.42 - 0.16 * rows - 0.1


def _levels(tree: xr.DataTree) -> Cells:
    """Return a table of frequency, damping and Q at fractions of the largest amplitude."""
    curve = tree[BACKBONE].to_dataset()
    y_peak = StoredBackbone.of(curve).y_fitted
    factor, unit = length_unit(y_peak)
    at = curve.interp(amplitude=[part * y_peak for part in PARTS])
    frequency, damping = (
        np.asarray(at[name].transpose("amplitude", "quantile"), float)
        for name in ("frequency", "damping")
    )
    first = frequency[0, 1]
    rows = []
    for part, (low, hertz, high), (least, ratio, most) in zip(
        PARTS, frequency, damping, strict=True
    ):
        # Q falls where the damping rises, so the ends of the interval are exchanged. Q is infinite
        # without damping.
        quality = NOTHING if least <= 0 else _interval(*(0.5 / x for x in (most, ratio, least)))
        rows.append(
            (
                f"{factor * part * y_peak:.3g} {unit}",
                _interval(low, hertz, high),
                percent(hertz / first - 1.0, digits=2),
                _interval(100 * least, 100 * ratio, 100 * most),
                quality,
            )
        )
    return Cells(
        messages.levels(several_modes=bool(_modes(tree).rows)),
        ((0.0, 0.13, "left"), (0.14, 0.42, "right"), (0.43, 0.51, "right"), (0.52, 0.78, "right"),
         (0.79, 1.0, "right")),
        ("amplitude", "frequency [Hz]", "shift", "damping ratio [%]", "Q = 1/(2 ζ)"),
        rows,
    )  # fmt: skip


def _interval(low: float, middle: float, high: float) -> str:
    """Format a value with its interval; the width of the interval determines the digits."""
    widened = max(0.2, 1e-4 * abs(middle) / (high - low)) if high > low else 0.2
    return interval(low, middle, high, widened)


def _modes(tree: xr.DataTree) -> Cells:
    """Return a table of all modes at small motion; empty for a structure with one mode."""
    group = node(tree, "posterior")
    drawn = {} if group is None else group.to_dataset().data_vars
    pairs = [("omega_n", "zeta"), *((f"omega_{k}", f"zeta_{k}") for k in range(2, 20))]
    modal = [pair for pair in pairs if all(name in drawn for name in pair)]
    rows = []
    for i, (omega, zeta) in enumerate(modal if len(modal) > 1 else (), start=1):
        hertz, ratio = (
            np.quantile(np.ravel(drawn[name]), (0.005, 0.5, 0.995)) for name in (omega, zeta)
        )
        shown = _interval(*(hertz / (2 * np.pi))), _interval(*(100 * ratio))
        rows.append((f"mode {i}", *shown, f"{0.5 / ratio[1]:.3g}"))
    return Cells(
        messages.MODES,
        ((0.0, 0.13, "left"), (0.14, 0.42, "right"), (0.52, 0.78, "right"), (0.79, 1.0, "right")),
        ("", "frequency [Hz]", "damping ratio [%]", "Q"),
        rows,
    )


def _measured(summary: RunSummary, tree: xr.DataTree) -> Cells:
    """Return a table of the measured tests; tests of equal kind and level share one line."""
    read = {row.test: row for row in summary.look.tests}
    families: dict[tuple[str, float, bool], list[StoredTest]] = {}
    every = every_test(summary, tree)
    records = tests_of_records(every)
    worst: dict[str, float] = {}
    for row in every:
        if (test := records.get(row.test)) is not None:
            worst[test.test] = max(row.nrmse or 0.0, worst.get(test.test, 0.0))
    for row in every:
        if row.test in records:
            continue
        key = row.kind, np.nan if row.level is None else row.level, bool(row.fitted)
        with_worst = row.replaced(nrmse=worst.get(row.test, row.nrmse))
        families.setdefault(key, []).append(with_worst)
    rows = []
    for (kind, level, is_fitted), tests in sorted(
        families.items(), key=lambda family: str(family[0])
    ):
        seen = [read[row.test] for row in tests if row.test in read]
        unit = unit_text(tests[0].level_unit)
        largest = max((row.y_max for row in seen if row.y_max is not None), default=None)
        factor, length = length_unit(largest or 1.0)
        rows.append(
            (
                kind.replace("_", " "),
                NOTHING if np.isnan(level) else f"{level:.3g} {unit}".rstrip(),
                str(len(tests)),
                "fitted" if is_fitted else "held out",
                NOTHING if largest is None else f"{number(factor * largest, digits=2)} {length}",
                _mean(row.frequency_hz for row in seen),
                _mean(row.damping and 100.0 * row.damping for row in seen),
                _worst(tests),
            )
        )
    return Cells(
        messages.MEASURED,
        ((0.0, 0.15, "left"), (0.16, 0.27, "right"), (0.28, 0.35, "right"), (0.38, 0.5, "left"),
         (0.51, 0.61, "right"), (0.62, 0.73, "right"), (0.74, 0.86, "right"), (0.87, 1.0, "right")),
        ("kind of test", "level", "tests", "used as", "motion", "freq. [Hz]", "damping [%]",
         "model error"),
        rows,
    )  # fmt: skip


def _mean(column: Iterable[float | None]) -> str:
    values = [value for value in column if value is not None]
    return number(float(np.mean(values)), digits=4) if values else NOTHING


def _worst(rows: Sequence[StoredTest]) -> str:
    errors = [row.nrmse for row in rows if row.nrmse is not None]
    return percent(max(errors), digits=2) if errors else NOTHING


def _foot(figure: Figure, summary: RunSummary, tree: xr.DataTree) -> None:
    """Draw the final lines of the brief: how to read results, and which run they come from."""
    created_at = (
        str(tree["posterior"].attrs.get("created_at", "")) if "posterior" in tree.children else ""
    )
    run = f"Identified {created_at[:10]}. " if created_at else ""
    digest = summary.campaign_sha256[:12]
    campaign = f"Campaign {digest}. " if digest else ""
    seed = "" if summary.seed is None else f"Seed {summary.seed}. "
    top = MARGIN + FOOT - 0.12
    top = _line(figure, top, messages.FOOT, size=7.5, color=SOFT)
    _line(figure, top, f"{run}{campaign}{seed}".strip(), size=7.5, color=SOFT)


def _table(
    figure: Figure, top: float, cells: Cells, most: int = 99, floor: float = MARGIN
) -> float:
    """Draw a table on the brief with as many rows as fit; return the height at which it ends."""
    if not cells.rows:
        return top
    height = SIZE * POINT * LEADING
    room = int((top - floor - 2.6 * height) / height)
    count = min(len(cells.rows), most, max(room, 0))
    if count < 1:
        return top
    shown = list(cells.rows[:count])
    more = None
    if count < len(cells.rows):
        remaining = messages.more_lines(len(cells.rows) - count + 1)
        more = shown[-1] = (remaining, *[""] * (len(cells.names) - 1))
    top = _line(figure, top - 0.04, cells.heading, size=9.5, weight="bold")
    for row, colour in ((cells.names, SOFT), *((row, INK) for row in shown)):
        for text, (start, end, side) in zip(row, cells.columns, strict=True):
            room = ROOM if row is more else ROOM * (end - start)
            # A long number is written in a smaller font: a truncated number would be wrong.
            fits = FILLED * room / max(_width(str(text), SIZE), TINY)
            size = SIZE * min(1.0, max(SMALLEST, fits))
            shortened = _shortened(str(text), room if fits >= 1.0 else FILLED * room, size)
            place = start if side == "left" else end
            _put(figure, MARGIN + place * ROOM, top, shortened, color=colour, ha=side, size=size)
        top -= height
    return top - 0.06


def _line(figure: Figure, top: float, text: str, indent: float = 0.0, **look: Any) -> float:
    """Write one line on the brief, shortened to the page's width; return the next line's height."""
    size = float(look.get("size", SIZE))
    shortened = _shortened(text, ROOM - indent, size, str(look.get("weight", "normal")))
    _put(figure, MARGIN + indent, top, shortened, **look)
    return top - size * POINT * LEADING


def _paragraph(figure: Figure, top: float, text: str, most: int, indent: float = 0.0) -> float:
    """Write a text on the brief in at most `most` lines; return the height of the next line."""
    for line in _broken(text, ROOM - indent, SIZE, most):
        top = _line(figure, top, line, indent=indent)
    return top - 0.03


def _put(figure: Figure, x: float, top: float, text: str, **look: Any) -> None:
    """Write a text on a figure at a position [in]; dollar signs do not begin formulas."""
    if text:
        figure.text(
            x / WIDTH,
            top / HEIGHT,
            text,
            va="top",
            parse_math=False,
            **{"size": SIZE, "color": INK, **look},
        )


def _broken(text: str, width: float, size: float, most: int) -> list[str]:
    """Wrap a text into lines of a width [in]; shorten the last line if the text is too long."""
    lines = [""]
    words = list(_pieces(printable(text).split(), width, size))
    for i, word in enumerate(words):
        longer = f"{lines[-1]} {word}".strip()
        if _width(longer, size) <= width:
            lines[-1] = longer
        elif len(lines) < most:
            lines.append(word)
        else:
            lines[-1] = _shortened(" ".join([lines[-1], *words[i:]]), width, size)
            break
    return lines


def _pieces(words: Sequence[str], width: float, size: float) -> Iterator[str]:
    """Yield the words of a text; split words that are longer than a line."""
    for word in words:
        while _width(word, size) > width:
            count = next(
                n for n in range(len(word) - 1, 0, -1) if n == 1 or _width(word[:n], size) <= width
            )
            yield word[:count]
            word = word[count:]
        yield word


def _shortened(text: str, width: float, size: float, weight: str = "normal") -> str:
    """Return a text that fits into a width [in]; a text that is too long ends with an ellipsis."""
    text = " ".join(printable(text).split())
    if _width(text, size, weight) <= width:
        return text
    low, high = 0, len(text)
    while low < high:  # A binary search finds the longest beginning of the text that fits.
        middle = (low + high + 1) // 2
        fits = _width(f"{text[:middle].rstrip()}…", size, weight) <= width
        low, high = (middle, high) if fits else (low, middle - 1)
    return f"{text[:low].rstrip()}…"


def _width(text: str, size: float, weight: str = "normal") -> float:
    """Return the printed width of a line [in]."""
    font = FontProperties(size=size, weight=weight)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")
        return MEASURE.get_text_width_height_descent(text, font, ismath=False)[0] * POINT
