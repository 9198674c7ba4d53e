"""What every program's export shares: its record, the joint's parameters and the templates."""

import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jinja2

from jbw import __version__
from jbw.errors import ConfigError
from jbw.oscillator.laws import FAMILIES, law_named, quantities_of
from jbw.oscillator.laws.stretch_path import UNIT_RULE
from jbw.study.export import LINEAR, Export
from jbw.study.exported_joint import Table

TABLES = "nastran, ansys, code_aster"  # what takes any law
ENVIRONMENT = jinja2.Environment(
    loader=jinja2.PackageLoader("jbw.study.exports"),
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


class Program(NamedTuple):
    """Another program that takes the joint; `jbw.study.exports` holds the register.

    Attributes:
        name: What `--to` calls it.
        title: What people call it.
        card: Writes what one draw of the parameters changes, into a folder.
        code: Writes what no draw changes.
        lacks: Names of the joint's laws that it cannot take.
    """

    name: str
    title: str
    card: Callable[[Path, Export], Paths]
    code: Callable[[Path, Export], Paths] = _nothing
    lacks: Callable[[Export], tuple[str, ...]] = _any_law


class Parameter(NamedTuple):
    """One parameter of the exported joint: name, value, unit and meaning."""

    name: str
    value: float
    unit: str
    meaning: str


class Form(NamedTuple):
    """A law's exact move in another language.

    Attributes:
        name: Of its function, the law's or its family's.
        file: Its template.
        num: How many parameters it takes.
        memory: How many numbers it remembers.
    """

    name: str
    file: str
    num: int
    memory: int


def require_law(program: Program, result: Export) -> None:
    """Refuse a joint of which a program cannot take a law.

    Raises:
        ConfigError: It cannot; with the programs that can.
    """
    if lacking := program.lacks(result):
        names = ", ".join(f"`{name}`" for name in lacking)
        raise ConfigError(
            f"{program.title} has no form of the joint's law {names}, so it cannot take this run.",
            remedy=f"Take tables instead: --to {TABLES.replace(', ', ',')}.",
        )


def parameters_of(result: Export) -> tuple[Parameter, ...]:
    """Mass, spring and dashpot beside the joint, then the parameters of its laws."""
    laws = quantities_of(result.laws)
    values = {**result.linear, **result.joint}
    return tuple(Parameter(q.name, values[q.name], q.unit, q.meaning) for q in (*LINEAR, *laws))


# -- laws in closed code ---------------------------------------------------------------------------
def family_of(law: str) -> str:
    """Name of a law, or of its family: `jenkins` of `jenkins_3`."""
    root = re.sub(r"_\d+$", "", law)
    return root if root in FAMILIES else law


def forms_of(folder: str, result: Export) -> tuple[Form, ...]:
    """The laws' forms in the language of a folder of templates."""
    return tuple(_form(folder, law, result) for law in result.laws)


def without_form(folder: str) -> Callable[[Export], tuple[str, ...]]:
    """What tells the laws that have no form in the language of a folder of templates."""
    forms = {Path(name).stem for name in ENVIRONMENT.list_templates() if name.startswith(folder)}
    return lambda result: tuple(law for law in result.laws if family_of(law) not in forms)


def _form(folder: str, law: str, result: Export) -> Form:
    name, kind = family_of(law), law_named(law)
    file = next(f for f in ENVIRONMENT.list_templates() if re.match(rf"{folder}/{name}\.\w+$", f))
    memory = len(jax.tree.leaves(kind.of(result.joint).at_rest()))
    return Form(name, file, len(kind.table), memory)


# -- texts -----------------------------------------------------------------------------------------
def write_text(path: Path, template: str, result: Export, **more: Any) -> Path:
    """Write a template that is told the joint, whole."""
    text = ENVIRONMENT.get_template(template).render(
        about=result.about,
        laws=result.laws,
        parameters=parameters_of(result),
        skeleton=result.skeleton,
        version=__version__,
        **more,
    )
    path.write_text(text, encoding="utf-8")
    return path


def commented(lines: Iterable[str], mark: str) -> str:
    """Lines of comment; nothing at a line's end goes on in the next, nor is there a trigraph."""
    return "\n".join(mark + re.sub(r"\\+$", "", line.replace("??", "?")) for line in lines)


def mirrored(table: Table, column: str, *, odd: bool) -> Iterable[float]:
    """Displacements and values of a skeleton, one after the other, from -Y to Y."""
    y, x = table["displacement_m"], table[column]
    middle = 0.0 if odd else x[0]
    xs = (*(-x[::-1] if odd else x[::-1]), middle, *x)
    for pair in zip((*-y[::-1], 0.0, *y), xs, strict=True):
        yield from map(float, pair)


def number(value: Any) -> str:
    """All digits of a number, as C, MATLAB, Modelica and Fortran read it."""
    return repr(float(value))


def wrapped(values: Iterable[str], count: int) -> list[list[str]]:
    """Words in rows of so many."""
    words = list(values)
    return [words[i : i + count] for i in range(0, len(words), count)]


def in_modelica(unit: str) -> str:
    """A unit of jbw's dialect as Modelica writes it, `1/(m2.s2)`."""
    return unit.replace("^", "").replace(" ", ".")


ENVIRONMENT.filters |= {
    "commented": commented,
    "number": number,
    "wrapped": wrapped,
    "modelica": in_modelica,
}
# Nodes and weights on [0, 1], of the law whose map is an integral.
ENVIRONMENT.globals["legendre"] = tuple(zip(*(x.tolist() for x in UNIT_RULE), strict=True))
