"""The commands that carry a run to its end: `jbw demo`, `jbw identify` and `jbw resume`."""

from pathlib import Path

import click

from jbw.cli.options import json_option, out_option, outside_option, seed_option
from jbw.cli.running import run_to_end
from jbw.run.folder import Run, begin, reopen
from jbw.run.manifest import Manifest, command_line, machine, require_unchanged


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
@click.argument(
    "folder", metavar="RUN", type=click.Path(exists=True, file_okay=False, path_type=Path)
)
@json_option
def resume(folder: Path, json_: bool) -> int:
    """Go on with the run in the folder RUN, to the very draws of a run without a break.

    Takes everything from RUN, and refuses where the campaign, its data or the versions of jbw and
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
