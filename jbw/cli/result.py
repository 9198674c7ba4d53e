"""What is written of a finished run: `jbw report DIR` and `jbw export DIR`."""

from pathlib import Path

import click

from jbw.cli.options import json_option, out_option, run_argument
from jbw.cli.printing import answer


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
    from jbw.report.page import campaign_name, write_interactive, write_page
    from jbw.report.result import read_result
    from jbw.study.store import save_report

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
    answer(json_, written, saved="\n".join(written.values()))


@click.command()
@run_argument
@out_option("DIR/export")
@click.option("--mass", type=float, default=1.0, help="Modal mass [kg]; 1 leaves forces per kg.")
@click.option("--y-max", type=float, help="Largest displacement [m]; by default that measured.")
@click.option("--draw", type=int, help="Number of a draw, from 0 on; by default the best.")
@json_option
def export(
    folder: Path, out: Path | None, mass: float, y_max: float | None, draw: int | None, json_: bool
) -> None:
    """Write the joint of the finished run in DIR for CSV, MATLAB and OpenSees.

    The joint is the draw of highest posterior density, or the one that --draw names; never the
    means, which along a ridge are no joint of the posterior. parameters.csv has it in three
    conventions with 99 % intervals, backbone.csv its frequency and damping against amplitude with
    99 % bands, loop.csv its static loops, jbw.mat all of them beside the draws, and joint.tcl
    materials of OpenSees, where it has them. All begin with the verdict of the run.
    """
    from jbw.cli.progress import prepare_jax
    from jbw.report.result import read_result
    from jbw.study.store import claim

    prepare_jax()
    from jbw.study import export as exporting
    from jbw.study.export_files import write_export

    summary, tree = read_result(folder)
    result = exporting.export(tree, mass, y_max, draw=draw, summary=summary)
    paths = [str(p) for p in write_export(claim(out or folder / "export"), result)]
    answer(json_, {"about": list(result.about), "files": paths}, saved="\n".join(paths))
