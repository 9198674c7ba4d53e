"""The commands that write files of a finished run: `jbw report DIR` and `jbw export DIR`."""

from pathlib import Path
from typing import Any

import click

from jbw.cli.drawing import DrawingProcess
from jbw.cli.options import figures_option, json_option, out_option, run_argument
from jbw.cli.printing import answer
from jbw.errors import ConfigError
from jbw.report.messages import stages


@click.command()
@run_argument
@click.option(
    "--out",
    type=click.Path(dir_okay=False, writable=True, path_type=Path),
    help="File for the page; by default DIR/report.html.",
)
@click.option(
    "--interactive",
    is_flag=True,
    help="Also write interactive.html, with figures to zoom into; needs plotly.",
)
@click.option(
    "--brief",
    is_flag=True,
    help="Write only brief.pdf: one page with the verdict, frequency, damping ratio and Q.",
)
@figures_option
@json_option
def report(
    folder: Path, out: Path | None, interactive: bool, brief: bool, figures: tuple[str, ...],
    json_: bool,
) -> None:  # fmt: skip
    """Write the report of the finished run in DIR, in one file.

    With --figures pdf, its figures are also written to DIR/figures, for use in a paper.
    """
    if figures and (brief or out is not None):
        raise click.UsageError(
            f"Option {'--brief' if brief else '--out'} writes only one file: leave it out with "
            "--figures."
        )
    if brief:
        _write_brief(folder, out, json_, interactive=interactive)
        return
    from jbw.cli.progress import telling

    with DrawingProcess(wanted=out is None) as beside, telling(f"Reading {folder}") as say:
        from jbw.report.load_section import load_section
        from jbw.report.page import write_interactive, write_page
        from jbw.report.result import read_result
        from jbw.study.store import save_report

        summary, tree = read_result(folder)
        page = out or folder / "report.html"
        say(f"Writing {page}" if out else stages.drawing_figures(str(page)))
        if out is None:
            save_report(folder, tree, summary, beside, figures)
        else:
            write_page(summary, tree, out, loads=load_section(folder))
        written = {"report": str(page)}
        if figures:
            written["figures"] = str(folder / "figures")
        if interactive:
            page_with_zoom = page.with_name("interactive.html")
            say(f"Writing {page_with_zoom}")
            write_interactive(tree, page_with_zoom, summary.campaign)
            written["interactive"] = str(page_with_zoom)
    answer(json_, written, saved="\n".join(written.values()))


def _write_brief(folder: Path, out: Path | None, json_: bool, *, interactive: bool) -> None:
    """Write the one-page PDF of the finished run in a folder."""
    if interactive:
        raise click.UsageError(
            "Options --brief and --interactive write different pages: give only one of them."
        )
    if out is not None and out.suffix.lower() != ".pdf":
        raise ConfigError(
            f"Option --out must end in .pdf with --brief, but is {out}.",
            remedy="Use a file name that ends in .pdf, for example --out brief.pdf.",
        )
    page = save_brief(folder, out)
    answer(json_, {"brief": str(page)}, saved=str(page))


def save_brief(folder: Path, out: Path | None = None) -> Path:
    """Write a finished run's one-page PDF, by default next to its report; return its path."""
    from jbw.report.brief import write_brief
    from jbw.report.result import read_result
    from jbw.run.files import write_whole

    page = out or folder / "brief.pdf"
    write_whole(page, write_brief(*read_result(folder)))
    return page


@click.command()
@run_argument
@out_option("DIR/export")
@click.option(
    "--mass", type=float, help="Modal mass [kg]; by default 1, which gives forces per kg."
)
@click.option(
    "--y-max", type=float, help="Largest displacement [m]; by default the largest measured one."
)
@click.option(
    "--draw",
    type=int,
    help="Number of a draw, counted from 0; by default the most probable draw.",
)
@click.option(
    "--to", "names", default="",
    callback=lambda _, __, value: [name.strip() for name in value.split(",") if name.strip()],
    help="Programs separated by commas: opensees, matlab, fmi2, fmi3, abaqus, nastran, ansys, "
         "modelica, code_aster; by default the first two.",
)  # fmt: skip
@click.option("--fmu", is_flag=True, help="Also write FMUs for FMI 2.0 and 3.0.")
@click.option("--draws", "count", type=int, help="Write parameter cards of this number of draws.")
@json_option
def export(
    folder: Path, out: Path | None, names: list[str], fmu: bool, count: int | None, json_: bool,
    **options: Any,
) -> None:  # fmt: skip
    """Write the joint of the finished run in DIR for other programs.

    The joint is the posterior draw of highest density, or the one that --draw states. It is not the
    mean of the draws, which along a ridge of the posterior is no possible joint. parameters.csv
    contains its parameters in three conventions with 99 % intervals, backbone.csv frequency and
    damping against amplitude with 99 % bands, loop.csv static loops, and jbw.mat all of these and
    the draws. --to and --fmu write the joint in the form of other programs: the law as code if the
    program supports that, otherwise as tables. --draws writes many draws, for simulations over the
    posterior: one folder per draw, and manifest.json. All files begin with the verdict on the run.

    Several joints of a structure with matrices are written at their degrees of freedom, in the
    units of the matrices: opensees, abaqus and nastran have all joints in one file, fmi2 and fmi3
    one folder per joint.
    """
    from jbw.cli.progress import computing

    with computing() as say:
        from jbw.export.exports import programs_named
        from jbw.export.files import export_of_run
        from jbw.report.result import read_result
        from jbw.study.store import claim

        programs_named(names)  # This call reports a misspelt name before anything is computed.
        say(f"Reading {folder}")
        summary, tree = read_result(folder)
        say(stages.COMPUTING_JOINT)
        exported = export_of_run(tree, summary, names, fmu=fmu, count=count, **options)
        place = out or folder / "export"
        titles = ", ".join(program.title for program in exported.programs)
        say(f"Writing {titles or 'tables'} to {place}")
        written = exported.write(claim(place))
    paths = [str(path) for path in written]
    record = {"about": list(exported.about), "files": paths, "notes": list(exported.notes)}
    answer(json_, record, *exported.notes, saved="\n".join(paths))
