"""The common base of all exports: description of a simulation program, parameters, templates."""

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jinja2

from jbw import __version__
from jbw.assembly.dofs import ROTATIONS, TRANSLATIONS
from jbw.errors import ConfigError
from jbw.export.joint_parts import Table
from jbw.export.one_joint import LINEAR, Export
from jbw.export.several_joints import JointCard, JointsExport
from jbw.oscillator.laws import FAMILIES, law_named, quantities_of
from jbw.oscillator.laws.stretch_path import UNIT_RULE

# programs that can represent any law, because they take tables
TABLES = "nastran, ansys, code_aster"
ENVIRONMENT = jinja2.Environment(
    loader=jinja2.PackageLoader("jbw.export.exports"),
    autoescape=jinja2.select_autoescape(("xml", "html", "ssv")),
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
    undefined=jinja2.StrictUndefined,
)

Paths = tuple[Path, ...]


def _nothing(folder: Path, result: Export) -> Paths:
    return ()


def _any_law(result: Export) -> tuple[str, ...]:
    return ()


def no_code(folder: Path, result: JointsExport) -> Paths:
    """Write no files; used for a simulation program whose files all depend on the draw."""
    return ()


class OfJoints(NamedTuple):
    """The functions that export several joints to a simulation program.

    Attributes:
        card: Function that writes into a folder what one draw of the parameters changes.
        code: Function that writes what no draw changes.
        require: Function that raises an error for joints that the program cannot take together.
    """

    card: Callable[[Path, JointsExport], Paths]
    code: Callable[[Path, JointsExport], Paths]
    require: Callable[[JointsExport], None]


class Program(NamedTuple):
    """A simulation program to which a joint can be exported.

    `jbw.export.exports` has the register of all programs.

    Attributes:
        name: Name of the program for `--to`.
        title: Displayed name of the program.
        card: Function that writes into a folder what one draw of the parameters changes.
        code: Function that writes what no draw changes.
        lacks: Function that returns the names of the joint's laws that the program cannot take.
        joints: Functions for several joints; None where the program takes a single joint only.
    """

    name: str
    title: str
    card: Callable[[Path, Export], Paths]
    code: Callable[[Path, Export], Paths] = _nothing
    lacks: Callable[[Export], tuple[str, ...]] = _any_law
    joints: OfJoints | None = None


class Parameter(NamedTuple):
    """One parameter of the exported joint: name, value, unit and meaning."""

    name: str
    value: float
    unit: str
    meaning: str


class Form(NamedTuple):
    """The template of the exact time step of a law in another language.

    Attributes:
        name: Name of its function, that of the law or of the law's family.
        file: File of the template.
        num: Number of its parameters.
        memory: Number of its state variables.
    """

    name: str
    file: str
    num: int
    memory: int


def require_law(program: Program, result: Export) -> None:
    """Raise an error if a simulation program cannot represent one of the joint's laws.

    Raises:
        ConfigError: The program lacks a law; the message names programs that take it.
    """
    if lacking := program.lacks(result):
        names = ", ".join(f"`{name}`" for name in lacking)
        raise ConfigError(
            f"{program.title} cannot represent the joint's law {names}.",
            remedy=f"Export tables instead: --to {TABLES.replace(', ', ',')}.",
        )


def parameters_of(result: Export) -> tuple[Parameter, ...]:
    """Return the exported parameters: mass, spring and dashpot, then those of the laws."""
    quantities = result.quantities or (*LINEAR, *quantities_of(result.laws))
    values = {**result.linear, **result.joint}
    return tuple(Parameter(q.name, values[q.name], q.unit, q.meaning) for q in quantities)


# -- several joints at their degrees of freedom ----------------------------------------------------
DIRECTIONS = dict(zip((*TRANSLATIONS, *ROTATIONS), range(1, 7), strict=True))


class JointNodes(NamedTuple):
    """A joint between two added nodes; the displacement of one of them is the joint's motion.

    Attributes:
        card: The joint.
        ground: Number of the fixed node.
        node: Number of the node whose displacement 1 is the joint's motion.
        terms: Node number, direction number and factor of every degree of freedom.
    """

    card: JointCard
    ground: int
    node: int
    terms: tuple[tuple[int, int, float], ...]


def nodes_of(result: JointsExport) -> tuple[JointNodes, ...]:
    """Return the joints with two added nodes each, numbered above the nodes of the model.

    Raises:
        ConfigError: A degree of freedom of a joint has no node number or no direction number.
    """
    ground = 10 ** max(3, len(str(result.assembly.highest_node)))
    return tuple(
        JointNodes(card, ground, ground + i, tuple(_numbered(card)))
        for i, card in enumerate(result.cards, start=1)
    )


def _numbered(card: JointCard) -> Iterator[tuple[int, int, float]]:
    for dof, weight in card.terms:
        if not dof.node.isdecimal() or dof.direction not in DIRECTIONS:
            raise ConfigError(
                f"Joint `{card.name}` must be at numbered nodes in the directions "
                f"{', '.join(DIRECTIONS)} for this program, but is at `{dof}`.",
                remedy="Export FMUs instead, which contain no nodes: --to fmi3.",
            )
        yield int(dof.node), DIRECTIONS[dof.direction], weight


def require_nodes(result: JointsExport) -> None:
    """Raise an error if a degree of freedom of a joint has no node number for a program to use.

    Raises:
        ConfigError: A degree of freedom has no number.
    """
    nodes_of(result)


def require_joints(program: Program, result: JointsExport, takers: Iterable[str]) -> None:
    """Raise an error if a simulation program cannot represent the joints of a run.

    Args:
        program: The program.
        result: The joints.
        takers: Names of the programs that take several joints.

    Raises:
        ConfigError: The program takes a single joint only, lacks a law, or cannot place a joint.
    """
    if program.joints is None:
        raise ConfigError(
            f"{program.title} supports only one joint, but the run has {len(result.cards)}.",
            why=f"A file for {program.title} states neither joints nor their degrees of freedom.",
            remedy=f"Choose another program: --to {','.join(takers)}.",
        )
    for card in result.cards:
        require_law(program, card.joint)
    program.joints.require(result)


def takes_joints(program: Program, result: JointsExport) -> bool:
    """Return whether a simulation program can represent the joints of a run."""
    try:
        require_joints(program, result, ())
    except ConfigError:
        return False
    return True


# -- templates of laws -----------------------------------------------------------------------------
def family_of(law: str) -> str:
    """Return the name of a law without its number, such as `jenkins` for `jenkins_3`."""
    root = re.sub(r"_\d+$", "", law)
    return root if root in FAMILIES else law


def forms_of(folder: str, result: Export) -> tuple[Form, ...]:
    """Return the templates of a joint's laws in the language of a simulation program."""
    return tuple(_form(folder, law, result) for law in result.laws)


def without_form(folder: str) -> Callable[[Export], tuple[str, ...]]:
    """Return a function that lists a joint's laws without a template in a program's language."""
    forms = {Path(name).stem for name in ENVIRONMENT.list_templates() if name.startswith(folder)}
    return lambda result: tuple(law for law in result.laws if family_of(law) not in forms)


def _form(folder: str, law: str, result: Export) -> Form:
    name, kind = family_of(law), law_named(law)
    file = next(f for f in ENVIRONMENT.list_templates() if re.match(rf"{folder}/{name}\.\w+$", f))
    memory = len(jax.tree.leaves(kind.build(result.joint).at_rest()))
    return Form(name, file, len(kind.table), memory)


# -- texts -----------------------------------------------------------------------------------------
def write_text(path: Path, template: str, result: Export, **more: Any) -> Path:
    """Write a file about one joint from a template of a simulation program."""
    return write_template(
        path,
        template,
        about=result.about,
        laws=result.laws,
        parameters=parameters_of(result),
        skeleton=result.skeleton,
        **more,
    )


def write_template(path: Path, template: str, **facts: Any) -> Path:
    """Write a file for a simulation program from a template, with jbw's version."""
    text = ENVIRONMENT.get_template(template).render(version=__version__, **facts)
    path.write_text(text, encoding="utf-8")
    return path


def commented(lines: Iterable[str], mark: str) -> str:
    """Format lines as comments; remove line continuations and trigraphs."""
    return "\n".join(mark + re.sub(r"\\+$", "", line.replace("??", "?")) for line in lines)


def mirrored(table: Table, column: str, *, odd: bool) -> Iterable[float]:
    """Yield a skeleton curve from -Y to Y as displacement, value, displacement, value, ..."""
    y, x = table["displacement_m"], table[column]
    middle = 0.0 if odd else x[0]
    xs = (*(-x[::-1] if odd else x[::-1]), middle, *x)
    for pair in zip((*-y[::-1], 0.0, *y), xs, strict=True):
        yield from map(float, pair)


def number(value: Any) -> str:
    """Return a number with all digits, in a form that C, MATLAB, Modelica and Fortran read."""
    return repr(float(value))


def wrapped(values: Iterable[str], count: int) -> list[list[str]]:
    """Split words into rows of `count` words each."""
    words = list(values)
    return [words[i : i + count] for i in range(0, len(words), count)]


def in_modelica(unit: str) -> str:
    """Return a unit in Modelica's spelling, such as `1/(m2.s2)`."""
    return unit.replace("^", "").replace(" ", ".")


ENVIRONMENT.filters |= {
    "commented": commented,
    "number": number,
    "wrapped": wrapped,
    "modelica": in_modelica,
}
# nodes and weights of the quadrature on [0, 1], needed by the law whose force is an integral
ENVIRONMENT.globals["legendre"] = tuple(zip(*(x.tolist() for x in UNIT_RULE), strict=True))
