"""What the commands that compute share: set up JAX, carry a run out, print the summary."""

import logging
import os
import platform
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

import click
import platformdirs
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from jbw.cli.printing import console, number
from jbw.cli.progress import progress
from jbw.errors import JbwError
from jbw.run.folder import Run
from jbw.run.interruption import INTERRUPTED

BEYOND = 1.05  # of the fitted displacement: from where on a prediction is said to extrapolate
COLUMNS = ("map", "mean", "sd", "cv", "kl", "ess_bulk", "r_hat", "truth", "z")
SPARED = ("kl", "map", "cv", "z", "truth", "ess_bulk")  # where the screen is narrow, in this order
DIGITS = {"sd": 3, "cv": 2, "kl": 3, "ess_bulk": 4, "r_hat": 4, "z": 3}  # five of the others
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
            run.watch = say.chains
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


def print_summary(summary: Mapping[str, Any]) -> None:
    """The paper's Table 1, the statements and the verdict, on stdout."""
    screen = console()
    screen.print(_fitting(screen, summary))
    for name, step in summary["steps"].items():
        for statement in step["statements"]:
            screen.print(Text(f"{name}: {statement}"))
    for sentence in summary.get("identifiability", {}).get("statements", ()):
        screen.print(Text(f"identifiability: {sentence}"))
    for sentence in summary["comparison"].get("statements", ()):
        screen.print(Text(f"routes: {sentence}"))
    for test, row in summary["predictions"].items():
        screen.print(Text(_prediction(test, row)))
    verdict = summary["verdict"]
    screen.print(
        Text.assemble("Verdict: ", (verdict["status"], STATUS[verdict["status"]])), style="bold"
    )
    for finding in verdict["findings"]:
        if finding["status"] != "ok":
            told = f"  {finding['reason']} {finding['action']} (jbw explain {finding['code']})"
            screen.print(Text(told))


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


def _fitting(screen: Console, summary: Mapping[str, Any]) -> Table:
    """Table 1 with as many columns as the screen has room for, none of them cut."""
    boundless = screen.options.update(max_width=10_000)
    for count in range(len(SPARED) + 1):
        table = _table(summary, [one for one in COLUMNS if one not in SPARED[:count]])
        if screen.measure(table, options=boundless).maximum <= screen.width:
            return table
    return table


def _table(summary: Mapping[str, Any], columns: Sequence[str]) -> Table:
    title = f"Campaign {summary['campaign']}"
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1))
    table.add_column("step", overflow="fold")
    table.add_column("parameter", overflow="fold")
    for column in columns:
        table.add_column(column, justify="right", overflow="fold")
    table.add_column("verdict")
    for name, step in summary["steps"].items():
        status = step.get("verdict", {}).get("status", "")
        for i, (parameter, row) in enumerate(step["parameters"].items()):
            cells = [number(row.get(column), DIGITS.get(column, 5)) for column in columns]
            first = (name, Text(status, STATUS.get(status, ""))) if i == 0 else ("", Text(""))
            table.add_row(first[0], parameter, *cells, first[1])
        table.add_section()
    return table
