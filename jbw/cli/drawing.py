"""A second process that draws some of a report's figures, while the command draws the others."""

import json
import os
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from jbw.report.figures import Files

PROGRAM = "import jbw.report.figures; jbw.report.figures.draw_when_asked()"


class DrawingProcess:
    """A process that draws figures: it loads its modules at once, then waits for requests.

    It ends when its input closes, and so with the command, however the command ends. If it cannot
    be started or fails, it returns nothing, and the command draws all figures itself.
    """

    def __init__(self, *, wanted: bool = True) -> None:
        self._wanted = wanted and os.cpu_count() != 1
        self._process: Popen[str] | None = None

    def __enter__(self) -> Self:
        command = [sys.executable, "-c", PROGRAM]
        if self._wanted:
            with suppress(OSError):
                self._process = Popen(
                    command, stdin=PIPE, stdout=PIPE, stderr=DEVNULL, encoding="utf-8"
                )
        return self

    def __exit__(self, *_: object) -> None:
        if self._process is None:
            return
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):  # Unsent data is not needed any more.
                if pipe is not None:
                    pipe.close()

    def ask(self, result: Path, names: Sequence[str], files: "Files | None") -> bool:
        """Ask for figures of a saved result by name; return False if the process has ended."""
        if self._process is None or self._process.stdin is None:
            return False
        folder, formats = (None, ()) if files is None else files
        asked = {
            "result": str(result), "names": list(names),
            "folder": None if folder is None else str(folder), "formats": list(formats),
        }  # fmt: skip
        try:
            print(json.dumps(asked), file=self._process.stdin, flush=True)
        except OSError:
            return False
        return True

    def drawn(self) -> Mapping[str, Any]:
        """Return image and text of each figure that the process has drawn, by name."""
        if self._process is None or self._process.stdout is None:
            return {}
        try:
            return json.loads(self._process.stdout.readline())
        except ValueError:  # The process failed: its answer is empty or incomplete.
            return {}
