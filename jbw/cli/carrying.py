"""What `demo`, `identify` and `resume` share: a run carried out, or what is left of it."""

import json
import shlex
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import click
import xarray as xr

from jbw import rig
from jbw.campaign.loading import Campaign, load_campaign
from jbw.cli.running import print_summary
from jbw.report.result import read_result
from jbw.run.folder import Run
from jbw.run.manifest import with_inputs
from jbw.study.identify import identify, input_hashes
from jbw.study.storage import save_report, save_result

NOT_TRUSTED = 4
Say = Callable[[str], None]


def carry_out(run: Run, say: Say, *, json_: bool = False) -> int:
    """Do what is left of a run.

    Args:
        run: The run, begun or gone on with.
        say: Called with one sentence at every stage.
        json_: Print the summary as JSON instead of tables.

    Returns:
        Exit code: 0, or 4 when the verdict of the main posterior is not ok.
    """
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
    if json_:
        click.echo(json.dumps(summary, indent=1, ensure_ascii=False))
    else:
        print_summary(summary)
        click.echo(f"Report: {run.folder / 'report.html'}")
    if summary["verdict"]["status"] == "ok":
        return 0
    findings = summary["verdict"]["findings"]
    code = next((one["code"] for one in findings if one["status"] != "ok"), "")
    again = shlex.quote(str(run.folder))
    click.echo(f"Next: jbw explain {code}, or what to measure: jbw plan {again}", err=True)
    return NOT_TRUSTED


def _identified(run: Run, say: Say) -> tuple[xr.DataTree, dict[str, Any]]:
    truth = None
    if run.manifest.preset is not None:
        truth = _measured(run, run.manifest.preset, say)
    say(f"Reading {run.campaign}")
    study = identify(
        _loaded(run), seed=run.manifest.seed, truth=truth, report=say,
        keep=run.keep, command=run.manifest.command,
    )  # fmt: skip
    return study.tree, {**study.record, "campaign_file": str(run.campaign.resolve())}


def _measured(run: Run, preset: str, say: Say) -> dict[str, float]:
    """Measure the virtual rig if that was not done, and say what is true of it."""
    path = run.campaign
    if not path.exists():
        say("Measuring the virtual rig")
        rig.write(rig.measure(preset, seed=run.manifest.seed or 0), path.parent)
    truth = json.loads((path.parent / "truth.json").read_text(encoding="utf-8"))
    return {**truth["joint"], "gain": truth["gain"]}


def _loaded(run: Run) -> Campaign:
    """The campaign, and in the manifest what it was made of."""
    path = run.campaign
    loaded = load_campaign(path, allow_outside=run.manifest.allow_outside)
    known = replace(run.manifest, text=path.read_text(encoding="utf-8"))
    run.note(with_inputs(known, path, input_hashes(loaded)))
    return loaded
