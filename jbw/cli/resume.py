"""`jbw resume RUN`: go on with a run that was killed or interrupted."""

from pathlib import Path

import click

from jbw.cli.options import json_option
from jbw.cli.running import run_to_end
from jbw.run.folder import Run, reopen
from jbw.run.manifest import machine, require_unchanged


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
