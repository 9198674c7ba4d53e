"""The export of a run's single joint: one posterior draw, with the bands of all draws."""

import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jbw.errors import ConfigError, DataError, printable
from jbw.export.chosen_draw import (
    Bands,
    backbone_within,
    best_draw,
    density_of,
    picked,
    products_of,
    stated_draw,
)
from jbw.export.joint_parts import Table, linear_parts, materials_of, skeletons, static_loops
from jbw.oscillator.law import Conversion
from jbw.oscillator.laws import quantities_of
from jbw.oscillator.modes.parameters import has_further_modes
from jbw.oscillator.oscillator import oscillator_of
from jbw.oscillator.parameters import Material
from jbw.quantities import OSCILLATOR, Quantity, are_at_joints, joints_of
from jbw.report.messages import study as messages
from jbw.results.run import RunSummary
from jbw.verification.backbone import curves
from jbw.verification.bands import QUANTILES, band
from jbw.verification.predictive_basis import (
    Basis,
    Draws,
    Laws,
    basis_of,
    count_of,
    parameter_names,
)

NUM_DRAWS = 1000  # number of draws from which the bands of the backbone are computed
NUM_AMPLITUDES = 100
MARKS = tuple(f"q{1000 * q:03.0f}" for q in QUANTILES)
NAMES = ("frequency", "damping", "force")  # quantities in the table of the backbone
COLUMNS = ("frequency_hz", "damping_ratio", "force_n")
# Parameters of the whole joint, in addition to those of its laws.
LINEAR = (
    Quantity("mass", "m", "kg", "modal mass", 0.0),
    Quantity("spring", "k", "N/m", "stiffness of the spring parallel to the laws"),
    Quantity("dashpot", "c", "N s/m", "coefficient of the dashpot parallel to the laws"),
)


@dataclass(frozen=True)
class Export:
    """The values of an exported joint, which `write_export` writes.

    Parameters are also stated in those other conventions that have the joint's law.
    """

    about: tuple[str, ...]  # lines on the run's verdict and on the number of the exported draw
    joint: dict[str, float]  # parameters of the exported draw
    # rows with convention, parameter, unit, value, sd and quantiles
    parameters: list[dict[str, Any]]
    # columns: amplitude; frequency, damping and force of this draw, each with the band of all draws
    backbone: Table
    loop: Table  # columns: largest displacement, displacement and static force of this draw
    draws: Draws
    materials: tuple[Material, ...]  # OpenSees materials, in parallel; empty if a law has none
    laws: Laws
    # `LINEAR` parameters: mass, and the spring and dashpot parallel to the laws
    linear: dict[str, float]
    # columns: displacement; force of spring and laws, equivalent spring and dashpot
    skeleton: Table
    products: dict[str, float]  # this draw's products of parameters that small motion determines
    mass: float  # modal mass [kg]
    y_max: float  # largest displacement [m]
    # parameters of the whole joint, in the order of the file; if empty, the joint is that of a
    # one-mode oscillator
    quantities: tuple[Quantity, ...] = ()
    force_unit: str = "N"
    motion_unit: str = "m"  # unit of the displacement across the joint


def export(
    tree: xr.DataTree,
    mass: float = 1.0,
    y_max: float | None = None,
    *,
    draw: int | None = None,
    summary: RunSummary | None = None,
) -> Export:
    """Return one joint of a run in several conventions, with its backbone and its static loops.

    It is the requested draw, or by default the draw of highest posterior density among those that
    are typical in what the data determine (`best_draw`); means along a ridge are no joint.

    Args:
        tree: Result of the run.
        mass: Modal mass [kg]; 1 gives forces per kilogram.
        y_max: Largest displacement [m]; by default the largest fitted displacement.
        draw: Number of a draw, counted from 0, chain after chain.
        summary: Summary of the run, for its verdict.

    Raises:
        DataError: The posterior lacks a parameter, or the density of its draws.
        ConfigError: `mass` or `y_max` is not positive, or there is no such draw.
    """
    basis = basis_of(tree)
    laws, posterior = basis.laws, basis.posterior
    draws = every_draw(basis)
    if are_at_joints(laws):
        raise DataError(
            f"`export` is for one joint, but this run has the joints {', '.join(joints_of(laws))}.",
            remedy="Call `export_joints`, which exports all joints.",
        )
    if has_further_modes(posterior):
        warnings.warn(
            "The run has several modes; the joint is exported with the first mode, in units of "
            "that mode. The other modes are in `posterior.nc`.",
            stacklevel=2,
        )
    require_all(draws, laws)
    y_max = basis.y_peak if y_max is None else y_max
    _require_positive(y_max=y_max, mass=mass)
    amplitude = y_max * np.arange(1, NUM_AMPLITUDES + 1) / NUM_AMPLITUDES
    some = basis.thinned(NUM_DRAWS)
    every = curves(some, amplitude, laws)
    bands = {name: band(values) for name, values in zip(NAMES, every, strict=True)}
    if draw is None:
        number = best_draw(draws, density_of(tree), amplitude, bands, laws)
    else:
        number = stated_draw(draws, draw)
    exported = picked(draws, [number])
    theta = {name: float(values[0]) for name, values in exported.items()}
    return Export(
        (
            *verdict_of(summary or RunSummary()),
            messages.exported_draw(
                number,
                count_of(draws),
                messages.HIGHEST_DENSITY if draw is None else messages.AS_ASKED,
                mass,
            ),
            *origin(draws, number, exported, amplitude, bands, laws),
        ),
        theta,
        list(_parameters(draws, number, some, laws, mass)),
        backbone_table(exported, amplitude, bands, laws, mass),
        static_loops(exported, y_max, laws, mass),
        {name: values for name, values in some.items() if name != "gain"},
        materials_of(theta, laws, mass, y_max),
        laws,
        linear_parts(theta, laws, mass),
        skeletons(exported, y_max, laws, mass)[0],
        {name: float(values[0]) for name, _, values in products_of(exported, laws)},
        mass,
        y_max,
    )


def export_draws(tree: xr.DataTree, result: Export, count: int) -> tuple[tuple[int, Export], ...]:
    """Return evenly spaced draws of the posterior as separate exports, with their numbers.

    All have equal weight: their average represents the posterior.

    Args:
        tree: Result of the run.
        result: Export of the run.
        count: Number of draws.

    Raises:
        ConfigError: `count` is not from 1 to the number of draws.
    """
    draws = every_draw(basis_of(tree))
    numbers = evenly_numbered(count_of(draws), count)
    some = picked(draws, numbers)
    curves_of = skeletons(some, result.y_max, result.laws, result.mass)
    return tuple(
        (number, _of_draw(result, picked(some, [i]), number, curves_of[i]))
        for i, number in enumerate(numbers)
    )


def _of_draw(result: Export, draw: Draws, number: int, skeleton: Table) -> Export:
    """Return a copy of an export for another draw, given by its number and values."""
    theta = {name: float(values[0]) for name, values in draw.items()}
    laws, mass = result.laws, result.mass
    return replace(
        result,
        about=(result.about[0], messages.one_draw(number, mass)),
        joint=theta,
        materials=materials_of(theta, laws, mass, result.y_max),
        linear=linear_parts(theta, laws, mass),
        skeleton=skeleton,
        products={name: float(values[0]) for name, _, values in products_of(draw, laws)},
    )


def every_draw(basis: Basis) -> Draws:
    """Return all draws of the main posterior, with fixed parameters, without the source gain."""
    sizes = basis.posterior.sizes
    draws = basis.thinned(max(2, sizes["chain"] * sizes["draw"]))
    draws.pop("gain", None)
    return draws


def evenly_numbered(total: int, count: int) -> list[int]:
    """Return the numbers of `count` evenly spaced draws of a posterior.

    Raises:
        ConfigError: `count` is not from 1 to the number of draws.
    """
    if not 1 <= count <= total:
        raise ConfigError(
            f"Argument `draws` must be 1 to {total}, the draws of the run, but it is {count}."
        )
    return [(2 * i + 1) * total // (2 * count) for i in range(count)]


def require_all(draws: Draws, laws: Laws) -> None:
    """Raise an error if a posterior lacks a parameter of the oscillator.

    Raises:
        DataError: The posterior lacks a parameter.
    """
    needed = [name for name in parameter_names(laws) if name != "gain"]
    missing = [name for name in needed if name not in draws]
    if missing:
        raise DataError(
            f"The main posterior must contain {', '.join(needed)}, but lacks {', '.join(missing)}.",
            why=f"Without {', '.join(missing)} there is no oscillator to export.",
            remedy="Identify from tests that move the mass, such as noise, sweeps or tones.",
        )


def _require_positive(**arguments: float) -> None:
    for name, value in arguments.items():
        if not value > 0.0:
            raise ConfigError(
                f"Argument `{name}` must be positive, but it is {value:g}.",
                remedy=f"Give a positive value: --{name.replace('_', '-')}.",
            )


# -- verdict and origin of the export --------------------------------------------------------------
def verdict_of(summary: RunSummary) -> Iterable[str]:
    """Yield one line: the run's verdict, with the main reason for it."""
    status = summary.verdict.status or "not assessed"
    findings = [row for row in summary.verdict.findings if row.status == status]
    if status == "ok":
        why = f"all {len(findings)} findings are ok"
    else:
        why = findings[0].reason if findings else messages.NO_VERDICT
    words = messages.verdict_of(summary.campaign, status, why)
    # A line break in a campaign's text is removed, because it would end this comment line.
    yield printable(" ".join(words.replace(" :", ":").split()))


def origin(
    draws: Draws,
    number: int,
    exported: Draws,
    amplitude: NDArray[np.float64],
    bands: Bands,
    laws: Laws,
) -> Iterable[str]:
    """Yield sentences on whether the exported draw lies within the 99 % intervals of all draws."""
    for name, unit, values in products_of(draws, laws):
        low, _, high = band(values)
        value = values[number]
        inside_own = bool(low <= value <= high)
        yield messages.within_interval(name, value, unit, low, high, inside=inside_own)
    inside = bool(backbone_within(exported, amplitude, bands, laws)[0])
    yield messages.within_bands(inside=inside)


# -- tables ----------------------------------------------------------------------------------------
def _parameters(
    draws: Draws, number: int, some: Draws, laws: Laws, mass: float
) -> Iterable[dict[str, Any]]:
    units = {quantity.name: quantity.unit for quantity in (*OSCILLATOR, *quantities_of(laws))}
    names = [name for name in units if name in draws]
    for name in names:
        yield parameter_row("jbw", name, units[name], float(draws[name][number]), draws[name])
    for name, unit, values in products_of(draws, laws):
        yield parameter_row("jbw, products", name, unit, float(values[number]), values)
    theta = {name: float(draws[name][number]) for name in names}
    rows = zip(*(some[name] for name in names), strict=True)
    every = [_converted(dict(zip(names, map(float, row), strict=True)), laws, mass) for row in rows]
    for convention, exported in _converted(theta, laws, mass).items():
        for name, unit in exported.units.items():
            values = np.array([converted[convention].values[name] for converted in every])
            yield parameter_row(convention, name, unit, exported.values[name], values)


def parameter_row(
    convention: str, name: str, unit: str, value: float, values: NDArray[np.float64]
) -> dict[str, Any]:
    """Return a table row: the exported value of a parameter, with sd and quantiles of all draws."""
    facts = {"value": value, "sd": float(np.std(values))}
    facts |= dict(zip(MARKS, map(float, band(values)), strict=True))
    return {"convention": convention, "parameter": name, "unit": unit, **facts}


def _converted(theta: Mapping[str, float], laws: Laws, mass: float) -> Mapping[str, Conversion]:
    """Return the parameters in other conventions; empty unless the joint has a single law."""
    joint = oscillator_of(theta, laws)
    if len(joint.laws) != 1:
        return {}
    return joint.laws[0].convert(theta["omega_n"], theta["zeta"], mass)


def backbone_table(
    exported: Draws,
    amplitude: NDArray[np.float64],
    bands: Bands,
    laws: Laws,
    mass: float = 1.0,
) -> Table:
    """Return one draw's backbone as a table (frequency, damping, force), with bands of all draws.

    Quantities without bands are left out.
    """
    table = {"amplitude_m": amplitude}
    curve_by_name = dict(zip(NAMES, curves(exported, amplitude, laws), strict=True))
    for name, column in zip(NAMES, COLUMNS, strict=True):
        if name not in bands:
            continue
        scale = mass if name == "force" else 1.0
        table[column] = scale * curve_by_name[name][0]
        table |= {f"{column}_{m}": scale * q for m, q in zip(MARKS, bands[name], strict=True)}
    return table
