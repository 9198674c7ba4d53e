"""`jbw schema`: what a campaign or plan file may hold, as JSON Schema."""

import json

import click

from jbw.campaign.document import json_schema


@click.command()
@click.argument("file", type=click.Choice(["campaign", "plan"]), default="campaign")
@click.option("--json", is_flag=True, expose_value=False, help="Print JSON, as without it.")
def schema(file: str) -> None:
    """Print the JSON Schema of a campaign file, or of a plan file.

    An editor that knows JSON Schema for TOML then completes keys, shows what they mean and marks
    what is wrong: write `jbw schema > campaign.schema.json`, and as the file's first line
    `#:schema campaign.schema.json` (Even Better TOML, taplo, tombi).
    """
    if file == "plan":
        from jbw.planning.description import plan_file

        model = plan_file()
    else:
        from jbw.campaign.schema import CampaignFile

        model = CampaignFile
    click.echo(json.dumps(json_schema(model), indent=1, ensure_ascii=False))
