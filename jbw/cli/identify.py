"""The commands on a campaign: `jbw identifiability, identify, demo, resume`."""

import json
import shlex
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from jbw.cli.options import json_option, out_option, outside_option, run_argument, seed_option
from jbw.cli.printing import NOT_TRUSTED, answer, verdict_lines
from jbw.cli.progress import computing
from jbw.errors import JbwError
from jbw.report.table import Table
from jbw.run.checkpoints import INTERRUPTED
from jbw.run.folder import Run, begin, reopen
from jbw.run.manifest import Manifest, command_line, machine, require_unchanged

Say = Callable[[str], None]


@click.command()
@click.argument("campaign", type=click.Path(path_type=Path))
@click.option("--profiles", is_flag=True, help="Follow the profile likelihood of every parameter.")
@seed_option("campaign")
@json_option
@outside_option
def identifiability(
    campaign: Path, profiles: bool, seed: int | None, json_: bool, allow_outside: bool
) -> None:
    """Say which parameters the data of the campaign file CAMPAIGN know.

    Fits the joint by least squares and draws nothing: the directions of the parameters in which the
    data say more than the prior, how well each parameter and product is known, and with --profiles
    how far each could move while the others make up for it.
    """
    with computing() as say:
        from jbw.campaign.load import load_campaign
        from jbw.report.identifiability import directions_table, quantities_table
        from jbw.study import identifiability as study

        say(f"Reading {campaign}")
        loaded = load_campaign(campaign, allow_outside=allow_outside)
        found = study.identifiability(loaded, profiles=profiles, seed=seed, report=say).summary()
        say("Done")
    tables = directions_table(found, {}), quantities_table(found, {})
    answer(json_, found, *tables, *found["statements"])


@click.command()
@out_option("demo")
@seed_option(default=0)
@click.option(
    "--preset",
    type=click.Choice(["laboratory", "paper"]),
    default="laboratory",
    show_default=True,
    help="Drive of the rig; with `paper` already the weakest sweep saturates the joint.",
)
@json_option
def demo(out: Path | None, seed: int, preset: str, json_: bool) -> int:
    """Measure the paper's cantilever on the virtual rig and identify it.

    Writes the records with their campaign file to OUT/campaign, and the results beside them. The
    exit code is about the joint posterior of Step 4; the paper's own Step 3 is expected to fail,
    and the report says why.
    """
    asked = Manifest(command_line(), "campaign/campaign.toml", seed=seed, preset=preset)
    return run_to_end(begin(out or Path("demo"), asked), json_=json_)


@click.command()
@click.argument("campaign", type=click.Path(path_type=Path))
@out_option("CAMPAIGN-run")
@seed_option("campaign")
@json_option
@outside_option
def identify(
    campaign: Path, out: Path | None, seed: int | None, json_: bool, allow_outside: bool
) -> int:
    """Identify the joint from the campaign file CAMPAIGN.

    Ends with 0 when the verdict of the main posterior is ok, with 4 when it is not, and with 5 when
    it was interrupted: `jbw resume` then goes on with it, as it does after a crash.
    """
    source = str(campaign.resolve())
    asked = Manifest(command_line(), source, seed=seed, allow_outside=allow_outside)
    return run_to_end(begin(out or Path(f"{campaign.stem}-run"), asked), json_=json_)


@click.command()
@run_argument
@json_option
def resume(folder: Path, json_: bool) -> int:
    """Go on with the run in the folder DIR, to the very draws of a run without a break.

    Takes everything from DIR, and refuses where the campaign, its data or the versions of jbw and
    what it computes with are no longer those that the run began with. Ends as `jbw identify`.
    """
    run = reopen(folder)
    if run is None:
        page = folder / "report.html"
        left = f"see {page}" if page.exists() else f"only its report is left, jbw report {folder}"
        click.echo(f"The run in {folder} is finished: {left}.", err=json_)
        if json_:
            click.echo((folder / "summary.json").read_text(encoding="utf-8"), nl=False)
        return 0
    try:
        _require_same(run)
    except BaseException:
        run.close()
        raise
    return run_to_end(run, json_=json_)


def _require_same(run: Run) -> None:
    if not (run.folder / "summary.json").exists():  # a result needs only its report
        require_unchanged(run.manifest, run.campaign)
    was, is_ = run.manifest.machine, machine()
    if was != is_:
        click.echo(
            f"warning: The run began on {was['name']} ({was['processors']} processors) and goes on "
            f"here, on {is_['name']} ({is_['processors']}): its draws may differ in the last "
            "digits, and chains whose start does begin again.",
            err=True,
        )


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
