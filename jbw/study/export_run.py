"""The export of a finished run, of one joint or of several: what is written, before it is."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import xarray as xr

from jbw.quantities import are_at_joints
from jbw.report.messages.study import without_form
from jbw.study.export import export, export_draws
from jbw.study.export_files import (
    chosen_programs,
    chosen_programs_of_joints,
    notes_on,
    write_export,
    write_joints,
)
from jbw.study.exported_joints import (
    export_joints,
    export_joints_draws,
    refuse_options_of_one_joint,
)
from jbw.study.exports import PROGRAMS, USUAL, USUAL_OF_JOINTS
from jbw.study.exports.program import Program
from jbw.verification.predictive_basis import laws_of_run

FMUS = ("fmi2", "fmi3")


class RunExport(NamedTuple):
    """What an export holds, and what writes it.

    Attributes:
        about: The run's verdict and what is exported, a line each.
        programs: Whose files are written.
        notes: What must be said of them.
        write: Writes all of it into a folder and returns the files.
    """

    about: tuple[str, ...]
    programs: tuple[Program, ...]
    notes: tuple[str, ...]
    write: Callable[[Path], tuple[Path, ...]]


def export_of_run(
    tree: xr.DataTree,
    summary: Mapping[str, Any],
    names: Sequence[str] = (),
    *,
    fmu: bool = False,
    count: int | None = None,
    mass: float | None = None,
    y_max: float | None = None,
    draw: int | None = None,
) -> RunExport:
    """The export of a run's joint, or of all its joints.

    Args:
        tree: The run's result.
        summary: Its summary.
        names: Programs; none takes the usual ones.
        fmu: Whether FMUs are written as well.
        count: How many draws get cards of their own; none by default.
        mass: Modal mass [kg] of one joint.
        y_max: Largest displacement [m] of one joint.
        draw: Number of the draw.

    Raises:
        ConfigError: A program is not known or cannot take the joint, or an option has no meaning.
        DataError: The run lacks what an export needs.
    """
    if are_at_joints(laws_of_run(tree)):
        refuse_options_of_one_joint(mass=mass, y_max=y_max)
        joints = export_joints(tree, draw=draw, summary=summary)
        chosen = partial(chosen_programs_of_joints, result=joints)
        programs = _with_fmus(chosen, names, fmu=fmu)
        draws = () if count is None else export_joints_draws(tree, joints, count)
        write = partial(write_joints, result=joints, programs=programs, draws=draws)
        usual = USUAL_OF_JOINTS
        about = joints.about
    else:
        of_mass = {} if mass is None else {"mass": mass}
        joint = export(tree, y_max=y_max, draw=draw, summary=summary, **of_mass)
        programs = _with_fmus(partial(chosen_programs, result=joint), names, fmu=fmu)
        draws = () if count is None else export_draws(tree, joint, count)
        write = partial(write_export, result=joint, programs=programs, draws=draws)
        usual = USUAL
        about = joint.about
    taken = [program.name for program in programs]
    skipped = [] if names else [name for name in usual if name not in taken]
    notes = (*notes_on(programs), *(without_form(PROGRAMS[name].title) for name in skipped))
    return RunExport(about, programs, notes, write)


def _with_fmus(
    chosen: Callable[[Sequence[str]], tuple[Program, ...]], names: Sequence[str], *, fmu: bool
) -> tuple[Program, ...]:
    """The chosen programs, and FMUs where they are asked for."""
    programs = chosen(names)
    return tuple(dict.fromkeys((*programs, *chosen(FMUS)))) if fmu else programs
