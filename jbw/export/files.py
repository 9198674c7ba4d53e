"""The files of a run's export, of one joint or of several: tables, program files, draws."""

import csv
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jbw.export.exports import PROGRAMS, USUAL, USUAL_OF_JOINTS, programs_named
from jbw.export.exports.fmu import compiler
from jbw.export.exports.program import (
    Paths,
    Program,
    commented,
    parameters_of,
    require_joints,
    require_law,
    takes_joints,
)
from jbw.export.one_joint import Export, export, export_draws
from jbw.export.several_joints import (
    JointsExport,
    export_joints,
    export_joints_draws,
    modal_quantities,
    refuse_options_of_one_joint,
)
from jbw.quantities import AT, are_at_joints
from jbw.report.messages import study as messages
from jbw.results.run import RunSummary
from jbw.verification.predictive_basis import laws_of_run

FMUS = ("fmi2", "fmi3")
Columns = Mapping[str, Sequence[Any] | NDArray[np.float64]]


def chosen_programs(names: Sequence[str], result: Export) -> tuple[Program, ...]:
    """Return the programs to write files for: those named, or the default ones for a joint.

    Usual programs that cannot represent the joint are left out.

    Raises:
        ConfigError: A program is unknown, or cannot take the joint.
    """
    if not names:
        usual = (PROGRAMS[name] for name in USUAL)
        return tuple(program for program in usual if not program.lacks(result))
    programs = programs_named(names)
    for program in programs:
        require_law(program, result)
    return programs


def write_export(
    folder: Path,
    result: Export,
    programs: Sequence[Program] | None = None,
    draws: Iterable[tuple[int, Export]] = (),
) -> tuple[Path, ...]:
    """Write parameters.csv, backbone.csv, loop.csv, jbw.mat and program files; return all paths.

    Text files begin with comment lines on the run's verdict and on the exported joint; so does
    `about` in jbw.mat. Each draw gets a folder, from draws/0001 on, and an entry in a manifest.
    """
    from scipy.io import savemat

    if programs is None:
        programs = chosen_programs((), result)
    tables = {
        "backbone.csv": (messages.BACKBONES, result.backbone),
        "loop.csv": (messages.SLOW_LOOPS, result.loop),
    }
    paths = _write_tables(folder, result, tables)
    matlab = {"about": np.array(result.about, object), "joint": result.joint}
    matlab |= {"draws": result.draws, "backbone": result.backbone, "loop": result.loop}
    savemat(folder / "jbw.mat", matlab, oned_as="column")
    paths.append(folder / "jbw.mat")
    for program in programs:
        paths += [*program.code(folder, result), *program.card(folder, result)]
    if draws := list(draws):
        rows = _draw_rows(folder, draws, [program.card for program in programs], _values_of_joint)
        units = {row["parameter"]: row["unit"] for row in result.parameters
                 if row["convention"].startswith("jbw")}  # fmt: skip
        units |= {parameter.name: parameter.unit for parameter in parameters_of(result)}
        paths.append(_write_manifest(folder, result, programs, units, rows))
    return tuple(dict.fromkeys(paths))


def chosen_programs_of_joints(names: Sequence[str], result: JointsExport) -> tuple[Program, ...]:
    """Return the programs to write files for: those named, or the default ones for several joints.

    Usual programs that cannot represent the joints are left out.

    Raises:
        ConfigError: A program is unknown, or cannot take the joints.
    """
    takers = [name for name, program in PROGRAMS.items() if program.joints is not None]
    if not names:
        usual = (PROGRAMS[name] for name in USUAL_OF_JOINTS)
        return tuple(program for program in usual if takes_joints(program, result))
    programs = programs_named(names)
    for program in programs:
        require_joints(program, result, takers)
    return programs


def write_joints(
    folder: Path,
    result: JointsExport,
    programs: Sequence[Program] | None = None,
    draws: Iterable[tuple[int, JointsExport]] = (),
) -> tuple[Path, ...]:
    """Write the tables of several joints, jbw.mat and files of programs; return all paths.

    A file contains all joints, one after the other, except FMUs, which have one folder per joint.
    Each draw gets a folder, from draws/0001 on, and an entry in a manifest.
    """
    from scipy.io import savemat

    if programs is None:
        programs = chosen_programs_of_joints((), result)
    tables = {
        "backbone.csv": (messages.BACKBONE_OF_FIRST_MODE, result.backbone),
        "loop.csv": (messages.LOOPS_OF_JOINTS, result.loops),
    }
    paths = _write_tables(folder, result, tables)
    loops = {name: np.asarray(column) for name, column in result.loops.items() if name != "joint"}
    matlab = {
        "about": np.array(result.about, object),
        "joint": _as_fields(result.joint),
        "draws": _as_fields(result.draws),
        "backbone": result.backbone,
        "loop": loops | {"joint": np.array(result.loops["joint"], object)},
    }
    savemat(folder / "jbw.mat", matlab, oned_as="column", long_field_names=True)
    paths.append(folder / "jbw.mat")
    takers = [program.joints for program in programs if program.joints is not None]
    for taker in takers:
        paths += [*taker.code(folder, result), *taker.card(folder, result)]
    if draws := list(draws):
        rows = _draw_rows(folder, draws, [taker.card for taker in takers], _values_of_joints)
        units = {
            "modes": {q.name: q.unit for q in modal_quantities(result)},
            "joints": {
                card.name: {p.name: p.unit for p in parameters_of(card.joint)}
                for card in result.cards
            },
        }
        paths.append(_write_manifest(folder, result, programs, units, rows))
    return tuple(dict.fromkeys(paths))


def _as_fields(by_name: Mapping[str, Any]) -> dict[str, Any]:
    """Replace "@" in names for MATLAB, so that `alpha@bolt_1` becomes `alpha_at_bolt_1`."""
    return {name.replace(AT, "_at_"): value for name, value in by_name.items()}


def notes_on(programs: Iterable[Program]) -> tuple[str, ...]:
    """Return warnings about the files of an export, such as that no compiler was found."""
    compiled = any(program.name.startswith("fmi") for program in programs)
    if not compiled or compiler() is not None:
        return ()
    return (messages.NO_COMPILER,)


def _values_of_joint(draw: Export) -> dict[str, Any]:
    """Return the parameters and products of one draw of a single joint."""
    parameters = {parameter.name: parameter.value for parameter in parameters_of(draw)}
    of_mode = {name: draw.joint[name] for name in ("omega_n", "zeta")}
    return {"parameters": parameters | of_mode, "products": draw.products}


def _values_of_joints(draw: JointsExport) -> dict[str, Any]:
    """Return one draw's parameters of the modes and of each joint."""
    return {
        "modes": {q.name: draw.joint[q.name] for q in modal_quantities(draw)},
        "joints": {
            card.name: {p.name: p.value for p in parameters_of(card.joint)} for card in draw.cards
        },
    }


def _draw_rows[Exported](
    folder: Path,
    draws: Sequence[tuple[int, Exported]],
    cards: Sequence[Callable[[Path, Exported], Paths]],
    values_of: Callable[[Exported], dict[str, Any]],
) -> list[dict[str, Any]]:
    """Write a parameter file per draw and program; return the entries for manifest.json."""
    rows = []
    for i, (number, draw) in enumerate(draws, start=1):
        draw_folder = folder / "draws" / f"{i:04d}"
        draw_folder.mkdir(parents=True)
        files = {path for card in cards for path in card(draw_folder, draw)}
        rows.append(
            {
                "folder": draw_folder.relative_to(folder).as_posix(),
                "draw": number,
                "weight": 1.0 / len(draws),
                **values_of(draw),
                "files": sorted(path.relative_to(draw_folder).as_posix() for path in files),
            }
        )
    return rows


def _write_manifest(
    folder: Path,
    result: Export | JointsExport,
    programs: Sequence[Program],
    units: Mapping[str, Any],
    rows: Sequence[Mapping[str, Any]],
) -> Path:
    """Write manifest.json, which lists the exported draws with their files and values."""
    manifest = {
        "about": result.about,
        "laws": result.laws,
        "programs": [program.name for program in programs],
        "units": units,
        "draws": rows,
    }
    path = folder / "manifest.json"
    path.write_text(json.dumps(manifest, indent=1, ensure_ascii=False), encoding="utf-8")
    return path


def _write_tables(
    folder: Path,
    result: Export | JointsExport,
    tables: Mapping[str, tuple[str, Columns]],
) -> list[Path]:
    """Write parameters.csv and other tables as CSV files, each headed by a description."""
    header = list(result.parameters[0])
    rows = [row.values() for row in result.parameters]
    paths = [_write_rows(folder / "parameters.csv", result.about, header, rows)]
    for name, (what, table) in tables.items():
        columns = zip(*table.values(), strict=True)
        paths.append(_write_rows(folder / name, (*result.about, what), list(table), columns))
    return paths


def _write_rows(
    path: Path, notes: Iterable[str], header: Sequence[str], rows: Iterable[Iterable[Any]]
) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        file.writelines(f"{line}\r\n" for line in commented(notes, "# ").split("\n"))
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(rows)
    return path


class RunExport(NamedTuple):
    """The content of a run's export, and the function that writes it.

    Attributes:
        about: The run's verdict and the exported joint, one line each.
        programs: Programs whose files are written.
        notes: Notes on these files.
        write: Function that writes all of it into a folder and returns the files.
    """

    about: tuple[str, ...]
    programs: tuple[Program, ...]
    notes: tuple[str, ...]
    write: Callable[[Path], tuple[Path, ...]]


def export_of_run(
    tree: xr.DataTree,
    summary: RunSummary,
    names: Sequence[str] = (),
    *,
    fmu: bool = False,
    count: int | None = None,
    mass: float | None = None,
    y_max: float | None = None,
    draw: int | None = None,
) -> RunExport:
    """Return everything that an export of a run's joint, or of all its joints, writes.

    Args:
        tree: Result of the run.
        summary: Summary of the run.
        names: Names of programs; by default the usual ones.
        fmu: Whether FMUs are written as well.
        count: Number of draws with separate cards; none by default.
        mass: Modal mass [kg] of a single joint.
        y_max: Largest displacement [m] of a single joint.
        draw: Number of the draw.

    Raises:
        ConfigError: A program is unknown or cannot take the joint, or an option does not apply.
        DataError: The run lacks something that an export needs.
    """
    if are_at_joints(laws_of_run(tree)):
        refuse_options_of_one_joint(mass=mass, y_max=y_max)
        joints = export_joints(tree, draw=draw, summary=summary)
        chosen = partial(chosen_programs_of_joints, result=joints)
        programs = _with_fmus(chosen, names, fmu=fmu)
        draws = () if count is None else export_joints_draws(tree, joints, count)
        write = partial(write_joints, result=joints, programs=programs, draws=draws)
        usual = USUAL_OF_JOINTS
        lines = joints.about
    else:
        of_mass = {} if mass is None else {"mass": mass}
        joint = export(tree, y_max=y_max, draw=draw, summary=summary, **of_mass)
        programs = _with_fmus(partial(chosen_programs, result=joint), names, fmu=fmu)
        draws = () if count is None else export_draws(tree, joint, count)
        write = partial(write_export, result=joint, programs=programs, draws=draws)
        usual = USUAL
        lines = joint.about
    chosen_names = [program.name for program in programs]
    skipped = [] if names else [name for name in usual if name not in chosen_names]
    formless = (messages.without_form(PROGRAMS[name].title) for name in skipped)
    return RunExport(lines, programs, (*notes_on(programs), *formless), write)


def _with_fmus(
    chosen: Callable[[Sequence[str]], tuple[Program, ...]], names: Sequence[str], *, fmu: bool
) -> tuple[Program, ...]:
    programs = chosen(names)
    return tuple(dict.fromkeys((*programs, *chosen(FMUS)))) if fmu else programs
