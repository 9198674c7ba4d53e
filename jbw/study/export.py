"""A run's posterior in files that other programs read: CSV, MATLAB and a line of OpenSees."""

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jbw.errors import ConfigError, DataError
from jbw.oscillator.law import Conversion
from jbw.oscillator.laws import quantities_of
from jbw.oscillator.oscillator import oscillator_of
from jbw.quantities import OSCILLATOR
from jbw.verification.backbone import curves
from jbw.verification.bands import QUANTILES, band
from jbw.verification.predicted import carry
from jbw.verification.predictive_basis import Draws, Laws, laws_of_run, parameter_names, thin

NUM_DRAWS = 1000  # carried along the backbone
NUM_AMPLITUDES = 100
MARKS = tuple(f"q{1000 * q:03.0f}" for q in QUANTILES)


@dataclass(frozen=True)
class Export:
    """What `write_export` writes; other conventions than jbw's only where they know the law."""

    parameters: list[dict[str, Any]]  # rows convention, parameter, unit, mean, sd and quantiles
    backbone: dict[str, NDArray[np.float64]]  # amplitude; frequency, damping, force with bands
    draws: Draws
    material: str | None  # of OpenSees, by the posterior means, where the joint has one


def export(tree: xr.DataTree, mass: float = 1.0, y_max: float | None = None) -> Export:
    """The joint in several conventions, of modal mass [kg], and its backbone up to `y_max` [m]."""
    laws = laws_of_run(tree)
    draws = thin(tree["posterior"].to_dataset(), NUM_DRAWS, laws=laws)
    needed = [name for name in parameter_names(laws) if name != "gain"]
    missing = [name for name in needed if name not in draws]
    if missing:
        raise DataError(
            f"The main posterior must hold all of {', '.join(needed)}, but lacks "
            f"{', '.join(missing)}.",
            why="Without them there is no oscillator to hand on.",
            remedy="Identify from tests that move the mass, such as noise, sweeps or tones.",
        )
    y_max = float(tree.attrs.get("y_peak", 0.0)) if y_max is None else y_max
    for name, value in {"y_max": y_max, "mass": mass}.items():
        if not value > 0.0:
            raise ConfigError(
                f"Argument `{name}` must be positive, but it is {value:g}.",
                remedy=f"Give it: --{name.replace('_', '-')}.",
            )
    mean = _converted({name: float(np.mean(values)) for name, values in draws.items()}, laws, mass)
    material = next((one.material for one in mean.values() if one.material), None)
    parameters = list(_parameters(draws, laws, mass))
    return Export(parameters, _backbone(draws, laws, mass, y_max), draws, material)


def _converted(theta: Mapping[str, float], laws: Laws, mass: float) -> Mapping[str, Conversion]:
    """The oscillator in other conventions, which know one law alone."""
    joint = oscillator_of(theta, laws)
    if len(joint.laws) != 1:
        return {}
    return joint.laws[0].convert(theta["omega_n"], theta["zeta"], mass)


def _parameters(draws: Draws, laws: Laws, mass: float) -> Iterable[dict[str, Any]]:
    units = {quantity.name: quantity.unit for quantity in (*OSCILLATOR, *quantities_of(laws))}
    names = [name for name in units if name in draws and name != "gain"]
    for name in names:
        yield _row("jbw", name, units[name], draws[name])
    rows = zip(*(draws[name] for name in names), strict=True)
    every = [_converted(dict(zip(names, map(float, row), strict=True)), laws, mass) for row in rows]
    for convention, first in every[0].items():
        for name, unit in first.units.items():
            values = np.array([one[convention].values[name] for one in every])
            yield _row(convention, name, unit, values)


def _row(convention: str, name: str, unit: str, values: NDArray[np.float64]) -> dict[str, Any]:
    facts = {"mean": float(np.mean(values)), "sd": float(np.std(values))}
    facts |= dict(zip(MARKS, map(float, band(values)), strict=True))
    return {"convention": convention, "parameter": name, "unit": unit, **facts}


def _backbone(
    draws: Draws, laws: Laws, mass: float, y_max: float
) -> dict[str, NDArray[np.float64]]:
    y_peak = y_max * np.arange(1, NUM_AMPLITUDES + 1) / NUM_AMPLITUDES
    frequency, damping, force = carry(curves, draws, y_peak, laws)
    table = {"amplitude_m": y_peak}
    columns = {"frequency_hz": frequency, "damping_ratio": damping, "force_n": mass * force}
    for name, values in columns.items():
        table |= {f"{name}_{m}": q for m, q in zip(MARKS, band(values), strict=True)}
    return table


def write_export(folder: Path, result: Export) -> tuple[Path, ...]:
    """Write parameters.csv, backbone.csv, jbw.mat and joint.tcl; return the files."""
    from scipy.io import savemat

    parameters, backbone = folder / "parameters.csv", folder / "backbone.csv"
    matlab, material = folder / "jbw.mat", folder / "joint.tcl"
    _write_rows(parameters, list(result.parameters[0]), [r.values() for r in result.parameters])
    _write_rows(backbone, list(result.backbone), zip(*result.backbone.values(), strict=True))
    savemat(matlab, {"draws": result.draws, "backbone": result.backbone}, oned_as="column")
    if result.material is None:
        return parameters, backbone, matlab
    words = "# The joint of the posterior means, in N, m and kg; mass and dashpot are the model's."
    material.write_text(f"{words}\n{result.material}\n", encoding="utf-8")
    return parameters, backbone, matlab, material


def _write_rows(path: Path, header: Sequence[str], rows: Iterable[Iterable[Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(rows)
