"""The command that compares two or more finished runs: `jbw diff A B`."""

from pathlib import Path

import click

from jbw.cli.options import figure_option, json_option
from jbw.cli.printing import answer
from jbw.cli.progress import computing
from jbw.errors import ConfigError

finished_run = click.Path(exists=True, file_okay=False, path_type=Path)


@click.command()
@click.argument("first", metavar="A", type=finished_run)
@click.argument("second", metavar="B", type=finished_run)
@click.argument("further", metavar="[C]...", nargs=-1, type=finished_run)
@figure_option("frequency and damping", "diff.png")
@json_option
def diff(
    first: Path, second: Path, further: tuple[Path, ...], figure: Path | None, json_: bool
) -> None:
    """Compare two or more finished runs, such as A and B at different assemblies, torques or days.

    The comparison includes every parameter and product that both runs have, and frequency and
    damping at amplitudes that both runs fitted: both 99 % intervals, the difference, and the
    probability that A's value is larger.

    For three or more runs, with any laws, it consists of frequency and damping at amplitudes that
    all runs fitted, in the order of the torques in their campaigns, and of the trend with torque.
    """
    if further:
        _side_by_side((first, second, *further), figure, json_=json_)
        return
    with computing() as say:
        from jbw.report.changes import backbone_table, backbones_figure, parameters_table
        from jbw.study.differences import differences
        from jbw.study.store import write_figure

        say(f"Reading {first} (A) and {second} (B)")
        record, backbones = differences(first, second)
        if figure is not None:
            if backbones is None:
                raise ConfigError(
                    "Option --figure needs frequency and damping of both runs, but a run lacks the "
                    "parameters or the largest displacement for them.",
                    remedy="Leave --figure out.",
                )
            write_figure(figure, backbones_figure(backbones))
        say("Done")
    tables = parameters_table(record), backbone_table(record)
    saved = "" if figure is None else f"Figure: {figure}"
    answer(json_, record.plain(), *tables, *record.statements, saved=saved)


def _side_by_side(folders: tuple[Path, ...], figure: Path | None, *, json_: bool) -> None:
    with computing() as say:
        from jbw.report.changes import side_by_side_figure, side_by_side_table
        from jbw.study.several_runs import side_by_side
        from jbw.study.store import write_figure

        say(f"Reading {len(folders)} runs")
        record, backbones = side_by_side(folders)
        if figure is not None:
            write_figure(figure, side_by_side_figure(record, backbones))
        say("Done")
    saved = "" if figure is None else f"Figure: {figure}"
    answer(json_, record.plain(), side_by_side_table(record), *record.statements, saved=saved)
