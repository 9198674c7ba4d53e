"""`jbw demo`: the virtual rig measured and identified, start to finish."""

from pathlib import Path

import click

from jbw.cli.options import json_option, seed_option
from jbw.cli.running import run_to_end
from jbw.run.folder import begin
from jbw.run.manifest import Manifest, command_line


@click.command()
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("demo"),
    show_default=True,
    help="Folder for the records and the results, new or empty.",
)
@seed_option(default=0)
@click.option(
    "--preset",
    type=click.Choice(["laboratory", "paper"]),
    default="laboratory",
    show_default=True,
    help="Drive of the rig; with `paper` already the weakest sweep saturates the joint.",
)
@json_option
def demo(out: Path, seed: int, preset: str, json_: bool) -> int:
    """Measure the paper's cantilever on the virtual rig and identify it.

    Writes the records with their campaign file to OUT/campaign, and the results beside them. The
    exit code is about the joint posterior of Step 4; the paper's own Step 3 is expected to fail,
    and the report says why.
    """
    asked = Manifest(command_line(), "campaign/campaign.toml", seed=seed, preset=preset)
    return run_to_end(begin(out, asked), json_=json_)
