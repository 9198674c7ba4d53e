"""The table of recorders of docs/howto/recorders.md, from the docstrings of their files.

python docs/recorders_table.py        # prints it
python docs/recorders_table.py --write
"""

import inspect
import re
import sys
from importlib import import_module
from pathlib import Path

from jbw.measurement.recorders import modules

PAGE = Path(__file__).parent / "howto" / "recorders.md"
BEGIN, END = "<!-- recorders -->\n", "<!-- end of recorders -->\n"
FACTS = ("Files", "Recognised by", "Names", "Units", "Rate", "Start", "Based on", "Untested")


def facts_of(text: str) -> dict[str, str]:
    """Title and facts of a docstring."""
    title, _, rest = inspect.cleandoc(text).partition("\n")
    found = {"Recorder": title.rstrip(".")}
    for block in re.split(r"\n(?=[A-Z][a-z ]+: )", "\n" + rest.strip()):
        name, _, what = block.strip().partition(": ")
        if name in FACTS:
            found[name] = " ".join(what.split())
    return found


def table() -> str:
    """A section a recorder, with a line a fact."""
    sections = []
    for name in modules():
        found = facts_of(import_module(name).__doc__ or "")
        lines = [f"### {found['Recorder']}", ""]
        lines += [f"* **{fact}**: {found[fact]}" for fact in FACTS]
        sections.append("\n".join(lines) + "\n")
    return "\n".join(sections)


def with_table(page: str) -> str:
    """The page with the table as it is now."""
    before, _, rest = page.partition(BEGIN)
    return before + BEGIN + "\n" + table() + "\n" + END + rest.partition(END)[2]


if __name__ == "__main__":
    if "--write" in sys.argv:
        PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    else:
        print(table())
