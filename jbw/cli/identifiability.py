"""`jbw identifiability CAMPAIGN.toml`: which parameters the data know, before any sampling."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
from rich.table import Table
from rich.text import Text

from jbw.cli.printing import console, number
from jbw.cli.progress import progress
from jbw.cli.running import prepare_jax


@click.command()
@click.argument("campaign", type=click.Path(path_type=Path))
@click.option("--profiles", is_flag=True, help="Follow the profile likelihood of every parameter.")
@click.option("--seed", type=int, help="Seed of the starts; the campaign's when left out.")
@click.option("--json", "json_", is_flag=True, help="Print JSON instead of tables.")
@click.option("--allow-outside", is_flag=True, help="Read files outside the campaign's folder.")
def identifiability(
    campaign: Path, profiles: bool, seed: int | None, json_: bool, allow_outside: bool
) -> int:
    """Say which parameters the data of the campaign file CAMPAIGN know.

    Fits the joint by least squares and draws nothing: the directions of the parameters in which the
    data say more than the prior, how well each parameter and product is known, and with --profiles
    how far each could move while the others make up for it.
    """
    prepare_jax()
    from jbw.campaign.loading import load_campaign
    from jbw.study import identifiability as study

    with progress() as say:
        say(f"Reading {campaign}")
        loaded = load_campaign(campaign, allow_outside=allow_outside)
        found = study.identifiability(loaded, profiles=profiles, seed=seed, report=say).summary()
        say("Done")
    if json_:
        click.echo(json.dumps(found, indent=1, ensure_ascii=False, allow_nan=False))
    else:
        print_identifiability(found)
    return 0


def print_identifiability(found: Mapping[str, Any]) -> None:
    """Print the spectrum, what is known, and both in words.

    Args:
        found: `identifiability` of a summary.
    """
    screen = console()
    screen.print(_spectrum(found))
    screen.print(_known(found))
    for statement in found["statements"]:
        screen.print(Text(statement))


def _spectrum(found: Mapping[str, Any]) -> Table:
    table = Table(title="Information spectrum, strongest direction first", title_justify="left")
    table.add_column("combination")
    for heading in ("information / prior's", "sd / prior sd"):
        table.add_column(heading, justify="right")
    for row in found["spectrum"]:
        table.add_row(row["combination"], f"{row['information']:.3g}", f"{row['ratio']:.2g}")
    return table


def _known(found: Mapping[str, Any]) -> Table:
    table = Table(title="Parameters and combinations", title_justify="left")
    table.add_column("name")
    for heading in ("fit", "sd", "sd / value", "sd / prior sd", "99 % by the profile"):
        table.add_column(heading, justify="right")
    for name, row in {**found["parameters"], **found["combinations"]}.items():
        cells = [number(row[key]) for key in ("value", "sd")]
        relative = "" if row["relative"] is None else f"{100 * row['relative']:.2g} %"
        profile = _interval(found["profiles"].get(name))
        table.add_row(row["text"], *cells, relative, f"{row['ratio']:.2g}", profile)
    return table


def _interval(profile: Mapping[str, Any] | None) -> str:
    """The interval of a profile, open sides without a number."""
    if profile is None:
        return ""
    ends = zip(profile["interval"], profile["open"], strict=True)
    low, high = ("open" if is_open else f"{end:.6g}" for end, is_open in ends)
    return f"{low} to {high}"
