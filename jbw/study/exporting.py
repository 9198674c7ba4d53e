"""A run's posterior in files that other programs read: CSV, MATLAB and a line of OpenSees."""

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jbw.errors import ConfigError, DataError
from jbw.observables.joint import JOINT, joint_of
from jbw.oscillator.backbone import backbone
from jbw.oscillator.conventions import opensees, to_baber_noori, to_benchmark
from jbw.oscillator.parameters import BoucWen
from jbw.prediction import QUANTILES, Draws, band, thin

NUM_DRAWS = 1000  # carried along the backbone
NUM_AMPLITUDES = 100
MARKS = tuple(f"q{1000 * q:03.0f}" for q in QUANTILES)
UNITS = {"omega_n": "rad/s", "zeta": "1", "alpha": "1/s^2", "delta": "1/m", "gamma": "1/m"}
BABER_NOORI_UNITS = dict(
    mass="kg", damping="N s/m", stiffness="N/m", ratio="1", beta="m^-n", gamma="m^-n", n="1"
)
BENCHMARK_UNITS = dict(
    mass="kg", damping="N s/m", stiffness="N/m", alpha="N/m", beta="1",
    gamma="N^(1-nu)/m", delta="N^(1-nu)/m", nu="1",
)  # fmt: skip


@dataclass(frozen=True)
class Export:
    """What `write_export` writes.

    Attributes:
        parameters: Rows convention, parameter, unit, mean, sd and quantiles; in jbw's convention
            alone where a cubic force stands beside the joint, which the others do not know.
        backbone: Columns by name: amplitude, and frequency, damping and force with their bands.
        draws: Draws of the joint's parameters by name.
        material: The joint of the posterior means as a material of OpenSees; None with a force
            beside the hysteretic one.
    """

    parameters: list[dict[str, Any]]
    backbone: dict[str, NDArray[np.float64]]
    draws: Draws
    material: str | None


def export(tree: xr.DataTree, mass: float = 1.0, y_max: float | None = None) -> Export:
    """The joint in several conventions, and its frequency and damping against amplitude.

    Args:
        tree: The result, as `posterior.nc` holds it.
        mass: Modal mass [kg]; with 1, forces are per kilogram.
        y_max: Largest displacement of the backbone [m]; the largest measured when None.

    Returns:
        What is to be written.

    Raises:
        DataError: The main posterior lacks a parameter of the joint, or no amplitude is known.
        ConfigError: The amplitude or mass is not positive.
    """
    draws = thin(tree["posterior"].to_dataset(), NUM_DRAWS)
    missing = [name for name in JOINT if name not in draws]
    if missing:
        raise DataError(
            f"The main posterior must hold all of {', '.join(JOINT)}, but lacks "
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
    mean = joint_of({name: jnp.mean(values) for name, values in draws.items()})
    material = None if mean.restoring is not None else opensees(mean, mass)
    return Export(list(_parameters(draws, mass)), _backbone(draws, mass, y_max), draws, material)


def _parameters(draws: Draws, mass: float) -> Iterable[dict[str, Any]]:
    for name in JOINT:
        yield _row("jbw", name, UNITS[name], draws[name])
    if "cubic" in draws:
        yield _row("jbw", "cubic", "1/(m^2 s^2)", draws["cubic"])
        return  # the other conventions have no place for it
    each = zip(*(draws[name] for name in JOINT), strict=True)
    joints = [BoucWen(*values) for values in each]
    for convention, units, convert in (
        ("Bouc-Wen-Baber-Noori, OpenSees", BABER_NOORI_UNITS, to_baber_noori),
        ("hysteretic benchmark", BENCHMARK_UNITS, to_benchmark),
    ):
        columns = np.array([convert(joint, mass) for joint in joints]).T
        for (name, unit), values in zip(units.items(), columns, strict=True):
            yield _row(convention, name, unit, values)


def _row(convention: str, name: str, unit: str, values: NDArray[np.float64]) -> dict[str, Any]:
    facts = {"mean": float(np.mean(values)), "sd": float(np.std(values))}
    facts |= dict(zip(MARKS, map(float, band(values)), strict=True))
    return {"convention": convention, "parameter": name, "unit": unit, **facts}


def _backbone(draws: Draws, mass: float, y_max: float) -> dict[str, NDArray[np.float64]]:
    y_peak = y_max * np.arange(1, NUM_AMPLITUDES + 1) / NUM_AMPLITUDES
    joint = joint_of({name: jnp.asarray(values)[:, None] for name, values in draws.items()})
    found = backbone(joint, jnp.asarray(y_peak))
    curves = {
        "frequency_hz": np.asarray(found.omega) / (2 * np.pi),
        "damping_ratio": np.asarray(found.zeta),
        "force_n": mass * np.asarray(found.amplitude),
    }
    columns = {"amplitude_m": y_peak}
    for name, values in curves.items():
        columns |= {f"{name}_{m}": q for m, q in zip(MARKS, band(values), strict=True)}
    return columns


def write_export(folder: Path, result: Export) -> tuple[Path, ...]:
    """Write parameters.csv, backbone.csv, jbw.mat and joint.tcl.

    Args:
        folder: New or empty folder, as `claim` left it.
        result: From `export`.

    Returns:
        The files.
    """
    from scipy.io import savemat

    parameters, curves = folder / "parameters.csv", folder / "backbone.csv"
    matlab, material = folder / "jbw.mat", folder / "joint.tcl"
    _write_rows(parameters, list(result.parameters[0]), [r.values() for r in result.parameters])
    _write_rows(curves, list(result.backbone), zip(*result.backbone.values(), strict=True))
    savemat(matlab, {"draws": result.draws, "backbone": result.backbone}, oned_as="column")
    if result.material is None:
        return parameters, curves, matlab
    words = "# The joint of the posterior means, in N, m and kg; mass and dashpot are the model's."
    material.write_text(f"{words}\n{result.material}\n", encoding="utf-8")
    return parameters, curves, matlab, material


def _write_rows(path: Path, header: Sequence[str], rows: Iterable[Iterable[Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(rows)
