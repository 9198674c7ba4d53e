"""When does each command print its first line, and how long is it silent? CPU seconds, Linux.

    python benchmarks/silence.py [FOLDER]

Each command runs in a separate process, in FOLDER or a temporary one, on the toy campaign of the
tests; the processor time that it had used when each line came is read from `/proc`. Output goes to
a pipe, as to a file, in which no line may be folded. Times with kept compiled code need a second
round in one FOLDER; JAX_ENABLE_COMPILATION_CACHE=0 keeps none.
"""

import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from importlib import import_module
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "study"))
TICK = os.sysconf("SC_CLK_TCK")
COLUMNS = {"command": "", "first line": ".2f", "silence": ".2f", "all": ".1f", "exit": "d"}
MOST_S = 5.0  # longest accepted silence of a command
PROGRAM = "import sys; from jbw.cli import main; main(sys.argv[1:])"


def cpu_of(pid: int) -> float:
    """Return the user and system time of a process so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICK


def watched(arguments: list[str]) -> tuple[float, float, float, int]:
    """Return a command's first line, longest silence and total [CPU s], and its exit code."""
    code = [sys.executable, "-c", PROGRAM, *arguments]
    with subprocess.Popen(code, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, cwd=ROOT) as made:
        times = [0.0]
        now = [0.0]

        def sample() -> None:
            while made.poll() is None:
                try:
                    now[0] = cpu_of(made.pid)
                except (OSError, IndexError):
                    return
                time.sleep(0.02)

        sampling = threading.Thread(target=sample, daemon=True)
        sampling.start()
        assert made.stdout is not None
        for _ in made.stdout:
            times.append(now[0])
        made.wait()
        sampling.join()
    times.append(now[0])
    gaps = [after - before for before, after in pairwise(times)]
    return times[1], max(gaps), now[0], made.returncode


def commands(campaign: Path, folder: Path) -> dict[str, list[str]]:
    """Return every command that computes, ordered so that each finds its inputs."""
    run, first = str(folder / "run"), str(folder / "first")
    fleet, file = str(folder / "fleet.nc"), str(campaign)
    return {
        "init": ["init", str(campaign.parent), "--print"],
        "check": ["check", file],
        "check --figures": ["check", file, "--figures", str(folder / "figures")],
        "look": ["look", file],
        "identifiability": ["identifiability", file],
        "identify --quick": ["identify", file, "--quick", "--out", first],
        "identify": ["identify", file, "--out", run],
        "report": ["report", run],
        "export": ["export", run],
        "predict": ["predict", run],
        "diff": ["diff", run, first],
        "collect": ["collect", run, first, "--out", fleet],
        "laws": ["laws", file, "--out", str(folder / "laws")],
        "compare": ["compare", run, "--samplers", "importance", "--out", str(folder / "compare")],
        "explain": ["explain", "alpha"],
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table; end with 1 if a command was silent for too long."""
    from timing import Table, options, show

    parser = options(__doc__, calls=1)
    parser.add_argument("folder", nargs="?", help="where to work; a temporary one when left out")
    chosen = parser.parse_args(arguments)
    toy = import_module("toy_campaign")  # the toy campaign of the tests
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(chosen.folder or temporary)
        (folder / "records").mkdir(parents=True, exist_ok=True)
        campaign = toy.write_toy(folder / "records", toy.PLAIN)
        rows = []
        for name, command in commands(campaign, folder).items():
            rows.append((name, *watched(command)))
            print(*rows[-1], file=sys.stderr, flush=True)
    show([Table("First line and longest silence [CPU s]", COLUMNS, rows)], file=chosen.json)
    sys.exit(max(row[2] for row in rows) > MOST_S)


if __name__ == "__main__":
    main()
