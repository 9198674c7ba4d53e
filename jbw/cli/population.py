"""The command on a fleet: `jbw population fleet.nc`."""

from pathlib import Path
from typing import Any

import click
import numpy as np

from jbw.cli.options import json_option
from jbw.cli.printing import NOT_TRUSTED, answer
from jbw.cli.progress import computing
from jbw.report.table import Column, Table, table, words
from jbw.report.text import NOTHING

NUM_PLACES = 25  # of the figure's band


@click.command()
@click.argument("fleet", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--torque", type=float, help="Predict a new unit at this torque [N m].")
@click.option("--parameters", help="What is pooled, with commas between; products when left out.")
@click.option("--all-verdicts", is_flag=True, help="Pool though most runs failed.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the sampler.")
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), help="Folder; FLEET-population."
)
@json_option
def population(
    fleet: Path, torque: float | None, parameters: str | None, all_verdicts: bool, seed: int,
    out: Path | None, json_: bool,
) -> int:  # fmt: skip
    """Say how the units of FLEET scatter, and how they go with torque.

    FLEET is what `jbw collect` wrote. Of every coordinate: its mean at the middle torque, its
    scatter between units, its power of torque, and where a unit lies that nobody measured. Writes
    population.json, population.nc with frequency and damping of a new unit, and population.png.
    """
    with computing() as say:
        from jbw.inference.posterior.summary import QUANTILES
        from jbw.population.fleet import read_fleet
        from jbw.population.population import population_of, require_torque
        from jbw.population.prediction import new_backbone, new_coordinates
        from jbw.report.population import population_figure
        from jbw.study.store import claim, write_figure, write_json, writing

        units = read_fleet(fleet)
        chosen = None if parameters is None else [one.strip() for one in parameters.split(",")]
        found = population_of(
            units, parameters=chosen, all_verdicts=all_verdicts, seed=seed, report=say
        )
        require_torque(found, torque)

        def new(at: float | None) -> np.ndarray:
            rng = np.random.default_rng(seed)
            return np.quantile(new_coordinates(found, at, rng, 4000), QUANTILES, axis=0)

        say("Frequency and damping of a new unit")
        backbone = new_backbone(found, units, torque, seed=seed)
        trend = "torque" in found.design.columns
        known = np.array(found.record["torque"])
        places = np.geomspace(known.min(), known.max(), NUM_PLACES) if trend else np.zeros(0)
        if trend and torque is not None:
            places = np.sort(np.append(places, torque))
        ends = np.array([0.5, len(known) + 0.5])
        bands = [new(one) for one in places] if trend else [new(None)] * 2
        sd = np.sqrt(np.diagonal(found.pooled.cov, axis1=1, axis2=2))
        figure = population_figure(
            found.record, found.pooled.mean, sd, places if trend else ends, np.stack(bands, axis=1)
        )
        ahead = np.exp(new(torque)).T
        record: dict[str, Any] = {
            **found.record,
            "new_unit": {
                "torque": torque,
                **{
                    name: dict(zip(("q005", "median", "q995"), map(float, row), strict=True))
                    for name, row in zip(found.pooled.names, ahead, strict=True)
                },
            },
        }
        folder = claim(out or fleet.with_name(f"{fleet.stem}-population"))
        with writing(folder, "population.nc", "population.png", "population.json") as part:
            backbone.to_netcdf(part / "population.nc", engine="h5netcdf")
            write_figure(part / "population.png", figure)
            write_json(part / "population.json", record)
    status = f"Status: {record['status']}"
    saved = f"Population: {folder / 'population.json'}"
    answer(json_, record, population_table(record), status, *record["statements"], saved=saved)
    return 0 if record["status"] == "ok" else NOT_TRUSTED


def population_table(record: dict[str, Any]) -> Table:
    """A line a coordinate."""
    torque = record["new_unit"]["torque"]
    at = torque if torque is not None else record["reference_torque"]
    where = "" if at is None else f" at {at:.3g} N m"
    rows = [
        {"name": name, **row, "new": record["new_unit"][name]}
        for name, row in record["parameters"].items()
    ]
    middle = "" if at is None else f" at {record['reference_torque']:.3g} N m"
    columns = [
        words("", "name"),
        words("unit", "unit"),
        Column(f"mean{middle}", lambda row: _interval(row["mean"])),
        Column("scatter [%]", lambda row: _interval(row["scatter"], 100.0)),
    ]
    for column in record["columns"][1:]:
        key = f"slope_{column}"
        columns.append(Column(f"power of {column}", lambda row, key=key: _interval(row.get(key))))
    columns.append(Column(f"new unit{where}", lambda row: _interval(row["new"])))
    return table(f"Population of {len(record['units'])} units, median [99 %]", rows, *columns)


def _interval(row: dict[str, float] | None, factor: float = 1.0) -> str:
    if row is None:
        return NOTHING
    low, middle, high = (factor * row[key] for key in ("q005", "median", "q995"))
    width = max(abs(high - low), 1e-300)
    digits = int(np.clip(np.ceil(np.log10(max(abs(low), abs(high)) / width)) + 2, 2, 12))
    return f"{middle:.{digits}g} [{low:.{digits}g}, {high:.{digits}g}]"
