"""The command that collects finished runs: `jbw collect RUNS --out fleet.nc`."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from jbw.cli.options import json_option
from jbw.cli.printing import answer
from jbw.cli.progress import computing
from jbw.errors import DataError
from jbw.report.messages import study as messages
from jbw.report.table import Column, Table, table, words
from jbw.report.text import NOTHING


@click.command()
@click.argument(
    "runs", nargs=-1, required=True, type=click.Path(exists=True, file_okay=False, path_type=Path)
)
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    default=Path("fleet.nc"),
    show_default=True,
    help="File to write.",
)
@click.option(
    "--covariates",
    "table_file",
    metavar="CSV",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Table with the columns run, torque [N m], sequence, temperature [degC] and "
    "assembly, instead of the values in the campaigns.",
)
@click.option(
    "--mixed-versions",
    is_flag=True,
    help="Accept runs of different versions of jbw and other packages.",
)
@json_option
def collect(
    runs: Sequence[Path], out: Path, table_file: Path | None, mixed_versions: bool, json_: bool
) -> None:
    """Collect the draws of the finished RUNS and their covariates in one file.

    RUNS are folders of runs, or folders that contain several, as `jbw identify A.toml B.toml --out
    DIR` writes them. Each run is one unit of the fleet. All must have the same laws, units and
    versions; either all or none must state a torque, in [assembly] of the campaigns or by
    --covariates.
    """
    with computing() as say:
        from jbw.population.covariates import read_covariates
        from jbw.population.fleet import fleet_of, write_fleet
        from jbw.results.attributes import StoredFleet

        folders = [folder for path in runs for folder in _runs_of(path, say)]
        covariates = {} if table_file is None else read_covariates(table_file)
        say(f"Reading {len(folders)} run{'' if len(folders) == 1 else 's'}")
        fleet = fleet_of(folders, covariates=covariates, mixed_versions=mixed_versions)
        write_fleet(out, fleet)
    rows = list(_rows(fleet))
    stored = StoredFleet.of(fleet)
    record = {
        "fleet": str(out),
        "laws": list(stored.laws),
        "parameters": fleet.coords["parameter"].values.tolist(),
        "left_out": stored.left_out,
        "units": rows,
    }
    lacking = [messages.no_logarithm(name, units) for name, units in stored.left_out.items()]
    answer(json_, record, fleet_table(rows), *lacking, saved=f"Fleet: {out}")


def _runs_of(folder: Path, say: Any) -> list[Path]:
    """Return the run's folder, or all finished runs in a folder; warn about unfinished runs."""
    if (folder / "summary.json").is_file():
        return [folder]
    inner = sorted(
        path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")
    )
    finished = [path for path in inner if (path / "summary.json").is_file()]
    for path in inner:
        if (path / ".run").is_dir() and path not in finished:
            say(f"warning: {messages.unfinished(str(path))}")
    if not finished:
        raise DataError(
            f"The folder {folder} contains no finished run.",
            remedy="Name folders of finished runs, or finish the runs: jbw resume DIR.",
        )
    return finished


def _rows(fleet: Any) -> Iterator[dict[str, Any]]:
    """Yield a table row per unit of a fleet: covariates, verdict, number of draws."""
    for name in fleet.coords["unit"].values.tolist():
        unit = fleet.dataset.sel(unit=name)
        numbers = {key: float(unit[key]) for key in ("torque", "sequence", "temperature", "ess")}
        yield {
            "unit": name,
            "assembly": str(unit["assembly"].values),
            "verdict": str(unit["verdict"].values),
            "num_draws": int(unit["num_draws"]),
            **{key: value if np.isfinite(value) else None for key, value in numbers.items()},
        }


def fleet_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return the table of a fleet with one line per unit."""
    return table(
        f"Fleet of {len(rows)} units",
        rows,
        words("unit", "unit"),
        words("assembly", "assembly"),
        _number("torque [N m]", "torque"),
        _number("sequence", "sequence"),
        _number("temperature [degC]", "temperature"),
        words("draws", "num_draws", "right"),
        _number("effective", "ess", ".0f"),
        words("verdict", "verdict"),
    )


def _number(heading: str, key: str, form: str = "g") -> Column:
    return Column(heading, lambda row: NOTHING if row[key] is None else format(row[key], form))
