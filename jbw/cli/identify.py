"""`jbw identify CAMPAIGN.toml`: the whole procedure on any campaign."""

from pathlib import Path

import click

from jbw.cli.options import json_option, outside_option, seed_option
from jbw.cli.running import run_to_end
from jbw.run.folder import begin
from jbw.run.manifest import Manifest, command_line


@click.command()
@click.argument("campaign", type=click.Path(path_type=Path))
@click.option(
    "--out", type=click.Path(path_type=Path), help="Folder for the results, new or empty."
)
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
    asked = Manifest(
        command_line(), str(campaign.resolve()), seed=seed, allow_outside=allow_outside
    )
    return run_to_end(begin(out or Path(f"{campaign.stem}-run"), asked), json_=json_)
