"""The command that reads records without a joint model: `jbw look CAMPAIGN`."""

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from jbw.cli.check import finding_lines
from jbw.cli.options import figure_option, given_argument, json_option, one_campaign, outside_option
from jbw.cli.printing import answer, following
from jbw.cli.progress import STARTING, telling
from jbw.errors import ConfigError
from jbw.report.cycles import cycles_table, loops_table
from jbw.report.messages.commands import without_model
from jbw.report.table import Column, Table, table, words
from jbw.report.text import NOTHING, length_unit, number

Row = Mapping[str, Any]


@click.command()
@given_argument
@figure_option("responses, frequency and damping", "look.png")
@click.option(
    "--html",
    type=click.Path(dir_okay=False, writable=True, path_type=Path),
    help="Write a page with the spectra, in which you choose `band` and modes by dragging.",
)
@json_option
@outside_option
def look(
    given: tuple[Path, ...], figure: Path | None, html: Path | None, json_: bool,
    allow_outside: bool,
) -> None:  # fmt: skip
    """Show what the records of a CAMPAIGN contain, without a model of the joint.

    CAMPAIGN is a campaign file or its folder. From RECORDs, or from a folder of records, a campaign
    file is drafted first, as by `jbw init`.

    For each test, in the order of its amplitude, the table gives frequency, damping, variation
    between repeats, third harmonic and the residual of a linear oscillator. Then follows whether
    frequency and damping change with amplitude, by how much and by which power, with harmonics,
    distortion and coherence. Faults of the records, as `jbw check` reports them, are printed first,
    since they change the numbers. `jbw identify` fits a joint.
    """
    if html is not None and html.suffix.lower() not in (".html", ".htm"):
        raise ConfigError(
            f"Option --html must end in .html, but is {html}.",
            remedy="Use such a name, for example look.html.",
        )
    campaign = one_campaign(given)
    with telling(STARTING) as say:  # this command does not need JAX
        from jbw.campaign.check import check_campaign
        from jbw.campaign.load import load_with_doubts
        from jbw.run.session import limit_threads
        from jbw.study.look import look as look_at
        from jbw.study.look import look_groups

        limit_threads()
        say(f"Reading {campaign}")
        checked = check_campaign(campaign, allow_outside=allow_outside)
        loaded, doubts = load_with_doubts(campaign, allow_outside=allow_outside)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # unsuccessful readings are listed as unread
            readings = look_at(loaded, report=say)
        if figure is not None:
            import xarray

            from jbw.report.looking import look_figure  # loads matplotlib
            from jbw.study.store import write_figure

            tree = xarray.DataTree.from_dict(look_groups(readings))
            write_figure(figure, look_figure(tree))
        if html is not None:
            from jbw.report.picker import render_picker
            from jbw.run.files import write_whole

            write_whole(html, render_picker(loaded.name, loaded.tests).encode())
        say("Done")
    loops = readings.record["loops"]
    tables = tests_table(readings.record), loops_table(loops), cycles_table(loops)
    outputs = (("Figure", figure), ("Choose the band", html))
    saved = "\n".join(f"{what}: {path}" for what, path in outputs if path is not None)
    record = readings.record | {"doubts": [str(doubt.message) for doubt in doubts]}
    # Faults of the records change the numbers below, so they are printed first.
    doubted = finding_lines(checked.rows)
    answer(json_, record, *doubted, *tables, *record["statements"], *record["seen"], saved=saved)
    # If no record could be read, a fit would say no more than a check.
    following("identify" if record["tests"] or loops else "check", campaign)


def tests_table(record: Row) -> Table:
    """Return the table of readings with one row per test, in order of the motion's amplitude."""
    factor, unit = length_unit(max((row["y"] for row in record["tests"]), default=1.0))
    return table(
        without_model(record["campaign"]),
        record["tests"],
        words("test", "test"),
        Column("level", lambda row: NOTHING if row["level"] is None else f"{row['level']:g}"),
        words("records", "records", "right"),
        Column(f"motion [{unit}]", lambda row: number(factor * row["y"])),
        Column("frequency [Hz]", lambda row: _with_scatter(row, "frequency", "frequency_hz", 1.0)),
        Column("damping [%]", lambda row: _with_scatter(row, "damping", "damping", 100.0)),
        _part("scatter of\nrepeats", "noise"),
        _part("third\nharmonic", "third"),
        _part("coherence", "coherence"),
        _part("residual of a\nlinear fit", "left"),
    )


def _with_scatter(row: Row, name: str, key: str, scale: float) -> str:
    """Return a mean as text, with the standard deviation over records if there are several."""
    sd = row[f"{name}_sd"]
    if not sd:
        return number(scale * row[key], digits=5 if name == "frequency" else 3)
    return f"{number(scale * row[key], scale * sd)} ± {number(scale * sd, digits=2)}"


def _part(heading: str, key: str) -> Column:
    def shown(row: Row) -> str:
        return NOTHING if row[key] is None else f"{number(100 * row[key], digits=2)} %"

    return Column(heading, shown)
