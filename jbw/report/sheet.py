"""A page of one figure, some sentences and tables: of a fleet, of a watch."""

from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from jbw.report.figures import svg
from jbw.report.page import ENVIRONMENT
from jbw.report.style import Panels
from jbw.report.table import Table
from jbw.report.words import Badge


@dataclass(frozen=True)
class Sheet:
    """What stands on the page, from above."""

    title: str
    about: str  # one line below the title
    caption: str  # of the figure
    sentences: Sequence[str]
    tables: Sequence[tuple[str, Table]]  # each with its heading
    status: Badge | None = None
    status_words: str = ""


def render_sheet(sheet: Sheet, drawn: Panels) -> str:
    """Return the page as HTML, one file that needs nothing else; names from files are escaped.

    Args:
        sheet: Everything but the figure.
        drawn: Axes of the figure, as its function returns them.
    """
    # The SVG is our own drawing of numbers, its texts outlines: safe to insert as it is.
    figure = Markup(svg(drawn.flat[0].figure, "sheet"))
    return ENVIRONMENT.get_template("sheet.html").render(sheet=sheet, figure=figure)
