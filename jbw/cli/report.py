"""The command `jbw report DIR`."""

from pathlib import Path

import click

from jbw.report.page import write_page
from jbw.report.result import read_result
from jbw.study.storage import save_report


@click.command()
@click.argument(
    "folder", metavar="DIR", type=click.Path(exists=True, file_okay=False, path_type=Path)
)
@click.option(
    "--out",
    type=click.Path(dir_okay=False, writable=True, path_type=Path),
    help="Where to write the page alone; DIR/report.html when left out.",
)
def report(folder: Path, out: Path | None) -> None:
    """Write the one-file report of the finished run in DIR, and its figures beside it."""
    summary, tree = read_result(folder)
    if out is None:
        save_report(folder, tree, summary)
    else:
        write_page(summary, tree, out)
    click.echo(out or folder / "report.html")
