r"""The export of several joints to the program from which their structure's matrices came.

A joint acts across its motion $x_j = w_j^Tq$, in physical units: it consists of the laws and a
spring with the rest of the fully stuck stiffness, $k_j - \sum_lK_l$. Its force $F_j$ acts on the
degrees of freedom as $w_jF_j$. With the joint as an oscillator of unit mass with $\omega_n^2 = k_j$
and without damping, the formulas for the export of one joint hold for it.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from jbw.assembly.joint_units import JointUnits, Terms, joint_units, rotates, terms_in
from jbw.errors import ConfigError
from jbw.export.chosen_draw import best_draw, density_of, picked, products_of, stated_draw
from jbw.export.joint_parts import Table, linear_parts, materials_of, skeletons, static_loops
from jbw.export.one_joint import (
    LINEAR,
    NAMES,
    NUM_AMPLITUDES,
    NUM_DRAWS,
    Export,
    backbone_table,
    evenly_numbered,
    every_draw,
    origin,
    parameter_row,
    require_all,
    verdict_of,
)
from jbw.oscillator.laws import laws_named
from jbw.oscillator.modes.assembled import laws_at, motion_in
from jbw.quantities import MODES, OSCILLATOR, Quantity, motion_factors_in, split
from jbw.report.messages import study as messages
from jbw.results.run import RunSummary
from jbw.study.assembly_group import ModelJoint, ModelJoints, assembly_of
from jbw.verification.backbone import curves
from jbw.verification.bands import band
from jbw.verification.predictive_basis import Basis, Draws, Laws, basis_of, count_of

SI = "SI"
UNIT_MASS = 1.0  # The forces of several joints are in newtons, and are not divided by a modal mass.
FACTOR = LINEAR[0]._replace(unit="1", meaning=messages.LAW_FACTOR)
# The backbone has no column of force, because a force belongs to one point of the structure.
BACKBONE_NAMES = NAMES[:2]


class JointCard(NamedTuple):
    """One joint of one exported draw, with its degrees of freedom and units.

    Attributes:
        name: Name of the joint, as in its parameters, such as `bolt_1`.
        terms: Degrees of freedom and their factors, in the units of the model.
        units: Units of its motion and force in the system of the model.
        hz: Frequency of the mode that moved it most [Hz], at which dashpots have the joint's loss.
        joint: The joint in the units of the model.
        in_si: The joint in SI.
    """

    name: str
    terms: Terms
    units: JointUnits
    hz: float
    joint: Export
    in_si: Export


@dataclass(frozen=True)
class JointsExport:
    """The export of several joints, which `write_joints` writes.

    Attributes:
        about: The run's verdict, the number of this draw and a description of each joint, one line
            each.
        parameters: Rows with joint, parameter, unit, value, sd and quantiles.
        backbone: Frequency and damping of the first mode against the motion of the first point.
        loops: Steady loops of every joint under slow motion, in SI.
        draws: Parameters of many draws, by name.
        joint: Parameters of this draw, by name.
        cards: Joints that have laws.
        laws: Names of all laws with their joints.
        assembly: Degrees of freedom of all joints.
    """

    about: tuple[str, ...]
    parameters: list[dict[str, Any]]
    backbone: Table
    loops: Mapping[str, Sequence[Any]]
    draws: Draws
    joint: dict[str, float]
    cards: tuple[JointCard, ...]
    laws: Laws
    assembly: ModelJoints


def export_joints(
    tree: xr.DataTree, *, draw: int | None = None, summary: RunSummary | None = None
) -> JointsExport:
    """Export all joints of a run, for the most probable draw or a given draw.

    Args:
        tree: Result of the run.
        draw: Number of a draw, counted from 0, chain after chain.
        summary: Summary of the run, for its verdict.

    Raises:
        DataError: The run lacks the joints' degrees of freedom, a parameter or the density.
        ConfigError: There is no such draw.
    """
    basis, assembly = basis_of(tree), assembly_of(tree)
    laws, draws = basis.laws, every_draw(basis)
    require_all(draws, laws)
    amplitude = basis.y_peak * np.arange(1, NUM_AMPLITUDES + 1) / NUM_AMPLITUDES
    some = basis.thinned(NUM_DRAWS)
    every = curves(some, amplitude, laws)[: len(BACKBONE_NAMES)]
    bands = {name: band(values) for name, values in zip(BACKBONE_NAMES, every, strict=True)}
    if draw is None:
        number = best_draw(draws, density_of(tree), amplitude, bands, laws)
    else:
        number = stated_draw(draws, draw)
    chosen = picked(draws, [number])
    (cards,) = _cards(chosen, basis, assembly, tree)
    which = messages.exported_joints(
        number,
        count_of(draws),
        messages.HIGHEST_DENSITY if draw is None else messages.AS_ASKED,
        assembly.units,
    )
    about = (
        *verdict_of(summary or RunSummary()),
        which,
        *_modes(chosen, tree),
        *origin(draws, number, chosen, amplitude, bands, laws),
        *_places(assembly, cards),
    )
    return JointsExport(
        about,
        list(_parameters(draws, number, assembly, laws)),
        backbone_table(chosen, amplitude, bands, laws),
        _loops(cards),
        some,
        {name: float(values[0]) for name, values in chosen.items()},
        cards,
        laws,
        assembly,
    )


def export_joints_draws(
    tree: xr.DataTree, result: JointsExport, count: int
) -> tuple[tuple[int, JointsExport], ...]:
    """Return evenly spaced draws of the posterior as separate exports, with their numbers.

    Raises:
        ConfigError: `count` is not from 1 to the number of draws.
    """
    basis = basis_of(tree)
    draws = every_draw(basis)
    numbers = evenly_numbered(count_of(draws), count)
    some = picked(draws, numbers)
    cards = _cards(some, basis, result.assembly, tree)
    system = result.assembly.units
    return tuple(
        (
            number,
            JointsExport(
                (
                    result.about[0],
                    messages.one_of_joints_draws(number, system),
                    *_modes(picked(some, [i]), tree),
                    *_places(result.assembly, cards_of_draw),
                ),
                result.parameters,
                result.backbone,
                result.loops,
                result.draws,
                {name: float(values[i]) for name, values in some.items()},
                cards_of_draw,
                result.laws,
                result.assembly,
            ),
        )
        for i, (number, cards_of_draw) in enumerate(zip(numbers, cards, strict=True))
    )


def refuse_options_of_one_joint(**options: Any) -> None:
    """Raise an error if an option is given that applies only to a single joint.

    Raises:
        ConfigError: An option is given.
    """
    for name, value in options.items():
        if value is not None:
            raise ConfigError(
                f"Option `--{name.replace('_', '-')}` must be left out for a run with several "
                f"joints, but it is {value:g}.",
                why="Laws of several joints are in newtons and metres, and the table of each joint "
                "extends to the largest measured motion of the joint.",
                remedy="Leave this option out.",
            )


# -- the joints ------------------------------------------------------------------------------------
def _cards(
    draws: Draws, basis: Basis, assembly: ModelJoints, tree: xr.DataTree
) -> list[tuple[JointCard, ...]]:
    """Return, for every draw, the joints that have laws, ready for export."""
    count = count_of(draws)
    per_joint = []
    for model_joint in assembly.joints:
        names = tuple(law for law in basis.laws if model_joint.name in split(law)[1])
        if names:
            per_joint.append(_cards_of_joint(draws, model_joint, names, assembly, tree))
    return [tuple(cards[i] for cards in per_joint) for i in range(count)]


def _cards_of_joint(
    draws: Draws, model_joint: ModelJoint, names: Laws, assembly: ModelJoints, tree: xr.DataTree
) -> list[JointCard]:
    is_rotation = rotates(model_joint.terms)
    units = joint_units(assembly.units, rotates=is_rotation)
    reach, hz = _largest_motion(draws, model_joint.name, tree)
    in_si = _exports(draws, model_joint, names, joint_units(SI, rotates=is_rotation), reach, hz)
    in_units = _exports(draws, model_joint, names, units, reach, hz)
    terms = terms_in(units, model_joint.terms)
    return [
        JointCard(model_joint.name, terms, units, hz, joint, joint_in_si)
        for joint, joint_in_si in zip(in_units, in_si, strict=True)
    ]


def _largest_motion(draws: Draws, name: str, tree: xr.DataTree) -> tuple[float, float]:
    """Return a joint's largest measured motion, and the frequency of the mode that caused it.

    Where mode shapes are uncertain, the draw with the largest motion counts.
    """
    modes = tree["joints"].to_dataset()
    shapes = [np.max(np.abs(motion_in(draws, int(i), name))) for i in modes["mode"].values]
    motion = np.array(shapes) * modes["amplitude"].values
    largest = int(np.nanargmax(motion))
    return float(motion[largest]), float(modes["frequency_hz"].values[largest])


def _exports(
    draws: Draws, model_joint: ModelJoint, names: Laws, units: JointUnits, reach: float, hz: float
) -> list[Export]:
    """Return exports of one joint for every draw, as oscillators of unit mass in given units."""
    laws = tuple(split(name)[0] for name in names)
    plain, quantities = _plain(draws, model_joint, names, units)
    peak = float(units.value(reach, "m"))
    tables = skeletons(plain, peak, laws, UNIT_MASS)
    found = []
    for i, table in enumerate(tables):
        draw = picked(plain, [i])
        theta = {name: float(values[0]) for name, values in draw.items()}
        found.append(
            Export(
                about=(),
                joint=theta,
                parameters=[],
                backbone={},
                loop=static_loops(draw, peak, laws, UNIT_MASS),
                draws={},
                materials=materials_of(theta, laws, UNIT_MASS, peak),
                laws=laws,
                linear=linear_parts(theta, laws, UNIT_MASS),
                skeleton=_losing_at(table, hz, units.time),
                products={name: float(values[0]) for name, _, values in products_of(draw, laws)},
                mass=UNIT_MASS,
                y_max=peak,
                quantities=quantities,
                force_unit=units.unit("N"),
                motion_unit=units.unit("m"),
            )
        )
    return found


def _plain(
    draws: Draws, model_joint: ModelJoint, names: Laws, units: JointUnits
) -> tuple[Draws, tuple[Quantity, ...]]:
    """Return a joint's parameters in given units, with definitions; names omit the joint."""
    count = count_of(draws)
    values: Draws = {
        "omega_n": np.full(count, np.sqrt(units.value(model_joint.stiffness, "N/m"))),
        "zeta": np.zeros(count),
    }
    _, spring, dashpot = LINEAR
    table = [FACTOR, *(q._replace(unit=units.unit(q.unit)) for q in (spring, dashpot))]
    laws = laws_at(draws, names, model_joint.name)
    for law, kind in zip(laws, laws_named(names), strict=True):
        powers, parameters = law.powers_of_length(), law.parameters()
        for quantity, at_joint in zip(type(law).table, kind.table, strict=True):
            name = quantity.name
            si = np.asarray(parameters[name], float)
            values[name] = np.broadcast_to(
                units.value(si, at_joint.unit, np.asarray(powers.get(name, 0.0))), count
            )
            table.append(quantity._replace(unit=units.unit(at_joint.unit)))
    return values, tuple(table)


def _losing_at(skeleton: Table, hz: float, time: float) -> Table:
    """Return a force-displacement table whose dashpots dissipate as much as the joint at `hz`.

    The values of the table are in a system whose unit of time has `time` seconds.
    """
    own, omega = np.sqrt(skeleton["stiffness_n_m"]), 2.0 * np.pi * hz * time
    return {**skeleton, "damping_ns_m": skeleton["damping_ns_m"] * own / omega}


def modal_quantities(result: JointsExport) -> tuple[Quantity, ...]:
    """Return the frequency and the damping ratio of every mode that the tests drove."""
    return _modal(result.joint)


def _modal(theta: Mapping[str, Any]) -> tuple[Quantity, ...]:
    quantities = (*OSCILLATOR[:2], *(q for mode in MODES for q in mode[:2]))
    return tuple(q for q in quantities if q.name in theta)


# -- words and tables ------------------------------------------------------------------------------
def _modes(draw: Draws, tree: xr.DataTree) -> Iterable[str]:
    """Yield sentences on each mode's fully stuck frequency: identified, and from the matrices."""
    model_hz = tree["joints"].to_dataset()["frequency_hz"].values
    pairs = zip(_modal(draw)[::2], _modal(draw)[1::2], model_hz, strict=True)
    for i, (omega, zeta, hz) in enumerate(pairs, start=1):
        fitted_hz, ratio = float(draw[omega.name][0]) / (2 * np.pi), float(draw[zeta.name][0])
        yield messages.mode_beside_matrices(i, fitted_hz, float(hz), ratio)
    for name, factor in motion_factors_in(draw).items():
        yield messages.motion_beside_matrices(factor.meaning, float(draw[name][0]))


def _places(assembly: ModelJoints, cards: Sequence[JointCard]) -> Iterable[str]:
    """Yield a sentence on each joint: its location, its stiffness, and whether it has a law."""
    by_name = {card.name: card for card in cards}
    for model_joint in assembly.joints:
        units = joint_units(assembly.units, rotates=rotates(model_joint.terms))
        terms = terms_in(units, model_joint.terms)
        motion = " ".join(f"{weight:+.6g} ({dof})" for dof, weight in terms)
        stiffness = float(units.value(model_joint.stiffness, "N/m"))
        yield messages.joint_place(
            model_joint.name,
            (motion.removeprefix("+"), units.unit("m")),
            (stiffness, units.unit("N/m")),
            is_held=assembly.holds_joints,
            has_law=model_joint.name in by_name,
        )


def _parameters(
    draws: Draws, number: int, assembly: ModelJoints, laws: Laws
) -> Iterable[dict[str, Any]]:
    """Yield parameter rows: modes, then each joint's laws in SI and in units of the matrices."""
    for quantity in (*_modal(draws), *motion_factors_in(draws).values()):
        values = draws[quantity.name]
        row = parameter_row(SI, quantity.name, quantity.unit, float(values[number]), values)
        yield {"joint": "", **row}
    for model_joint in assembly.joints:
        names = tuple(law for law in laws if model_joint.name in split(law)[1])
        is_rotation = rotates(model_joint.terms)
        for system in dict.fromkeys((SI, assembly.units)) if names else ():
            units = joint_units(system, rotates=is_rotation)
            values, table = _plain(draws, model_joint, names, units)
            for quantity in table[len(LINEAR) :]:
                of_draws = values[quantity.name]
                row = parameter_row(
                    system, quantity.name, quantity.unit, float(of_draws[number]), of_draws
                )
                yield {"joint": model_joint.name, **row}


def _loops(cards: Sequence[JointCard]) -> Mapping[str, Sequence[Any]]:
    """Return the steady loops of all joints in SI, joined into one table."""
    names = ("joint", "motion_peak", "motion", "force")
    columns: dict[str, list[Any]] = {name: [] for name in names}
    for card in cards:
        loop = card.in_si.loop
        columns["joint"] += [card.name] * loop["force_n"].size
        for name, of_joint in (
            ("motion_peak", "y_peak_m"),
            ("motion", "displacement_m"),
            ("force", "force_n"),
        ):
            columns[name] += loop[of_joint].tolist()
    return columns
