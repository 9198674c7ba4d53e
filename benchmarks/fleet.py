"""How long do many campaigns take with two workers, by executor, and what is lost by a kill -9?

    python benchmarks/fleet.py [--json FILE]              # six campaigns of the rig, by executor
    python benchmarks/fleet.py --decays 1000 [--json FILE]    # first answers of decays; on Linux

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
from contextlib import contextmanager, nullcontext, suppress
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
from jbw.run.outcomes import progress

TORQUES = (4.0, 8.0, 12.0)  # [N m], with two assemblies at each
PLANS = tuple(
    rig.Plan(name, "sweep", Sweep(12.0, 26.0, volts, burst=6.0, fade=0.3, duration=8.0), repeats=2)
    for name, volts in (("weak", 0.05), ("strong", 0.20))
)
PRESET = replace(rig.MIXED, name="fleet", source="input", gain=15.0, plans=PLANS, input_range=1.0)
DECAYS = replace(
    PRESET, name="decays", plans=(rig.Plan(
        "decay", "decay", Sweep(18.6, 18.6, 0.1, burst=6.0, fade=0.1, duration=10.0, settle=6.0),
        repeats=3, band_hz=(15.0, 22.0),
    ),),
)  # fmt: skip
# shares of ended campaigns at which one worker is killed, and at which all are
WORKER_AT, ALL_AT = 0.3, 0.6
COMPARED = 20  # number of campaigns of which an undisturbed call must give the same draws
WAYS = {"executor": "", "wall, s": ".0f", "/ one process": ".2f", "draws": ""}
KILLS = {
    "call": "", "wall, s": ".0f", "CPU s a campaign": ".2f", "ended before": "d", "done": "d",
    "failed": "d", "GiB, largest worker": ".2f", "MB a run": ".2f",
}  # fmt: skip


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


def many_decays(number: int) -> Table:
    """Identify decays with two planted faults; kill one worker, kill all, repeat the command.

    It ends with an error if an outcome is missing, a finished run runs again, or a draw differs
    from an undisturbed call's.
    """
    rows: list[Sequence[Any]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = decays_of_the_rig(folder / "units", number)
        # A file that a copy has cut, and a channel that does not exist.
        torn = files[number // 3].parent / "decay_02.h5"
        torn.write_bytes(torn.read_bytes()[:5000])
        other = files[number // 2]
        other.write_text(other.read_text().replace('velocity = "velocity"', 'velocity = "speed"'))

        out = folder / "runs"
        process = identify([folder / "units"], out)
        while_under_way(process, out, round(WORKER_AT * number))
        os.kill(workers_of(process)[0], signal.SIGKILL)
        rows.append(watched(process, "one worker killed, then all", out, round(ALL_AT * number)))
        before = finished(out)
        rows.append(watched(identify([folder / "units"], out), "repeated", out))
        outcomes = progress(out)
        assert outcomes is not None
        failed = {Path(one.folder).name for one in outcomes.outcomes if one.status == "failed"}
        planted = {torn.parent.name, other.parent.name}
        if len(outcomes.outcomes) != number or failed != planted or outcomes.num_left:
            sys.exit(f"{len(outcomes.outcomes)} outcomes; failed: {sorted(failed)}.")
        if {name: finished(out).get(name) for name in before} != before:
            sys.exit("A finished campaign ran again.")
        rows.append(watched(identify([folder / "units"], out), "once more", out))

        again = folder / "again"
        if identify(files[:COMPARED], again).wait() != 0:
            sys.exit("A campaign failed.")
        for path in again.glob("*/posterior.nc"):
            with (
                xr.open_datatree(path) as one,
                xr.open_datatree(out / path.parts[-2] / path.name) as two,
            ):
                if not one["posterior"].to_dataset().equals(two["posterior"].to_dataset()):
                    sys.exit(f"{path.parts[-2]} has other draws than without the kills.")
        told(f"The first {COMPARED} have the draws of an undisturbed call.")
    return Table(f"{number} campaigns of three decays on two workers, --quick", KILLS, rows)


def decays_of_the_rig(folder: Path, number: int) -> list[Path]:
    """Write campaigns of three decays, at ten torques by the rig's law of the torque."""
    jbw.enable_x64()
    fleet = rig.measure_fleet(
        DECAYS, torques=np.geomspace(4.0, 12.0, 10).tolist(), assemblies=-(-number // 10), seed=1,
        how=rig.Tightening(wrench=0.03), fs=256.0, noise_ratio=0.01,
    )[:number]  # fmt: skip
    return [rig.write(one, folder / f"unit_{i:05d}") for i, one in enumerate(fleet)]


def identify(given: Sequence[Path], out: Path) -> subprocess.Popen:
    """Start the command as a user types it."""
    command = [sys.executable, "-c", "from jbw.cli import main; main()", "identify"]
    return subprocess.Popen(
        [*command, *map(str, given), "--quick", "--workers", "2", "--out", str(out)],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip


def watched(process: subprocess.Popen, call: str, out: Path, until: int | None = None) -> list[Any]:
    """Wait for the end of a call, or kill it after `until` campaigns; return its row."""
    start, before, most = time.perf_counter(), len(finished(out)), 0.0
    spent: dict[int, float] = {}
    workers: list[int] = []
    while process.poll() is None:
        with suppress(FileNotFoundError, ProcessLookupError):
            workers = workers_of(process)
            for worker in workers:
                spent[worker], used = usage_of(worker)
                most = max(most, used)
        if until is not None and len(finished(out)) >= until:
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
        time.sleep(0.2)
    while any(Path(f"/proc/{worker}").exists() for worker in workers):
        time.sleep(0.05)  # The workers end with their parent.
    ended = progress(out)
    failed = sum(one.status == "failed" for one in ended.outcomes) if ended else 0
    done = finished(out)
    each = sum(spent.values()) / max(len(done) - before + failed, 1)
    size = sum(
        file.stat().st_size for name in done for file in (out / name).iterdir() if file.is_file()
    )
    return [
        call, time.perf_counter() - start, each, before, len(done), failed, most / 2**30,
        size / 1e6 / max(len(done), 1),
    ]  # fmt: skip


def usage_of(process: int) -> tuple[float, float]:
    """Return the processor time [s] and the largest memory [B] of a process so far."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    status = Path(f"/proc/{process}/status").read_text()
    peak = next(line for line in status.splitlines() if line.startswith("VmHWM"))
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK"), 1024 * float(peak.split()[1])


def while_under_way(process: subprocess.Popen, out: Path, number: int) -> None:
    """Wait until `number` campaigns are finished."""
    while len(finished(out)) < number:
        if process.poll() is not None:
            sys.exit(f"The command ended with {process.returncode} before {number} were finished.")
        time.sleep(0.2)


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
    parser.add_argument(
        "--decays", type=int, metavar="N", help="N campaigns of decays, killed twice"
    )
    arguments = parser.parse_args()
    table = many_decays(arguments.decays) if arguments.decays else by_executor()
    show([table], ("numpyro", "distributed", "submitit"), arguments.json)


if __name__ == "__main__":
    main()
