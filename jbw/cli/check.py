"""`jbw check`: one table, channel by channel, and pictures of the channels when asked for."""

import json
from collections.abc import Iterator
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table
from rich.text import Text

from jbw.campaign.checking import Check, Row, as_json, check_campaign
from jbw.campaign.loading import test_names
from jbw.campaign.repeats import repeats_of
from jbw.campaign.schema import read_spec
from jbw.errors import RunError, printable
from jbw.measurement.records import Record

COLOURS = {"ok": "green", "warning": "yellow", "error": "bold red"}
PIPE_WIDTH = 160  # columns, when stdout is no terminal and has no width of its own


@click.command()
@click.argument("campaign", type=click.Path(path_type=Path))
@click.option(
    "--figures",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Draw each test's first record into DIR: channels in time, spectra, spectrograms.",
)
@click.option("--json", "json_", is_flag=True, help="Print JSON instead of a table.")
@click.option("--allow-outside", is_flag=True, help="Read files outside the campaign's folder.")
def check(campaign: Path, figures: Path | None, json_: bool, allow_outside: bool) -> int:
    """Check the campaign file CAMPAIGN and all of its channels.

    Ends with 0 when it can be identified, 2 when the campaign file must change, 3 when data must.
    """
    found = check_campaign(campaign, allow_outside=allow_outside)
    if json_:
        click.echo(json.dumps(as_json(found), indent=2, ensure_ascii=False))
    else:
        _print(found)
    if figures is not None:
        count = _draw(campaign, figures, allow_outside)
        click.echo(f"{count} figure{'s' if count != 1 else ''} in {figures}", err=json_)
    return found.exit_code


def _draw(campaign: Path, folder: Path, allow_outside: bool) -> int:
    """Draw what could be read, and return how many figures there are."""
    from jbw.report.overview import save_overviews  # loads matplotlib, which the table needs not

    try:
        return len(save_overviews(_first_records(campaign, allow_outside), folder))
    except OSError as error:
        raise RunError(
            f"The figures cannot be written to {folder}: {error.strerror or error}.",
            remedy="Choose another folder with --figures.",
        ) from error


def _first_records(campaign: Path, allow_outside: bool) -> Iterator[tuple[str, Record]]:
    """Each test's name and the first of its repeats that can be read."""
    spec = read_spec(campaign)
    folder = campaign.resolve().parent
    for test, name in zip(spec.tests, test_names(spec), strict=True):
        items = repeats_of(test, name, folder, allow_outside=allow_outside)
        record = next((item for item in items if isinstance(item, Record)), None)
        if record is not None:
            yield name, record


def _print(found: Check) -> None:
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=PIPE_WIDTH)
    table = Table(title=Text(f"Campaign {printable(found.campaign)}"), title_justify="left")
    for heading in ("test", "channel", "role", "unit"):
        table.add_column(heading, overflow="fold")
    table.add_column("fs", justify="right")
    table.add_column("repeats", justify="right")
    table.add_column("status")
    for row in found.rows:
        table.add_row(*_cells(row))
    console.print(table)
    for row in found.rows:
        for finding in row.findings:
            console.print(Text(f"{finding.severity}", COLOURS[finding.severity]), end=" ")
            # Text, not markup, and no control characters: names come from files.
            console.print(Text(printable(f"{row.test}, {row.channel}: {finding.what}")))
            for line in filter(None, (finding.why, finding.remedy)):
                console.print(Text(f"    {printable(line)}"))


def _cells(row: Row) -> list[Text]:
    fs = "" if row.fs is None else f"{row.fs:.7g} Hz"
    plain = [Text(printable(cell)) for cell in (row.test, row.channel, row.role, row.unit, fs)]
    return [*plain, Text(str(row.repeats)), Text(row.status, COLOURS[row.status])]
