"""The command `jbw report DIR`."""

import json
from pathlib import Path

import click

from jbw.cli.options import json_option, run_argument
from jbw.report.interactive import write_interactive
from jbw.report.page import campaign_name, write_page
from jbw.report.result import read_result
from jbw.study.store import save_report


@click.command()
@run_argument
@click.option(
    "--out",
    type=click.Path(dir_okay=False, writable=True, path_type=Path),
    help="Where to write the page alone; DIR/report.html when left out.",
)
@click.option(
    "--interactive",
    is_flag=True,
    help="Write interactive.html beside it, with figures to zoom into; needs plotly.",
)
@json_option
def report(folder: Path, out: Path | None, interactive: bool, json_: bool) -> None:
    """Write the one-file report of the finished run in DIR, and its figures beside it."""
    summary, tree = read_result(folder)
    page = out or folder / "report.html"
    if out is None:
        save_report(folder, tree, summary)
    else:
        write_page(summary, tree, out)
    written = {"report": str(page)}
    if interactive:
        beside = page.with_name("interactive.html")
        write_interactive(tree, beside, campaign_name(summary))
        written["interactive"] = str(beside)
    click.echo(json.dumps(written) if json_ else "\n".join(written.values()))
