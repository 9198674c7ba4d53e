"""Draws what `jbw demo` says in a terminal, from a recording of one, as docs/terminal.svg.

    script -c "jbw demo" demo.log && python docs/draw_terminal.py demo.log

What a terminal writes over, and the lines that only say that work goes on, are left out. No font or
style of another host is asked for.
"""

import re
import sys
from collections.abc import Iterable, Iterator
from io import StringIO
from pathlib import Path

from rich.console import Console
from rich.terminal_theme import MONOKAI
from rich.text import Text

WIDTH = 100
ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
STARTED = re.compile(r"\[ *[\d.]+ s\] (?!\.\.\.)")  # a step, at its time
PASSING = re.compile(r"\[ *[\d.]+ s\] \.\.\.|so far$|effective draws")
STEP = re.compile(r"\[ *[\d.]+ s\] (?!Done)")  # any line of progress, which a log may break
FONTS = re.compile(r"@font-face \{.*?\}\s*", re.DOTALL)


def lines_of(recording: str) -> Iterator[str]:
    """Lines that stay, the wrapped end of a passing one left out too."""
    for line in joined(ESCAPES.sub("", recording).replace("\r", "").splitlines()):
        if not line.strip() or line.startswith("Script ") or PASSING.search(line):
            continue
        if line.startswith(("real\t", "user\t", "sys\t")):
            continue
        yield line


def joined(lines: Iterable[str]) -> list[str]:
    """Lines of progress whole again, where a log broke them at its width."""
    found: list[str] = []
    for line in lines:
        if found and STEP.match(found[-1]) and line.strip() and not line.startswith("["):
            found[-1] = f"{found[-1].rstrip()} {line.strip()}"
        else:
            found.append(line)
    return found


def drawn(recording: str, title: str = "jbw demo") -> str:
    """The SVG; lines that begin with a dollar are what was typed."""
    console = Console(record=True, width=WIDTH, file=StringIO(), force_terminal=True)
    typed = [] if recording.startswith("$ ") else [f"$ {title}"]
    for line in (*typed, *lines_of(recording)):
        style = "dim" if STARTED.match(line) else "bold" if line.startswith("$ ") else ""
        console.print(Text(line, style="bold green" if line.startswith("Verdict") else style))
    return FONTS.sub("", console.export_svg(title=title, theme=MONOKAI))


if __name__ == "__main__":
    text = Path(sys.argv[1]).read_text(encoding="utf-8", errors="replace")
    Path(__file__).with_name("terminal.svg").write_text(drawn(text), encoding="utf-8")
