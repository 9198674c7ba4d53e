"""The command that measures frequency and damping without a joint model: `jbw look CAMPAIGN`."""

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

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

if TYPE_CHECKING:
    from jbw.results.run import StoredLook  # loads pydantic


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
            remedy="Use a file name that ends in .html, for example look.html.",
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
            # Records that cannot be evaluated are listed separately.
            warnings.simplefilter("ignore")
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
    found = readings.record
    tables = tests_table(found), loops_table(found.loops), cycles_table(found.loops)
    outputs = (("Figure", figure), ("Choose the band", html))
    saved = "\n".join(f"{what}: {path}" for what, path in outputs if path is not None)
    record = {**found.plain(), "doubts": [str(doubt.message) for doubt in doubts]}
    # Faults of the records are printed first, because they change the numbers below.
    doubted = finding_lines(checked.rows)
    answer(json_, record, *doubted, *tables, *found.statements, *found.seen, saved=saved)
    # If no record could be evaluated, a fit would show no more than a check of the channels.
    following("identify" if found.tests or found.loops else "check", campaign)


def tests_table(found: "StoredLook") -> Table:
    """Return the table of frequency and damping, one row per test, ordered by amplitude."""
    factor, unit = length_unit(max((row.y for row in found.tests), default=1.0))
    return table(
        without_model(found.campaign),
        found.tests,
        words("test", "test"),
        Column("level", lambda row: NOTHING if row.level is None else f"{row.level:g}"),
        words("records", "records", "right"),
        Column(f"motion [{unit}]", lambda row: number(factor * row.y)),
        Column("frequency [Hz]", lambda row: _with_scatter(row.frequency_hz, row.frequency_sd, 5)),
        Column(
            "damping [%]",
            lambda row: _with_scatter(100 * row.damping, row.damping_sd and 100 * row.damping_sd),
        ),
        Column("scatter of\nrepeats", lambda row: _part(row.noise)),
        Column("third\nharmonic", lambda row: _part(row.third)),
        Column("coherence", lambda row: _part(row.coherence)),
        Column("residual of a\nlinear fit", lambda row: _part(row.left)),
    )


def _with_scatter(mean: float, sd: float | None, digits: int = 3) -> str:
    """Return a mean as text, with the standard deviation between records if there are several."""
    return f"{number(mean, sd)} ± {number(sd, digits=2)}" if sd else number(mean, digits=digits)


def _part(ratio: float | None) -> str:
    return NOTHING if ratio is None else f"{number(100 * ratio, digits=2)} %"
