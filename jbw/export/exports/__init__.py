"""The programs to which a joint can be exported; each has one module and one entry here."""

from collections.abc import Sequence

from jbw.errors import ConfigError, did_you_mean
from jbw.export.exports import abaqus, ansys, code_aster, fmu, matlab, modelica, nastran, opensees
from jbw.export.exports.program import Program

PROGRAMS: dict[str, Program] = {
    each.name: each
    for each in (
        opensees.OPENSEES,
        matlab.MATLAB,
        fmu.FMI2,
        fmu.FMI3,
        abaqus.ABAQUS,
        nastran.NASTRAN,
        ansys.ANSYS,
        modelica.MODELICA,
        code_aster.CODE_ASTER,
    )
}
USUAL = ("opensees", "matlab")  # default programs, used if they can represent the laws
USUAL_OF_JOINTS = ("opensees",)  # default programs for several joints


def programs_named(names: Sequence[str]) -> tuple[Program, ...]:
    """Return the simulation programs with the given names, to which a joint can be exported.

    Raises:
        ConfigError: A name is unknown; the message suggests the nearest name.
    """
    for name in names:
        if name not in PROGRAMS:
            raise ConfigError(
                f"Argument `to` must consist of names of programs, but `{name}` is not the name of "
                "a program.",
                remedy=f"{did_you_mean(name, PROGRAMS)}Programs: {', '.join(PROGRAMS)}.",
            )
    return tuple(PROGRAMS[name] for name in dict.fromkeys(names))
