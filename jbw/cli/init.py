"""`jbw init`: a commented campaign file for a folder."""

from pathlib import Path

import click

from jbw.campaign.draft import start_campaign, write_campaign
from jbw.cli.options import json_option
from jbw.cli.printing import show_json


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--print", "print_", is_flag=True, help="Print it to stdout; write nothing.")
@json_option
def init(folder: Path, print_: bool, json_: bool) -> None:
    """Look at the records in FOLDER and write FOLDER/campaign.toml.

    An existing campaign file is never overwritten. What the records do not say is marked CHECK.
    """
    draft = start_campaign(folder)
    path = None if print_ else str(write_campaign(draft, folder))
    if json_:
        found = {"campaign": path, "text": draft.text, "check": list(draft.assumed)}
        show_json(found)
        return
    click.echo(draft.text if path is None else path, nl=path is not None)
    for assumed in draft.assumed:
        click.echo(f"CHECK: {assumed}", err=True)
