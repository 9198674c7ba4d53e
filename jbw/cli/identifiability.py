"""`jbw identifiability CAMPAIGN.toml`: which parameters the data know, before any sampling."""

from pathlib import Path

import click

from jbw.cli.options import json_option, outside_option, seed_option
from jbw.cli.printing import answer
from jbw.cli.running import computing


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
