"""FMUs for co-simulation, FMI 2.0 and 3.0: C source of the laws' steps, compiled if possible.

The FMU's memory changes only with a step, so that an importer may try displacements before.
"""

import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import uuid
import zipfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from jbw.errors import RunError
from jbw.export.exports.program import (
    OfJoints,
    Parameter,
    Paths,
    Program,
    forms_of,
    parameters_of,
    without_form,
    write_text,
)
from jbw.export.one_joint import Export
from jbw.export.several_joints import JointsExport
from jbw.report.messages import study as messages

DESCRIPTION = messages.FMU
COMPILERS = ("cc", "gcc", "clang")
# Folder of the compiled code for each version and system, with the suffix of shared libraries.
SYSTEMS = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib"), "win32": ("win", ".dll")}
MACHINES = {"x86_64": "x86_64", "amd64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}
BASE = {"kg": {"kg": 1}, "m": {"m": 1}, "s": {"s": 1}, "rad": {}, "1": {},
        "N": {"kg": 1, "m": 1, "s": -2}}  # fmt: skip


class Variable(NamedTuple):
    """A variable of the FMU; value references count the variables in this order from 1."""

    name: str
    value: float
    unit: str
    meaning: str
    causality: str
    variability: str


def _code(version: int, folder: Path, result: Export) -> Paths:
    """Write the FMU; without a compiler it contains only C code, which importers can compile."""
    parameters = parameters_of(result)
    forms, variables = forms_of("c/laws", result), tuple(_variables(parameters, result))
    token = str(uuid.uuid5(uuid.NAMESPACE_OID, repr((version, result.about, parameters))))
    facts: dict[str, Any] = {
        "forms": forms, "memory": sum(form.memory for form in forms), "variables": variables,
        "units": units_of(variables), "token": token, "description": DESCRIPTION,
    }  # fmt: skip
    path = folder / f"joint_fmi{version}.fmu"
    with TemporaryDirectory() as name, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as fmu:
        root = Path(name)
        for part in ("sources", "documentation"):
            (root / part).mkdir()
        write_text(root / "modelDescription.xml", f"fmu/fmi{version}.xml", result, **facts)
        write_text(root / "documentation/index.html", "fmu/index.html", result, **facts)
        write_text(root / "sources/joint.c", f"fmu/fmi{version}.c", result, **facts)
        write_text(root / "sources/buildDescription.xml", "fmu/buildDescription.xml", result)
        compile_shared(root / "sources/joint.c", root / "binaries" / binary(version))
        for file in sorted(packed for packed in root.rglob("*") if packed.is_file()):
            fmu.write(file, file.relative_to(root).as_posix())
    return (path,)


def _card(folder: Path, result: Export) -> Paths:
    """Write the parameters as an SSP parameter set, from which importers set the FMU's values."""
    parameters = parameters_of(result)
    more = {"description": DESCRIPTION, "units": units_of(parameters)}
    return (write_text(folder / "joint.ssv", "fmu/joint.ssv", result, **more),)


def _joints_code(version: int, folder: Path, result: JointsExport) -> Paths:
    """Write one FMU per joint, each in a separate folder, in SI."""
    return _each_joint(partial(_code, version), folder, result)


def _joints_card(folder: Path, result: JointsExport) -> Paths:
    """Write the parameter values of each joint into a separate folder, in SI."""
    return _each_joint(_card, folder, result)


def _each_joint(
    write: Callable[[Path, Export], Paths], folder: Path, result: JointsExport
) -> Paths:
    paths = []
    for card in result.cards:
        own_folder = folder / card.name
        own_folder.mkdir(exist_ok=True)
        joint = card.in_si
        in_si = messages.joint_in_si(card.name, joint.motion_unit, joint.force_unit)
        paths += write(own_folder, replace(joint, about=(*result.about, in_si)))
    return tuple(paths)


def _any(result: JointsExport) -> None:
    """Accept all joints: every joint becomes a separate FMU, and an FMU contains no nodes."""


def _variables(parameters: Iterable[Parameter], result: Export) -> Iterable[Variable]:
    motion = result.motion_unit
    for name, unit in (("displacement", motion), ("velocity", f"{motion}/s")):
        yield Variable(name, 0.0, unit, f"{name} across the joint", "input", "continuous")
    laws, total = messages.FMU_FORCE, messages.FMU_TOTAL
    for name, meaning in (("force", laws), ("total_force", total)):
        yield Variable(name, 0.0, result.force_unit, meaning, "output", "continuous")
    for parameter in parameters:
        yield Variable(*parameter, "parameter", "fixed")


# -- units -----------------------------------------------------------------------------------------
def units_of(variables: Iterable[Variable | Parameter]) -> list[Mapping[str, Any]]:
    """Return the units of the variables, each with its powers of kilogram, metre and second."""
    names = dict.fromkeys(("s", *(variable.unit for variable in variables)))
    return [{"name": name, **base_powers(name)} for name in names]


def base_powers(unit: str) -> dict[str, int]:
    """Return the powers of kg, m and s in a unit in jbw's notation, such as `1/(m s^2)`."""
    powers = {"kg": 0, "m": 0, "s": 0}
    above, _, below = unit.partition("/")
    for part, sign in ((above, 1), (below.strip("()"), -1)):
        for name, power in re.findall(r"([A-Za-z]+|1)(?:\^(\d+))?", part):
            for base, exponent in BASE[name].items():
                powers[base] += sign * exponent * int(power or 1)
    return powers


# -- binaries --------------------------------------------------------------------------------------
def binary(version: int) -> str:
    """Return the path of this machine's binary inside `binaries`, such as `linux64/joint.so`."""
    system, suffix = SYSTEMS.get(sys.platform, (sys.platform, ".so"))
    machine = MACHINES.get(platform.machine().lower(), platform.machine().lower())
    if version == 2:
        return f"{system}{64 if machine == 'x86_64' else '-' + machine}/joint{suffix}"
    return f"{machine}-{'windows' if system == 'win' else system}/joint{suffix}"


def compiler() -> list[str] | None:
    """Return the command of a C compiler, from variable CC or the system; None if there is none."""
    named = shlex.split(os.environ.get("CC", ""))
    commands = [named] if named else [[name] for name in COMPILERS]
    return next((command for command in commands if shutil.which(command[0])), None)


def compile_shared(source: Path, target: Path) -> bool:
    """Compile a C file to a shared library; return False if there is no compiler.

    Raises:
        RunError: The compiler failed.
    """
    if (command := compiler()) is None:
        return False
    target.parent.mkdir(parents=True)
    flags = ["-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden"]
    command_line = [*command, *flags, "-o", str(target), str(source), "-lm"]
    done = subprocess.run(command_line, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RunError(
            f"The compiler `{' '.join(command)}` failed with code {done.returncode}: "
            f"{done.stderr[-500:]}",
            remedy="Set the environment variable CC to another compiler, for example CC=gcc, or "
            "set CC=none to write only sources.",
        )
    return True


FMI2, FMI3 = (
    Program(f"fmi{version}", f"FMI {version}.0", _card, partial(_code, version),
            without_form("c/laws"), OfJoints(_joints_card, partial(_joints_code, version), _any))
    for version in (2, 3)
)  # fmt: skip
