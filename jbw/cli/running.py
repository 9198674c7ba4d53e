"""What the commands that compute share: set up JAX, say how far they are, print the summary."""

import logging
import os
import platform
import shlex
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from time import perf_counter
from typing import Any

import click
import platformdirs
from rich.console import Console
from rich.table import Table
from rich.text import Text

from jbw.errors import JbwError
from jbw.run.folder import Run
from jbw.run.interruption import INTERRUPTED

PIPE_WIDTH = 160  # columns, when stdout is no terminal
BEYOND = 1.05  # of the fitted displacement: from where on a prediction is said to extrapolate
COLUMNS = ("map", "mean", "sd", "cv", "kl", "ess_bulk", "r_hat", "truth", "z")
Say = Callable[[str], None]
STATUS = {"ok": "green", "failed": "bold red", "not assessed": "yellow"}


def prepare_jax() -> None:
    """Two host devices, so that chains run side by side, float64, and compiled code kept.

    Before JAX starts. What was compiled stays in the user's cache folder, one a machine, for the
    code holds instructions of its processor; JAX_ENABLE_COMPILATION_CACHE=0 turns that off.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if "host_platform_device_count" not in flags and (os.cpu_count() or 1) > 1:
        os.environ["XLA_FLAGS"] = f"{flags} --xla_force_host_platform_device_count=2".strip()
    import jax

    jax.config.update("jax_enable_x64", True)
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        kept = platformdirs.user_cache_path("jbw") / platform.node()
        jax.config.update("jax_compilation_cache_dir", str(kept))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    logging.getLogger("jax").setLevel(logging.ERROR)


def run_to_end(run: Run, *, json_: bool = False) -> int:
    """Carry a run out; when interrupted, say how to go on.

    Args:
        run: The run, begun or gone on with.
        json_: Print the summary as JSON instead of tables.

    Returns:
        Exit code: 0, 4 when the verdict of the main posterior is not ok, 5 when interrupted.
    """

    def farewell() -> str:
        return f"Saved in {run.folder}; continue: jbw resume {shlex.quote(str(run.folder))}"

    try:
        with run.interruption.heard(farewell), progress() as say:
            prepare_jax()
            from jbw.cli.carrying import carry_out

            return carry_out(run, say, json_=json_)
    except KeyboardInterrupt:
        click.echo(farewell(), err=True)
        return INTERRUPTED
    except JbwError:
        run.discard()
        raise
    finally:
        run.close()


@contextmanager
def progress() -> Iterator[Say]:
    """One line a stage on stderr, with the seconds since the start; warnings in the same place."""
    console = Console(stderr=True, highlight=False)
    started = perf_counter()

    def say(stage: str) -> None:
        console.print(Text(f"[{perf_counter() - started:5.1f} s] {stage}"))

    def show(message: Any, *_: Any) -> None:
        say(f"warning: {message}")

    with warnings.catch_warnings():
        warnings.showwarning = show  # restored with the filters
        yield say


def print_summary(summary: Mapping[str, Any]) -> None:
    """The paper's Table 1, the statements and the verdict, on stdout."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=PIPE_WIDTH)
    console.print(_table(summary))
    for name, step in summary["steps"].items():
        for statement in step["statements"]:
            console.print(Text(f"{name}: {statement}"))
    for sentence in summary.get("identifiability", {}).get("statements", ()):
        console.print(Text(f"identifiability: {sentence}"))
    for sentence in summary["comparison"].get("statements", ()):
        console.print(Text(f"routes: {sentence}"))
    for test, row in summary["predictions"].items():
        console.print(Text(_prediction(test, row)))
    verdict = summary["verdict"]
    console.print(
        Text.assemble("Verdict: ", (verdict["status"], STATUS[verdict["status"]])), style="bold"
    )
    for finding in verdict["findings"]:
        if finding["status"] != "ok":
            told = f"  {finding['reason']} {finding['action']} (jbw explain {finding['code']})"
            console.print(Text(told))


def _prediction(test: str, row: Mapping[str, Any]) -> str:
    """One test in a line: error, other oscillators' beside it, coverage where it is known."""
    known = "level or record fitted" if row["fitted"] else "never fitted"
    parts = [f"error {row['nrmse']:.2g} of the record"]
    others = {name: row.get(f"nrmse_{name}") for name in ("linear", "cubic")}
    beside = [f"{name} oscillator {far:.2g}" for name, far in others.items() if far is not None]
    if beside:
        parts[0] += f" ({', '.join(beside)})"
    if row.get("coverage") is not None:
        count = f"{row['num_values']:,.0f} values"
        parts.append(f"{row['coverage']:.1%} of {count} inside the 99 % band")
    if (row.get("extrapolation") or 0.0) > BEYOND:
        parts.append(f"{row['extrapolation']:.2g} times the displacement that was fitted")
    return f"{test} ({known}): {', '.join(parts)}"


def _table(summary: Mapping[str, Any]) -> Table:
    # Text, not markup: names come from files.
    table = Table(title=Text(f"Campaign {summary['campaign']}"), title_justify="left")
    table.add_column("step")
    table.add_column("parameter")
    for column in COLUMNS:
        table.add_column(column, justify="right")
    table.add_column("verdict")
    for name, step in summary["steps"].items():
        status = step.get("verdict", {}).get("status", "")
        for i, (parameter, row) in enumerate(step["parameters"].items()):
            cells = [_number(row.get(column)) for column in COLUMNS]
            first = (name, Text(status, STATUS.get(status, ""))) if i == 0 else ("", Text(""))
            table.add_row(first[0], Text(parameter), *cells, first[1])
        table.add_section()
    return table


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.5g}"
