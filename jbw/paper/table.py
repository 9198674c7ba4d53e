"""The equations (1) to (42) of Teloli et al. with the functions that compute them."""

import re
from importlib import import_module
from typing import NamedTuple

LAST = 42
# A line such as "Eqs. (10)-(13), (24), corrected: why." below `Reference:`; several are allowed.
_SECTION = re.compile(r"^Reference:\n((?:    .*\n?)+)", re.MULTILINE)
_ENTRY = re.compile(
    r"Eqs?\. (\(\d+\)(?:(?:-|, | and )\(\d+\))*)"
    r"(?:, (as printed|corrected|replaced)(?:[:;,] (.*?)| (for .*?|from .*?|where .*?))?)?\.?\s*$"
)
_SPAN = re.compile(r"\((\d+)\)(?:-\((\d+)\))?")


class Equation(NamedTuple):
    """One equation of Teloli et al. with a function that computes it.

    Attributes:
        number: Number of the equation, 1 to 42.
        function: Public name, such as `jbw.paper.branch`.
        status: "as printed", "corrected", or "replaced" by a better formula.
        note: Error of the printed equation, or another remark; may be empty.
    """

    number: int
    function: str
    status: str
    note: str


def equations() -> tuple[Equation, ...]:
    """Return the table of the equations of Teloli et al. and the functions that compute them.

    Returns:
        Rows in the order of the equations; one equation may have several functions.
    """
    import jbw

    paper = import_module("jbw.paper")
    named = {f"jbw.paper.{name}": getattr(paper, name) for name in paper.__all__}
    seen = set(map(id, named.values()))
    for name in jbw.__all__:
        if id(public := getattr(jbw, name)) not in seen:
            named[f"jbw.{name}"] = public
    rows = [row for name, public in named.items() for row in rows_of(name, public.__doc__ or "")]
    return tuple(sorted(rows, key=lambda row: row.number))


def rows_of(function: str, docstring: str) -> list[Equation]:
    """Return the equations of Teloli et al. to which a function's docstring refers."""
    import inspect

    section = _SECTION.search(inspect.cleandoc(docstring))
    if section is None:
        return []
    text = re.sub(r"\s+", " ", section[1]).strip()
    rows = []
    for entry in re.split(r"(?<=\.) (?=Eqs?\. \()", text):
        if (match := _ENTRY.fullmatch(entry)) is None:
            continue
        status, note = match[2] or "as printed", match[3] or match[4] or ""
        rows += [Equation(number, function, status, note) for number in numbers(match[1])]
    return rows


def numbers(text: str) -> list[int]:
    """Return the numbers in a list of equations, such as (3)-(6), (9)."""
    spans = ((int(first), int(last or first)) for first, last in _SPAN.findall(text))
    return [number for first, last in spans for number in range(first, last + 1)]
