"""The command `jbw export DIR`."""

import json
from pathlib import Path

import click

from jbw.cli.options import json_option, out_option, run_argument


@click.command()
@run_argument
@out_option("DIR/export")
@click.option("--mass", type=float, default=1.0, help="Modal mass [kg]; 1 leaves forces per kg.")
@click.option("--y-max", type=float, help="Largest displacement [m]; by default that measured.")
@json_option
def export(folder: Path, out: Path | None, mass: float, y_max: float | None, json_: bool) -> None:
    """Write the joint of the finished run in DIR for CSV, MATLAB and OpenSees.

    parameters.csv has every parameter in three conventions with 99 % intervals, backbone.csv the
    frequency and damping against amplitude with 99 % bands, jbw.mat both beside the draws, and
    joint.tcl a material of OpenSees.
    """
    from jbw.cli.running import prepare_jax
    from jbw.report.result import read_result
    from jbw.study.store import claim

    prepare_jax()
    from jbw.study import export as exporting

    _, tree = read_result(folder)
    result = exporting.export(tree, mass, y_max)
    paths = [str(p) for p in exporting.write_export(claim(out or folder / "export"), result)]
    click.echo(json.dumps({"files": paths}, indent=1) if json_ else "\n".join(paths))
