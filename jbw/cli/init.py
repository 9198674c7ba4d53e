"""`jbw init`: a commented campaign file for a folder."""

from pathlib import Path

import click

from jbw.campaign.starting import start_campaign, write_campaign


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--print", "print_", is_flag=True, help="Print it to stdout; write nothing.")
def init(folder: Path, print_: bool) -> None:
    """Look at the records in FOLDER and write FOLDER/campaign.toml.

    An existing campaign file is never overwritten. What the records do not say is marked CHECK.
    """
    draft = start_campaign(folder)
    if print_:
        click.echo(draft.text, nl=False)
    else:
        click.echo(str(write_campaign(draft, folder)))
    for assumed in draft.assumed:
        click.echo(f"CHECK: {assumed}", err=True)
