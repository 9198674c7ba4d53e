"""What the commands that compute share: set up JAX, carry a run out, print the summary."""

import json
import logging
import os
import platform
import shlex
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import click
import platformdirs

from jbw.cli.printing import answer, verdict_lines
from jbw.cli.progress import Teller, progress
from jbw.errors import JbwError
from jbw.report.table import Table
from jbw.run.checkpoints import INTERRUPTED
from jbw.run.folder import Run

NOT_TRUSTED = 4
Say = Callable[[str], None]


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


@contextmanager
def computing() -> Iterator[Teller]:
    """Tells on stderr how far a command is, with JAX set up: import what uses JAX within."""
    prepare_jax()
    with progress() as say:
        yield say


def run_to_end(run: Run, *, json_: bool = False) -> int:
    """Carry a run out; when interrupted, say how to go on.

    Returns:
        Exit code: 0, 4 when the verdict of the main posterior is not ok, 5 when interrupted.
    """

    def farewell() -> str:
        return f"Saved in {run.folder}; continue: jbw resume {shlex.quote(str(run.folder))}"

    try:
        with run.interruption.heard(farewell), computing() as say:
            run.watch = say.chains
            summary = _carried_out(run, say)
    except KeyboardInterrupt:
        click.echo(farewell(), err=True)
        return INTERRUPTED
    except JbwError:
        run.discard()
        raise
    finally:
        run.close()
    told = *summary_lines(summary), *verdict_lines(summary["verdict"])
    answer(json_, summary, *told, saved=f"Report: {run.folder / 'report.html'}")
    if summary["verdict"]["status"] == "ok":
        return 0
    findings = summary["verdict"]["findings"]
    code = next((one["code"] for one in findings if one["status"] != "ok"), "")
    again = shlex.quote(str(run.folder))
    click.echo(f"Next: jbw explain {code}, or what to measure: jbw plan {again}", err=True)
    return NOT_TRUSTED


def _carried_out(run: Run, say: Say) -> Mapping[str, Any]:
    """Do what is left of a run, and return its summary."""
    from jbw.report.result import read_result
    from jbw.study.store import save_report, save_result

    if (run.folder / "summary.json").exists():
        summary, tree = read_result(run.folder)
    else:
        tree, summary = _identified(run, say)
        save_result(run.folder, tree, summary)
    say("Writing figures and report")
    try:
        save_report(run.folder, tree, summary)
    finally:
        if not run.interruption.asked:
            run.finish()  # a report that failed is `jbw report`'s to try again
    say("Done")
    return summary


def _identified(run: Run, say: Say) -> tuple[Any, dict[str, Any]]:
    """Measure the virtual rig if that is to be done, read the campaign and identify it."""
    from jbw import rig
    from jbw.campaign.load import load_campaign
    from jbw.run.manifest import with_inputs
    from jbw.study.identify import identify
    from jbw.study.study import input_hashes

    path, asked, truth = run.campaign, run.manifest, None
    if asked.preset is not None:
        if not path.exists():
            say("Measuring the virtual rig")
            rig.write(rig.measure(asked.preset, seed=asked.seed or 0), path.parent)
        known = json.loads((path.parent / "truth.json").read_text(encoding="utf-8"))
        truth = {**known["joint"], "gain": known["gain"]}
    say(f"Reading {path}")
    loaded = load_campaign(path, allow_outside=asked.allow_outside)
    with_text = replace(asked, text=path.read_text(encoding="utf-8"))
    run.note(with_inputs(with_text, path, input_hashes(loaded)))
    study = identify(
        loaded, seed=asked.seed, truth=truth, report=say, keep=run.keep, command=asked.command
    )
    return study.tree, {**study.record, "campaign_file": str(path.resolve())}


def summary_lines(summary: Mapping[str, Any]) -> Iterator[Table | str]:
    """The paper's Table 1, the statements and the prediction errors."""
    from jbw.report.tables import parameters_table, predictions_table

    yield parameters_table(summary, {})
    for part, found in (
        *summary["steps"].items(),
        ("identifiability", summary.get("identifiability") or {}),
        ("routes", summary["comparison"]),
    ):
        yield from (f"{part}: {statement}" for statement in found.get("statements", ()))
    yield predictions_table(summary)
