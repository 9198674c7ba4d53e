"""Run the pages of docs/laboratories and keep what their commands print, and a run's first figure.

    python docs/run_laboratories.py hammer curves     # or all of them, without names

Each page holds its records as a Python block, a campaign file and commands. They are run in a
folder of their own, each command in a process of its own, as a reader would. Of each
`docs/laboratories/shown` holds what it prints, its seconds, those of the processor and its largest
memory, with the hash of the blocks that they come from; the page shows the outputs between its own
marks.
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
from time import perf_counter

PAGES = Path(__file__).with_name("laboratories")
SHOWN = PAGES / "shown"
MARK = re.compile(r"<!-- shown (\w+) -->\n.*?<!-- end -->", re.DOTALL)
FIGURE = "The first figure of the report: the joint that was identified"
CAPTION = (
    "*The first figure of `run/report.html`. "
    "`python docs/run_laboratories.py` runs the commands on this page and writes this figure and "
    "the outputs above.*"
)
CALL = "import sys; from jbw.cli import run; sys.exit(run(sys.argv[1:]))"
WIDTH = "100"  # columns of the terminal that the output is for


def blocks(page: Path, language: str) -> list[str]:
    """The blocks of a page in a language."""
    text = page.read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def source_of(page: Path) -> str:
    """The hash of all that is run."""
    run = [block for language in ("python", "toml", "sh") for block in blocks(page, language)]
    return hashlib.sha256("\0".join(run).encode()).hexdigest()


def commands(page: Path) -> list[list[str]]:
    """Every command of a page, as its words."""
    lines = [line for block in blocks(page, "sh") for line in block.splitlines()]
    return [shlex.split(line, comments=True) for line in lines if line.strip()]


def prepare(page: Path, folder: Path) -> None:
    """Write a page's records and its campaign file into a folder, by its own blocks."""
    (code,), (campaign,) = blocks(page, "python"), blocks(page, "toml")
    subprocess.run([sys.executable, "-c", code], cwd=folder, check=True)
    (target,) = {Path(words[2]) for words in commands(page)}
    (folder / target).write_text(campaign, encoding="utf-8")


def printed(words: list[str], folder: Path) -> dict[str, object]:
    """What a command prints, its exit code, seconds, processor seconds and largest memory [MB]."""
    env = {**os.environ, "NO_COLOR": "1", "COLUMNS": WIDTH}
    began = perf_counter()
    with tempfile.TemporaryFile("w+") as output:
        process = subprocess.Popen(
            [sys.executable, "-c", CALL, *words[1:]], cwd=folder, env=env, stdout=output
        )
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        text = output.read().rstrip()
    return {
        "command": shlex.join(words), "code": process.returncode, "text": text,
        "seconds": round(perf_counter() - began),
        "cpu_seconds": round(used.ru_utime + used.ru_stime),
        "memory_mb": round(used.ru_maxrss / 1024),
    }  # fmt: skip


def keep(page: Path) -> None:
    """Run a page and keep what it shows."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        prepare(page, folder)
        shown = [printed(words, folder) for words in commands(page)]
        found = {"source": source_of(page), "shown": shown}
        printed(["jbw", "report", "run", "--figures", "png"], folder)
        SHOWN.mkdir(exist_ok=True)
        text = json.dumps(found, indent=1, ensure_ascii=False)
        (SHOWN / f"{page.stem}.json").write_text(text + "\n", encoding="utf-8")
        shutil.copy(first_figure(folder / "run"), SHOWN / f"{page.stem}.png")
    text = page.read_text(encoding="utf-8")
    page.write_text(with_outputs(page, text), encoding="utf-8")


def with_outputs(page: Path, text: str) -> str:
    """The text of a page with what its commands printed, and its figure, between its marks."""
    shown = json.loads((SHOWN / f"{page.stem}.json").read_text(encoding="utf-8"))["shown"]
    inside = {str(n): f"```text\n{one['text']}\n```" for n, one in enumerate(shown, 1)}
    inside["figure"] = f"![{FIGURE}](shown/{page.stem}.png)\n\n{CAPTION}"
    return MARK.sub(lambda mark: f"<!-- shown {mark[1]} -->\n{inside[mark[1]]}\n<!-- end -->", text)


def first_figure(run: Path) -> Path:
    """The figure that stands first in a run's report."""
    from jbw.report.opening import lead
    from jbw.report.result import read_result

    figures = {path.stem.removeprefix("extra_"): path for path in run.glob("figures/*.png")}
    name = lead(read_result(run)[0], list(figures))
    if name is None:
        raise SystemExit(f"The run in {run} has no first figure.")
    return figures[name]


def main(names: list[str]) -> None:
    """Run the pages of these names, all without any."""
    for page in sorted(PAGES.glob("*.md")):
        if not names or page.stem in names:
            keep(page)
            print(page.stem, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
