"""The command that pools a fleet of runs: `jbw population fleet.nc`."""

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from jbw.cli.options import json_option
from jbw.cli.printing import NOT_TRUSTED, answer
from jbw.cli.progress import computing, working
from jbw.report.messages import population as messages

if TYPE_CHECKING:
    import xarray as xr

    from jbw.population.population import Population
    from jbw.report.style import Panels
    from jbw.report.table import Table
    from jbw.results.population import StoredPopulation

NUM_PLACES = 25  # number of torques at which the band of the figure is computed


@click.command()
@click.argument("fleet", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--torque", type=float, help="Predict a new unit at this torque [N m].")
@click.option("--parameters", help="Quantities to pool, separated by commas; by default products.")
@click.option("--saturating", help="Parameters that saturate with torque, such as omega_n.")
@click.option("--all-verdicts", is_flag=True, help="Pool the units even if most runs failed.")
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of the sampler.")
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder; by default FLEET-population.",
)
@json_option
def population(
    fleet: Path, torque: float | None, parameters: str | None, saturating: str | None,
    all_verdicts: bool, seed: int, out: Path | None, json_: bool,
) -> int:  # fmt: skip
    """Estimate how the units of FLEET vary, and how they depend on torque.

    FLEET is the file that `jbw collect` wrote. The result gives for every pooled quantity its mean
    at the middle torque, its variation between units, its exponent of torque, and the interval for
    a unit that was not measured. The command writes population.json; population.nc with draws of a
    new unit, its frequency and damping; population.png; and population.html with all units side by
    side. `jbw predict` on the folder predicts tests of a new unit.
    """
    with computing() as say:
        from jbw.inference.posterior.summary import QUANTILES
        from jbw.population.basis import new_unit, torque_of
        from jbw.population.fleet import read_fleet
        from jbw.population.population import covariates_in, population_of, require_torque
        from jbw.population.prediction import new_backbone, new_coordinates
        from jbw.report.population import population_table
        from jbw.run.files import hash_of

        units = read_fleet(fleet)
        with working(say, out or fleet.with_name(f"{fleet.stem}-population")) as job:
            folder, parts = job.folder, job.parts({str(fleet): hash_of(fleet)}, say)
            chosen, bent = (
                None if names is None else [name.strip() for name in names.split(",")]
                for names in (parameters, saturating)
            )
            require_torque(covariates_in(units), torque)
            pooling = population_of(
                units, parameters=chosen, saturating=bent or (), all_verdicts=all_verdicts,
                seed=seed, report=say, parts=parts,
            )  # fmt: skip

            def new(at: float | None) -> np.ndarray:
                rng = np.random.default_rng(seed)
                return np.quantile(new_coordinates(pooling, at, rng, 4000), QUANTILES, axis=0)

            say(messages.NEW_UNIT)
            tree = new_unit(pooling, units, torque, seed=seed)
            backbone = new_backbone(pooling, units, torque, seed=seed)
            tree.dataset = backbone.assign_attrs(tree.attrs)
            ahead = {
                name: dict(zip(("q005", "median", "q995"), map(float, row), strict=True))
                for name, row in zip(pooling.pooled.names, np.exp(new(torque)).T, strict=True)
            }
            about_new = {"torque": torque_of(pooling, torque), **ahead}
            found = pooling.result.replaced(new_unit=about_new)
            shown = population_table(found)
            bands = partial(_bands, pooling, torque, new)
            _write(folder, fleet.stem, pooling, found, tree, shown, bands)
    status = f"Status: {found.status}"
    saved = f"Population: {folder / 'population.html'}"
    answer(json_, found.plain(), shown, status, *found.statements, saved=saved)
    return 0 if found.status == "ok" else NOT_TRUSTED


def _write(
    folder: Path, name: str, pooling: "Population", found: "StoredPopulation",
    tree: "xr.DataTree", shown: "Table", bands: Callable[[], tuple[np.ndarray, np.ndarray]],
) -> None:  # fmt: skip
    """Write the numbers of a population, then its page and the figure of all its units."""
    from jbw.report.population import population_figure, population_sheet
    from jbw.report.sheet import render_sheet
    from jbw.run.netcdf import write_tree
    from jbw.study.store import save_outputs, write_figure, write_json

    @cache
    def drawn() -> tuple[str, "Panels"]:
        mean, cov = pooling.pooled.mean, pooling.pooled.cov
        sd = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
        figure = population_figure(pooling.record, mean, sd, *bands())
        return render_sheet(population_sheet(name, found, mean, sd, shown), figure), figure

    save_outputs(
        folder,
        {
            "population.nc": lambda path: write_tree(path, tree),
            "population.json": lambda path: write_json(path, found.plain()),
        },
        {
            "population.png": lambda path: write_figure(path, drawn()[1]),
            "population.html": lambda path: path.write_text(drawn()[0], encoding="utf-8"),
        },
    )


def _bands(
    pooling: "Population", torque: float | None, new: Callable[[float | None], np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return torques, or positions of units if there is no trend, and predictions for new units."""
    torques = np.array(pooling.result.torque, float)
    if "torque" not in pooling.design.columns:
        return np.array([0.5, len(torques) + 0.5]), np.stack([new(None)] * 2, axis=1)
    grid = np.geomspace(torques.min(), torques.max(), NUM_PLACES)
    if torque is not None:
        grid = np.sort(np.append(grid, torque))
    return grid, np.stack([new(place) for place in grid], axis=1)
