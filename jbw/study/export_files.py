"""The files that `jbw export` writes: tables, other programs' files and cards of draws."""

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jbw.quantities import AT
from jbw.report.messages import study as messages
from jbw.study.export import Export
from jbw.study.exported_joints import JointsExport, modal_quantities
from jbw.study.exports import PROGRAMS, USUAL, USUAL_OF_JOINTS, programs_named
from jbw.study.exports.fmu import compiler
from jbw.study.exports.program import (
    OfJoints,
    Program,
    commented,
    parameters_of,
    require_joints,
    require_law,
    takes_joints,
)

LOOP = messages.SLOW_LOOPS
BACKBONE = messages.BACKBONES


class Numbered(NamedTuple):
    """A draw as an export of its own, and its number in the posterior."""

    number: int
    result: Export


class NumberedJoints(NamedTuple):
    """The same of several joints."""

    number: int
    result: JointsExport


def chosen_programs(names: Sequence[str], result: Export) -> tuple[Program, ...]:
    """The programs of some names; of none the usual ones, as far as they take the joint.

    Raises:
        ConfigError: One is not known, or cannot take the joint.
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
    """Write parameters.csv, backbone.csv, loop.csv, jbw.mat and programs' files; return the files.

    Texts begin with lines of comment which say the run's verdict and which joint this is; so does
    `about` of jbw.mat. Draws get a folder each, draws/0001 on, and a manifest.
    """
    from scipy.io import savemat

    if programs is None:
        programs = chosen_programs((), result)
    parameters = result.parameters
    rows = [row.values() for row in parameters]
    paths = [_write_rows(folder / "parameters.csv", result.about, list(parameters[0]), rows)]
    for name, what, table in (
        ("backbone.csv", BACKBONE, result.backbone),
        ("loop.csv", LOOP, result.loop),
    ):
        paths.append(_write_table(folder / name, (*result.about, what), table))
    matlab = {"about": np.array(result.about, object), "joint": result.joint}
    matlab |= {"draws": result.draws, "backbone": result.backbone, "loop": result.loop}
    savemat(folder / "jbw.mat", matlab, oned_as="column")
    paths.append(folder / "jbw.mat")
    for program in programs:
        paths += [*program.code(folder, result), *program.card(folder, result)]
    if draws := [Numbered(*draw) for draw in draws]:
        paths.append(_write_draws(folder, result, programs, draws))
    return tuple(dict.fromkeys(paths))


def chosen_programs_of_joints(names: Sequence[str], result: JointsExport) -> tuple[Program, ...]:
    """The programs of some names; of none the usual ones, as far as they take the joints.

    Raises:
        ConfigError: One is not known, or cannot take the joints.
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
    """Write the tables of several joints, jbw.mat and programs' files; return the files.

    A file has all joints, one after the other, but FMUs, which have a folder a joint. Draws get a
    folder each, draws/0001 on, and a manifest.
    """
    from scipy.io import savemat

    if programs is None:
        programs = chosen_programs_of_joints((), result)
    rows = [row.values() for row in result.parameters]
    header = list(result.parameters[0])
    paths = [_write_rows(folder / "parameters.csv", result.about, header, rows)]
    for name, what, table in (
        ("backbone.csv", messages.BACKBONE_OF_FIRST_MODE, result.backbone),
        ("loop.csv", messages.LOOPS_OF_JOINTS, result.loops),
    ):
        paths.append(_write_table(folder / name, (*result.about, what), table))
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
    for joints in _of_joints(programs):
        paths += [*joints.code(folder, result), *joints.card(folder, result)]
    if numbered := [NumberedJoints(*draw) for draw in draws]:
        paths.append(_write_joints_draws(folder, result, programs, numbered))
    return tuple(dict.fromkeys(paths))


def _of_joints(programs: Iterable[Program]) -> list[OfJoints]:
    return [program.joints for program in programs if program.joints is not None]


def _as_fields(by_name: Mapping[str, Any]) -> dict[str, Any]:
    """The same by names that MATLAB takes: `alpha@bolt_1` is `alpha_at_bolt_1`."""
    return {name.replace(AT, "_at_"): value for name, value in by_name.items()}


def notes_on(programs: Iterable[Program]) -> tuple[str, ...]:
    """What must be said of what was written."""
    compiled = any(program.name.startswith("fmi") for program in programs)
    if not compiled or compiler() is not None:
        return ()
    return (messages.NO_COMPILER,)


def _write_joints_draws(
    folder: Path,
    result: JointsExport,
    programs: Sequence[Program],
    draws: Sequence[NumberedJoints],
) -> Path:
    """A card of every program for each draw, and manifest.json, which says what each is."""
    rows = []
    for i, numbered in enumerate(draws, start=1):
        draw_folder = folder / "draws" / f"{i:04d}"
        draw_folder.mkdir(parents=True)
        cards = {
            path
            for joints in _of_joints(programs)
            for path in joints.card(draw_folder, numbered.result)
        }
        rows.append(
            {
                "folder": draw_folder.relative_to(folder).as_posix(),
                "draw": numbered.number,
                "weight": 1.0 / len(draws),
                "modes": {
                    q.name: numbered.result.joint[q.name] for q in modal_quantities(numbered.result)
                },
                "joints": {
                    card.name: {p.name: p.value for p in parameters_of(card.joint)}
                    for card in numbered.result.cards
                },
                "files": sorted(path.relative_to(draw_folder).as_posix() for path in cards),
            }
        )
    units = {
        card.name: {p.name: p.unit for p in parameters_of(card.joint)} for card in result.cards
    }
    manifest = {
        "about": result.about,
        "laws": result.laws,
        "programs": [program.name for program in programs],
        "units": {
            "modes": {q.name: q.unit for q in modal_quantities(result)},
            "joints": units,
        },
        "draws": rows,
    }
    return _write_json(folder / "manifest.json", manifest)


def _write_draws(
    folder: Path, result: Export, programs: Sequence[Program], draws: Sequence[Numbered]
) -> Path:
    """A card of every program for each draw, and manifest.json, which says what each is."""
    rows = []
    for i, numbered in enumerate(draws, start=1):
        draw_folder = folder / "draws" / f"{i:04d}"
        draw_folder.mkdir(parents=True)
        cards = {
            path for program in programs for path in program.card(draw_folder, numbered.result)
        }
        rows.append(
            {
                "folder": draw_folder.relative_to(folder).as_posix(),
                "draw": numbered.number,
                "weight": 1.0 / len(draws),
                "parameters": {
                    parameter.name: parameter.value for parameter in parameters_of(numbered.result)
                }
                | {name: numbered.result.joint[name] for name in ("omega_n", "zeta")},
                "products": numbered.result.products,
                "files": sorted(path.name for path in cards),
            }
        )
    units = {row["parameter"]: row["unit"] for row in result.parameters
             if row["convention"].startswith("jbw")}  # fmt: skip
    units |= {parameter.name: parameter.unit for parameter in parameters_of(result)}
    manifest = {
        "about": result.about,
        "laws": result.laws,
        "programs": [program.name for program in programs],
        "units": units,
        "draws": rows,
    }
    return _write_json(folder / "manifest.json", manifest)


def _write_json(path: Path, value: Mapping[str, Any]) -> Path:
    path.write_text(json.dumps(value, indent=1, ensure_ascii=False), encoding="utf-8")
    return path


def _write_table(
    path: Path, notes: Iterable[str], table: Mapping[str, Sequence[Any] | NDArray[np.float64]]
) -> Path:
    return _write_rows(path, notes, list(table), zip(*table.values(), strict=True))


def _write_rows(
    path: Path, notes: Iterable[str], header: Sequence[str], rows: Iterable[Iterable[Any]]
) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        file.writelines(f"{line}\r\n" for line in commented(notes, "# ").split("\n"))
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(rows)
    return path
