"""Commands to use before a run: `jbw init` drafts a campaign file, `jbw check` examines it."""

from collections.abc import Iterator, Sequence
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jbw.cli.options import campaign_argument, json_option, outside_option
from jbw.cli.printing import answer, following, show_json
from jbw.errors import RunError
from jbw.report.messages import commands, tables
from jbw.report.messages.stages import drawing_records
from jbw.report.table import Cell, Column, Table, table

if TYPE_CHECKING:  # These modules load SciPy, which takes a second.
    from jbw.campaign.check import Check, Row
    from jbw.campaign.draft import Draft
    from jbw.campaign.joints import JointsCheck
    from jbw.measurement.records import Record

MARKS = {"ok": "good", "warning": "doubt", "error": "bad"}


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option(
    "--print", "print_", is_flag=True, help="Print the draft to stdout and write no file."
)
@click.option(
    "--ask",
    is_flag=True,
    help="Ask for the facts that the records do not state, one by one; Enter keeps a value.",
)
@json_option
def init(folder: Path, print_: bool, ask: bool, json_: bool) -> None:
    """Read the records in FOLDER and write FOLDER/campaign.toml.

    An existing campaign file is never overwritten. Facts that the records do not state are marked
    CHECK. If FOLDER contains only folders of records, each of them gets a campaign file.
    """
    from jbw.campaign.document import campaign_in
    from jbw.campaign.draft import folders_of_records

    several = [path for path in folders_of_records(folder) if campaign_in(path) is None]
    drafts = [_draft(each, print_, ask, json_) for each in several or [folder]]
    if json_:
        show_json(drafts if several else drafts[0])


def _draft(folder: Path, print_: bool, ask: bool, json_: bool) -> dict[str, Any]:
    """Draft the campaign of one folder of records, and write it; print it unless for JSON."""
    from jbw.campaign.draft import start_campaign, write_campaign

    if ask:
        require_unwritten(folder, print_)
    draft = asked_about(folder) if ask else start_campaign(folder)
    path = None if print_ else str(write_campaign(draft, folder))
    if not json_:
        click.echo(draft.text if path is None else path, nl=path is not None)
        for assumed in draft.assumed:
            click.echo(f"CHECK: {assumed}", err=True)
    if path is not None:
        following("check", path)
    return {"campaign": path, "text": draft.text, "check": list(draft.assumed)}


def require_unwritten(folder: Path, print_: bool) -> None:
    """Raise an error, before any question is asked, if the campaign file already exists."""
    from jbw.campaign.document import NAMED
    from jbw.campaign.draft import already_written

    if not print_ and (folder / NAMED).exists():
        raise already_written(folder / NAMED)


def asked_about(folder: Path) -> "Draft":
    """Return the draft of a campaign file with the user's answers, and its lines still in doubt.

    Questions go to stderr, so that the output of --print and --json is unchanged.
    """
    from jbw.campaign.asked import answered, channels_named_by, still_doubtful
    from jbw.campaign.draft import Draft, start_campaign

    def ask(question: str) -> str:
        click.echo(question, nl=False, err=True)
        return input()

    def tell(sentence: str) -> None:
        click.echo(sentence, err=True)

    tell(commands.MISSING_FACTS)
    draft = start_campaign(folder, channels_named_by(ask, tell))
    text = answered(draft.text, ask, tell)
    return Draft(text, tuple(still_doubtful(text)))


@click.command()
@campaign_argument
@click.option(
    "--figures",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Draw each test's first record into DIR: channels in time, spectra, spectrograms.",
)
@json_option
@outside_option
def check(campaign: Path, figures: Path | None, json_: bool, allow_outside: bool) -> int:
    """Check a CAMPAIGN (a campaign file or its folder) and all of its channels.

    Exit code: 0 if the campaign can be identified, 2 if the campaign file must change, 3 if the
    data must change.
    """
    from jbw.campaign.check import as_json, check_campaign

    checked = check_campaign(campaign, allow_outside=allow_outside)
    shaker_notes = _shakers(campaign, allow_outside)
    answer(
        json_,
        as_json(checked) | {"shakers": shaker_notes},
        *_lines(checked),
        *checked.seen,
        *shaker_notes,
    )
    if figures is not None:
        from jbw.cli.progress import telling

        try:
            with telling(drawing_records(str(figures))):
                from jbw.report.looking import save_overviews  # loads matplotlib

                count = len(save_overviews(_first_records(campaign, allow_outside), figures))
        except OSError as error:
            raise RunError(
                f"The figures cannot be written to {figures}: {error.strerror or error}.",
                remedy="Choose another folder with --figures.",
            ) from error
        click.echo(f"{count} figure{'s' if count != 1 else ''} in {figures}", err=json_)
    if checked.exit_code == 0:
        following("look", campaign)
    else:
        following("check", campaign, ", after the correction")
    return checked.exit_code


def _shakers(campaign: Path, allow_outside: bool) -> list[str]:
    """Return a sentence on the shaker of each test that measured voltage, force and drive point."""
    from jbw.campaign.schema import read_spec

    tests = {test.name: test for test in read_spec(campaign).tests}
    if not any("drive_point" in test.channels for test in tests.values()):
        return []
    from jbw.study.look import read_of_shaker  # loads the fitting code

    records = _first_records(campaign, allow_outside)
    return [
        read_of_shaker(tests[name], record)
        for name, record in records
        if "drive_point" in record.channels
    ]


def _first_records(campaign: Path, allow_outside: bool) -> "Iterator[tuple[str, Record]]":
    """Yield each test's name and its first readable record."""
    from jbw.campaign.files import repeats_of
    from jbw.campaign.schema import read_spec
    from jbw.measurement.records import Record

    spec = read_spec(campaign)
    folder = campaign.resolve().parent
    for test in spec.tests:
        items = repeats_of(test, folder, allow_outside=allow_outside)
        record = next((item for item in items if isinstance(item, Record)), None)
        if record is not None:
            yield test.name, record


def _lines(checked: "Check") -> Iterator[Table | str]:
    """Yield the table of channels, the tables of joints, and lines of findings."""
    names = ("test", "channel", "role", "unit")
    columns = [Column(name, attrgetter(name), align="left") for name in names]
    columns += [
        Column("fs", lambda row: "" if row.fs is None else f"{row.fs:.7g} Hz"),
        Column("repeats", lambda row: str(row.repeats)),
        Column("status", lambda row: Cell(row.status, MARKS[row.status]), align="left"),
    ]
    yield table(f"Campaign {checked.campaign}", checked.rows, *columns)
    if checked.joints is not None:
        yield from _joints(checked.joints)
    yield from finding_lines(checked.rows)


def _joints(joints: "JointsCheck") -> Iterator[Table | str]:
    """Yield the table of modes with joints' energy shares, the table of the matrix B, and notes."""
    separability = joints.separability
    rows = list(enumerate(joints.frequencies_hz))
    columns = [
        Column("mode", lambda row: str(row[0] + 1)),
        Column("frequency", lambda row: f"{row[1]:.5g} Hz"),
        Column("swept", lambda row: "yes" if row[0] in joints.swept else "no", align="left"),
    ]
    if joints.shares is not None:
        shares = joints.shares
        columns += [
            Column(f"energy share of {name}", lambda row, j=j: f"{100 * shares[j, row[0]]:.2g} %")
            for j, name in enumerate(joints.joints)
        ]
    yield table(tables.MODES_IN_STICK, rows, *columns)
    if separability is not None:
        part = dict(zip(separability.modes, separability.over_largest, strict=True))
        columns = [
            columns[0],
            *(
                Column(name, lambda row, j=j: f"{part[row[0]][j]:.2g}")
                for j, name in enumerate(separability.joints)
            ),
        ]
        swept = [row for row in rows if row[0] in part]
        yield table(tables.MATRIX_B, swept, *columns)
        yield commands.condition_number(f"{separability.condition:.3g}")
    yield from joints.notes


def finding_lines(rows: "Sequence[Row]") -> Iterator[str]:
    """Yield one line per finding, with the names of all tests that have it; print a remedy once."""
    by_remedy: dict[tuple[str, str, str], dict[tuple[str, str], list[str]]] = {}
    for row in rows:
        for finding in row.findings:
            affected = by_remedy.setdefault((finding.severity, finding.why, finding.remedy), {})
            affected.setdefault((row.channel, finding.what), []).append(row.test)
    for (severity, *below), affected in by_remedy.items():
        for (channel, what), tests in affected.items():
            yield f"{severity} {', '.join(tests)}, {channel}: {what}"
        yield from (f"    {line}" for line in below if line)
