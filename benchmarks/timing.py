"""The timing and printing of the benchmarks: contenders take turns, tables are in Markdown."""

import argparse
import json
import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

Contenders = Mapping[str, Callable[[], Any]]


class Times(NamedTuple):
    """The times of one call [s]: the least of all calls, and their median."""

    least: float
    median: float


class Table(NamedTuple):
    """A table: its title, its rows, and the heading and number format of each column."""

    title: str
    columns: Mapping[str, str]
    rows: Sequence[Sequence[Any]]


class Target(NamedTuple):
    """A ratio and the limit that it must keep; `at_most` is False for a lower limit."""

    name: str
    measured: float | None
    reach: float
    stretch: float | None
    at_most: bool = True


def options(description: str | None, calls: int = 31) -> argparse.ArgumentParser:
    """Return the command-line parser that all benchmarks share.

    Args:
        description: Docstring of the script, whose first line is the question.
        calls: Default number of calls of each contender.

    Returns:
        The parser, to which a script may add options.
    """
    parser = argparse.ArgumentParser(description=(description or "").split("\n")[0])
    parser.add_argument("--calls", type=int, default=calls, help="calls of each contender")
    parser.add_argument("--json", type=Path, help="also write the tables to this file")
    return parser


def take_turns(
    contenders: Contenders,
    calls: int,
    in_a_row: int = 1,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, Times]:
    """Time the contenders in alternation, so that a slow period of the machine affects them all.

    Args:
        contenders: Calls by name, whose results are awaited. Each is called once before timing.
        calls: Smallest number of timed calls of each contender.
        in_a_row: Calls in each turn, of which the first finds the caches cold.
        clock: Clock in seconds; `time.process_time` omits the time of other processes.

    Returns:
        Least and median time of each contender.
    """
    for run in contenders.values():
        jax.block_until_ready(run())
    elapsed = {name: [] for name in contenders}
    for _ in range(-(-calls // in_a_row)):
        for name, run in contenders.items():
            elapsed[name] += [_seconds(run, clock) for _ in range(in_a_row)]
    return {name: Times(min(t), float(np.median(t))) for name, t in elapsed.items()}


def ahead(function: Callable, *arguments: Any) -> tuple[Callable, float]:
    """Return the function compiled in advance for such arguments, and the compilation time [s]."""
    start = time.perf_counter()
    run = jax.jit(function).lower(*arguments).compile()
    return run, time.perf_counter() - start


def compiled(function: Callable, *arguments: Any) -> Callable[[], Any]:
    """Return the call function(*arguments), compiled in advance."""
    run, _ = ahead(function, *arguments)
    return lambda: run(*arguments)


def targets(entries: Sequence[Target]) -> Table:
    """Return a table of measured ratios next to their targets."""
    columns = {"target": "", "measured": ".3g", "reach": "g", "stretch": "g", "result": ""}
    rows = [(t.name, t.measured, t.reach, t.stretch, _result(t)) for t in entries]
    return Table("Targets", columns, rows)


def show(tables: Sequence[Table], packages: Sequence[str] = (), file: Path | None = None) -> None:
    """Print the machine and the tables as Markdown; write them also to `file` if one is given."""
    print(machine(packages))
    for table in tables:
        print(f"\n{table.title}\n\n{markdown(table)}")
    if file is not None:
        content = {
            "machine": machine(packages),
            "tables": {
                t.title: [dict(zip(t.columns, row, strict=True)) for row in t.rows] for t in tables
            },
        }
        file.write_text(json.dumps(content, indent=1) + "\n")


def markdown(table: Table) -> str:
    """Return a table as Markdown; None is an empty cell, and text is printed unchanged."""
    lines = [list(table.columns), ["---"] * len(table.columns)]
    for row in table.rows:
        pairs = zip(row, table.columns.values(), strict=True)
        lines.append([_cell(value, form) for value, form in pairs])
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def machine(packages: Sequence[str] = ()) -> str:
    """Return one line with processor, cores, and the versions that matter."""
    names = ("jax", "diffrax", "numpy", *packages)
    versions = [f"{name} {_version(name)}" for name in names]
    cores = f"{os.cpu_count()} cores"
    return ", ".join([_processor(), cores, f"Python {platform.python_version()}", *versions])


def _seconds(run: Callable[[], Any], clock: Callable[[], float]) -> float:
    start = clock()
    jax.block_until_ready(run())
    return clock() - start


def _result(target: Target) -> str:
    if target.measured is None:
        return "not measured"
    sign = 1.0 if target.at_most else -1.0
    for bound, word in ((target.stretch, "stretch reached"), (target.reach, "reached")):
        if bound is not None and sign * target.measured <= sign * bound:
            return word
    return "not reached"


def _cell(value: Any, form: str) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else format(value, form)


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or platform.machine()


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
