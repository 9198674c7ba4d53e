"""The execution of a run in its folder, from its stored state to its report."""

import hashlib
import json
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import xarray as xr

from jbw import rig
from jbw.campaign.load import load_with_doubts
from jbw.inference.compiled import forget_when_many
from jbw.report.formats import formats_of
from jbw.report.opening import opening
from jbw.report.result import read_result
from jbw.results.run import RunSummary
from jbw.run.folder import Run, is_first_answer
from jbw.run.manifest import with_inputs
from jbw.study.identify import identify
from jbw.study.store import save_report, save_result
from jbw.study.study import input_hashes

if TYPE_CHECKING:  # Matplotlib is loaded when something is drawn.
    from jbw.report.figures import Beside

Say = Callable[[str], None]


def carried_out(
    run: Run, say: Say, beside: "Beside | None" = None
) -> tuple[RunSummary, xr.DataTree]:
    """Continue a run from its stored state to its end; return its summary and result tree.

    After a first answer only the result is written, and the run can be continued later. A second
    process, `beside`, draws some of the report's figures.
    """
    formats = formats_of(run.manifest.figures, "The manifest's `figures`")
    if (run.folder / "summary.json").exists() and not is_first_answer(run.folder):
        summary, tree = read_result(run.folder)
    else:
        forget_when_many()  # This frees compiled functions that earlier runs left in this process.
        tree, summary = identified(run, say)
        save_result(run.folder, tree, summary.plain())
        if run.manifest.quick:
            say("Done")
            return summary, tree
    if run.manifest.keep == "posterior":
        run.finish()
        say("Done")
        return summary, tree
    say("Writing figures and report")
    try:
        save_report(run.folder, tree, summary, beside, formats)
    finally:
        if not run.interruption.asked:
            run.finish()  # If the report fails, `jbw report` can write it later.
    say("Done")
    return summary, tree


def identified(run: Run, say: Say) -> tuple[xr.DataTree, RunSummary]:
    """Identify a run's campaign; if the run asks for the virtual rig, first measure on it."""
    path, request, truth = run.campaign, run.manifest, None
    if request.preset is not None:
        if not path.exists():
            say("Measuring the virtual rig")
            rig.write(rig.measure(request.preset, seed=request.seed or 0), path.parent)
        rig_truth = json.loads((path.parent / "truth.json").read_text(encoding="utf-8"))
        truth = {**rig_truth["joint"], "gain": rig_truth["gain"]}
    say(f"Reading {path}")
    loaded, doubts = load_with_doubts(path, allow_outside=request.allow_outside)
    # Print warnings at once, because the report follows only minutes later.
    for doubt in doubts:
        warnings.warn_explicit(doubt.message, doubt.category, doubt.filename, doubt.lineno)
    if request.final:
        loaded = replace(loaded, settings=loaded.settings.model_copy(update={"final": True}))
    text = path.read_text(encoding="utf-8")
    run.note(with_inputs(replace(request, text=text), path, input_hashes(loaded)))
    study = identify(
        loaded, seed=request.seed, truth=truth, report=say, keep=run.keep, command=request.command,
        quick=request.quick,
    )  # fmt: skip
    summary = study.result.replaced(
        doubts=list(dict.fromkeys(str(doubt.message) for doubt in doubts)),
        wall_time_s=round(run.spent + (study.result.wall_time_s or 0.0), 2),
        campaign_file=str(path.resolve()),
        campaign_sha256=digest_of(text),
    )
    return study.tree, summary.replaced(opening=opening(summary, study.tree))


def digest_of(text: str) -> str:
    """Return the SHA-256 hash of a campaign file's text, by which runs of it are recognised."""
    return hashlib.sha256(text.encode()).hexdigest()
