"""How long do many campaigns take with two workers, by executor, and what is lost by a kill -9?

    python benchmarks/fleet.py [--json FILE]              # six campaigns of the rig, by executor
    python benchmarks/fleet.py --hundred [--json FILE]    # a hundred short ones; on Linux

Executors run one after the other, each without compiled code; Dask and submitit only if installed
(`pip install "dask[distributed]" submitit`).
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from timing import Table, options, show

import jbw
from jbw import rig
from jbw.rig.generator import Sweep

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "study"))
from damper_campaign import write_campaign

TORQUES = (4.0, 8.0, 12.0)  # [N m], with two assemblies at each
PLANS = tuple(
    rig.Plan(name, "sweep", Sweep(12.0, 26.0, volts, burst=6.0, fade=0.3, duration=8.0), repeats=2)
    for name, volts in (("weak", 0.05), ("strong", 0.20))
)
PRESET = replace(rig.MIXED, name="fleet", source="input", gain=15.0, plans=PLANS, input_range=1.0)
# Sampling all points at once takes the least time; kills occur between and within campaigns.
SHORT = """num_samples = 100
num_chains = 2
sampler = "importance"
model_error = "none"
offsets = "none"
"""
# number of campaigns, and numbers of finished campaigns at which a process is killed
MANY, PARENT_AT, WORKER_AT = 100, 30, 60
WAYS = {"executor": "", "wall, s": ".0f", "/ one process": ".2f", "draws": ""}
KILLS = {"pass": "", "wall, s": ".0f", "finished before": "d", "run": "d", "failed": "d"}


def six_of_the_rig(folder: Path) -> list[Path]:
    """Write campaign files of three torques and two assemblies, by the rig's law of the torque."""
    jbw.enable_x64()
    fleet = rig.measure_fleet(
        PRESET, torques=TORQUES, assemblies=2, seed=1,
        how=rig.Tightening(wrench=0.03), fs=256.0, noise_ratio=0.05,
    )  # fmt: skip
    return [rig.write(one, folder / f"unit_{i}") for i, one in enumerate(fleet)]


@contextmanager
def dask(folder: Path) -> Iterator[Any]:
    """Yield an executor of Dask with two processes of one thread each."""
    from distributed import Client, LocalCluster

    one_thread = {"n_workers": 2, "threads_per_worker": 1, "processes": True}
    with (
        LocalCluster(**one_thread, dashboard_address=None, local_directory=str(folder)) as cluster,
        Client(cluster) as client,
    ):
        yield client.get_executor()


def submitit(folder: Path) -> Any:
    """Return an executor with one process per job, all at once, in place of a queue."""
    from submitit import AutoExecutor

    executor = AutoExecutor(folder, cluster="local")
    executor.update_parameters(timeout_min=60)
    return nullcontext(executor)


def by_executor() -> Table:
    """Return the times of six campaigns by executor, and whether all draws are equal."""
    ways: dict[str, Callable[[Path], Any]] = {"one process": lambda _: nullcontext()}
    ways |= {"two processes": lambda _: nullcontext()}
    ways |= {"Dask, two workers": dask, "submitit, local, six jobs at once": submitit}
    needs = {dask: "distributed", submitit: "submitit"}
    rows: list[Sequence[Any]] = []
    first: xr.DataTree | None = None
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = six_of_the_rig(folder / "campaigns")
        for number, (way, executor_in) in enumerate(ways.items()):
            if find_spec(needs.get(executor_in, "jbw")) is None:
                rows.append((way, None, None, "not installed"))
                continue
            place = folder / str(number)
            with nothing_compiled(place / "cache"):
                start = time.perf_counter()
                with executor_in(place / "executor") as executor:
                    workers = None if executor else number + 1
                    outcomes = jbw.identify_many(
                        files, place / "runs", executor=executor, workers=workers, report=told
                    )
                seconds = time.perf_counter() - start
            require_done(outcomes)
            fleet = comparable(jbw.fleet_of(one.folder for one in outcomes))
            first = first or fleet
            least = rows[0][1] if rows else seconds
            rows.append(
                (way, seconds, seconds / least, "equal" if fleet.equals(first) else "other")
            )
    return Table("Six campaigns of the rig, of a weak and a strong sweep each", WAYS, rows)


@contextmanager
def nothing_compiled(folder: Path) -> Iterator[None]:
    """Give workers an empty folder for compiled code through the environment that they inherit."""
    wanted = {
        "JAX_COMPILATION_CACHE_DIR": str(folder),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    before = {name: os.environ.get(name) for name in wanted}
    os.environ |= wanted
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name)
            else:
                os.environ[name] = value


def told(sentence: str) -> None:
    print(sentence, file=sys.stderr, flush=True)


def require_done(outcomes: Sequence[Any]) -> None:
    """End with the errors of failed campaigns, if any."""
    if failed := [f"{one.folder}: {one.error}" for one in outcomes if one.status != "done"]:
        sys.exit("\n".join(failed))


def comparable(fleet: xr.DataTree) -> xr.DataTree:
    """Return a fleet without the paths of its runs."""
    for unit in fleet.coords["unit"].values:
        fleet[unit].attrs.clear()
    return fleet


def killed_twice() -> Table:
    """Run a hundred short campaigns: kill the parent, then one worker, then continue all.

    It ends with an error if a finished run runs again, or a draw differs from an undisturbed
    call's.
    """
    rows: list[Sequence[Any]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = [short(folder / f"unit_{i:02d}", i) for i in range(MANY)]
        killed, whole = folder / "killed", folder / "whole"

        start = time.perf_counter()
        process = identify(files, killed)
        while_under_way(process, killed, PARENT_AT)
        workers = workers_of(process)
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        while any(Path(f"/proc/{worker}").exists() for worker in workers):
            time.sleep(0.05)  # The workers end with their parent.
        before = finished(killed)
        rows.append(("killed as a whole", time.perf_counter() - start, 0, len(before), 0))

        start = time.perf_counter()
        process = identify(files, killed)
        while_under_way(process, killed, WORKER_AT)
        os.kill(workers_of(process)[0], signal.SIGKILL)
        failed = process.wait() not in (0, 4)
        after = finished(killed)
        rows.append(
            ("again, one worker killed", time.perf_counter() - start, len(before),
             len(after) - len(before), MANY - len(after))
        )  # fmt: skip
        if failed or {name: after.get(name) for name in before} != before:
            sys.exit("A campaign failed, or a finished one ran again.")

        start = time.perf_counter()
        if identify(files, whole).wait() not in (0, 4):
            sys.exit("A campaign failed.")
        rows.append(("undisturbed", time.perf_counter() - start, 0, len(finished(whole)), 0))
        fleets = [
            comparable(jbw.fleet_of(sorted(p.parent for p in each.glob("*/summary.json"))))
            for each in (killed, whole)
        ]
        if not fleets[0].identical(fleets[1]):
            sys.exit("The fleet is not that of an undisturbed call.")
        told(f"Both fleets are identical: {fleets[0].sizes['unit']} units, every draw and number.")
    return Table("A hundred short campaigns on two workers, killed by kill -9", KILLS, rows)


def short(folder: Path, number: int) -> Path:
    """Write a campaign of prescribed loops, with its own amplitude, noise and torque."""
    folder.mkdir()
    path = write_campaign(folder, 5e-3 * (1 + 0.003 * number), settings=SHORT, seed=number)
    torque = np.round(np.geomspace(2.0, 12.0, MANY)[number], 3)
    path.write_text(f"{path.read_text()}\n[assembly]\ntorque = {torque}\n")
    return path


def identify(files: Sequence[Path], out: Path) -> subprocess.Popen:
    """Start the command as a user types it."""
    command = [sys.executable, "-c", "from jbw.cli import main; main()", "identify"]
    return subprocess.Popen(
        [*command, *map(str, files), "--workers", "2", "--out", str(out)],
        stdout=subprocess.DEVNULL,
    )


def while_under_way(process: subprocess.Popen, out: Path, number: int) -> None:
    """Wait until `number` campaigns are finished."""
    while len(finished(out)) < number:
        if process.poll() is not None:
            sys.exit(f"The command ended with {process.returncode} before {number} were finished.")
        time.sleep(0.05)


def finished(out: Path) -> dict[str, int]:
    """Return the finished runs, with the times at which their summaries were written."""
    return {path.parent.name: path.stat().st_mtime_ns for path in out.glob("*/summary.json")}


def workers_of(process: subprocess.Popen) -> list[int]:
    """Return the spawned workers of a process, recognised by their command lines."""
    children: list[int] = []
    for task in Path(f"/proc/{process.pid}/task").iterdir():
        children += map(int, (task / "children").read_text().split())
    return [one for one in children if b"spawn_main" in Path(f"/proc/{one}/cmdline").read_bytes()]


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--hundred", action="store_true", help="a hundred short ones, killed twice")
    arguments = parser.parse_args()
    table = killed_twice() if arguments.hundred else by_executor()
    show([table], ("numpyro", "distributed", "submitit"), arguments.json)


if __name__ == "__main__":
    main()
