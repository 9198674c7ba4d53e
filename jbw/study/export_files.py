"""The files that `jbw export` writes: tables, other programs' files and cards of draws."""

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jbw.report.messages import study as messages
from jbw.study.export import Export
from jbw.study.exports import PROGRAMS, USUAL, programs_named
from jbw.study.exports.fmu import compiler
from jbw.study.exports.program import Program, commented, parameters_of, require_law

LOOP = messages.SLOW_LOOPS
BACKBONE = messages.BACKBONES


class Numbered(NamedTuple):
    """A draw as an export of its own, and its number in the posterior."""

    number: int
    result: Export


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


def notes_on(programs: Iterable[Program]) -> tuple[str, ...]:
    """What must be said of what was written."""
    compiled = any(program.name.startswith("fmi") for program in programs)
    if not compiled or compiler() is not None:
        return ()
    return (messages.NO_COMPILER,)


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
    path = folder / "manifest.json"
    path.write_text(json.dumps(manifest, indent=1, ensure_ascii=False), encoding="utf-8")
    return path


def _write_table(
    path: Path, notes: Iterable[str], table: Mapping[str, NDArray[np.float64]]
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
