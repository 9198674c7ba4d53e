"""Run what pages of docs/howto show, and keep what it prints.

    jbw demo && python docs/run_howto.py demo   # or some pages: python docs/run_howto.py demo steps

A page asks by `<!-- shown COMMAND -->` for the output of a command, and by `<!-- shown python -->`
for what its Python blocks above print as one session. Both run in a folder that holds the
demonstration as `demo`, for commands as `run` too, and its campaign and records beside them.
`howto/shown.json` holds the outputs with the hash of what was run; the pages show them between
their own marks.
"""

import hashlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

PAGES = Path(__file__).with_name("howto")
SHOWN = PAGES / "shown.json"
MARK = re.compile(r"<!-- shown ([^>]+?) -->\n.*?<!-- end -->", re.DOTALL)
PYTHON = "python"
BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)
CALL = "import sys; from jbw.cli import run; sys.exit(run(sys.argv[1:]))"
WIDTH = "100"  # columns of the terminal that the output is for
KEPT = 30  # lines of an output that a page shows


def asked(page: Path) -> dict[str, list[str]]:
    """What a page shows by its mark, as words for a Python of its own."""
    text = page.read_text(encoding="utf-8")
    found = {}
    for mark in MARK.finditer(text):
        above = "\n".join(BLOCK.findall(text[: mark.start()]))
        is_python = mark[1] == PYTHON
        found[mark[1]] = ["-c", above] if is_python else ["-c", CALL, *shlex.split(mark[1])[1:]]
    return found


def source_of(page: Path) -> str:
    """The hash of all that is run for a page."""
    return hashlib.sha256(json.dumps(asked(page)).encode()).hexdigest()


def prepare(demo: Path, folder: Path, mark: str) -> None:
    """A folder as the pages have it, of a finished demonstration; Python saves `run` itself."""
    shutil.copytree(demo / "campaign", folder, dirs_exist_ok=True)
    for name in ("demo",) if mark == PYTHON else ("demo", "run"):
        shutil.copytree(demo, folder / name)


def printed(words: list[str], folder: Path) -> str:
    """What a Python prints in a folder; it has to end with 0."""
    env = {**os.environ, "NO_COLOR": "1", "COLUMNS": WIDTH}
    done = subprocess.run(
        [sys.executable, *words], cwd=folder, env=env, stdout=subprocess.PIPE, text=True, check=True
    )
    lines = [line.rstrip() for line in done.stdout.strip("\n").splitlines()]
    return "\n".join(lines if len(lines) <= KEPT else [*lines[: KEPT - 1], "..."])


def kept() -> dict[str, dict]:
    """What is kept of each page."""
    return json.loads(SHOWN.read_text(encoding="utf-8")) if SHOWN.is_file() else {}


def with_outputs(page: Path) -> str:
    """The text of a page with its outputs between its marks."""
    shown = kept().get(page.stem, {"shown": {}})["shown"]

    def filled(mark: re.Match[str]) -> str:
        return f"<!-- shown {mark[1]} -->\n```text\n{shown[mark[1]]}\n```\n<!-- end -->"

    return MARK.sub(filled, page.read_text(encoding="utf-8"))


def keep(page: Path, demo: Path) -> None:
    """Run what a page shows, and write it there."""
    shown = {}
    for mark, words in asked(page).items():
        with tempfile.TemporaryDirectory() as place:
            prepare(demo, Path(place), mark)
            shown[mark] = printed(words, Path(place))
    everything = {**kept(), page.stem: {"source": source_of(page), "shown": shown}}
    text = json.dumps(dict(sorted(everything.items())), indent=1, ensure_ascii=False)
    SHOWN.write_text(text + "\n", encoding="utf-8")
    page.write_text(with_outputs(page), encoding="utf-8")


def main(demo: Path, names: list[str]) -> None:
    """Run the pages of these names, all without any."""
    for page in sorted(PAGES.glob("*.md")):
        if asked(page) and (not names or page.stem in names):
            keep(page, demo.resolve())
            print(page.stem, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
