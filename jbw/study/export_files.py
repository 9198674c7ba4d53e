"""The files that `jbw export` writes: CSV, MATLAB and OpenSees, each with the run's verdict."""

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jbw.oscillator.parameters import Material, Scalar
from jbw.study.export import Export

JOINT_TAG = 1  # of the material that is the whole joint in OpenSees
LOOP = "Steady loops under slow motion: the force of spring and joint, without any damper."
BACKBONE = "Resonance frequency, equivalent damping and force against amplitude."
OPENSEES = (
    f"Material {JOINT_TAG} is spring and joint, in N, m and kg; mass and zeta are the model's."
)


def write_export(folder: Path, result: Export) -> tuple[Path, ...]:
    """Write parameters.csv, backbone.csv, loop.csv, jbw.mat and joint.tcl; return the files.

    Texts begin with lines of comment, `# `, which say the run's verdict and which joint this is;
    so does `about` of jbw.mat. There is no joint.tcl where OpenSees lacks one of the forces.
    """
    from scipy.io import savemat

    parameters = result.parameters
    rows = [row.values() for row in parameters]
    made = [_write_rows(folder / "parameters.csv", result.about, list(parameters[0]), rows)]
    for name, what, table in (
        ("backbone.csv", BACKBONE, result.backbone),
        ("loop.csv", LOOP, result.loop),
    ):
        made.append(_write_table(folder / name, (*result.about, what), table))
    matlab = {"about": np.array(result.about, object), "joint": result.joint}
    matlab |= {"draws": result.draws, "backbone": result.backbone, "loop": result.loop}
    savemat(folder / "jbw.mat", matlab, oned_as="column")
    made.append(folder / "jbw.mat")
    if result.materials:
        lines = (*_comments((*result.about, OPENSEES)), *opensees_lines(result.materials))
        made.append(folder / "joint.tcl")
        made[-1].write_text("\n".join((*lines, "")), encoding="utf-8")
    return tuple(made)


def opensees_lines(materials: Sequence[Material]) -> tuple[str, ...]:
    """Commands that make materials and set them in parallel, as material 1."""
    tags = range(JOINT_TAG + 1, JOINT_TAG + 1 + len(materials))
    lines = [_line(one.kind, tag, one.arguments) for tag, one in zip(tags, materials, strict=True)]
    return (*lines, _line("Parallel", JOINT_TAG, tuple(map(str, tags))))


def _line(kind: str, tag: int, arguments: Iterable[Scalar | str]) -> str:
    words = (one if isinstance(one, str) else f"{float(one):.17g}" for one in arguments)
    return " ".join(("uniaxialMaterial", kind, str(tag), *words))


def _comments(about: Iterable[str]) -> Iterable[str]:
    """Lines of comment."""
    return (f"# {each}" for each in about)


def _write_table(
    path: Path, about: Iterable[str], table: Mapping[str, NDArray[np.float64]]
) -> Path:
    return _write_rows(path, about, list(table), zip(*table.values(), strict=True))


def _write_rows(
    path: Path, about: Iterable[str], header: Sequence[str], rows: Iterable[Iterable[Any]]
) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        file.writelines(f"{line}\r\n" for line in _comments(about))
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(rows)
    return path
