"""Degrees of freedom of a model by node and direction, and weighted sums of them."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jbw.errors import ConfigError, DataError
from jbw.report.messages import matrices as messages

TRANSLATIONS = ("x", "y", "z")
ROTATIONS = ("rx", "ry", "rz")
SCALAR = "s"  # direction of a modal coordinate of a superelement, or of a scalar point
# direction in a model without a table of degrees of freedom, whose rows are counted from 1
ROW = "row"
# Directions as programs write them: numbers 1 to 6 as in Abaqus and Nastran, 0 for a scalar point.
_SPELLINGS = (
    {name: name for name in (*TRANSLATIONS, *ROTATIONS, SCALAR, ROW)}
    | {f"u{name}": name for name in TRANSLATIONS}
    | {f"t{name}": name for name in TRANSLATIONS}
    | {f"rot{name[1]}": name for name in ROTATIONS}
    | {f"ur{name[1]}": name for name in ROTATIONS}
    | {str(i): name for i, name in enumerate((SCALAR, *TRANSLATIONS, *ROTATIONS))}
)
_LISTED = 5  # number of nearest nodes that an error message lists

# One term "17:rx" or "17:rx*0.0025", a sequence of terms (their sum), or a mapping of terms to
# factors.
Place = str | Sequence[str] | Mapping[str, float]
Weights = Float[np.ndarray, " dof"]


class Dof(NamedTuple):
    """A degree of freedom: a node and a direction."""

    node: str
    direction: str

    def __str__(self) -> str:
        return f"{self.node}:{self.direction}"


def dof_of(node: object, direction: object) -> Dof:
    """Return a degree of freedom from node and direction, given as numbers or as a program's names.

    Raises:
        DataError: There is no such direction.
    """
    spelling = str(direction).strip().lower()
    spelling = spelling.removesuffix(".0")
    if spelling not in _SPELLINGS:
        raise DataError(
            f"Direction of node {node} must be one of x, y, z, rx, ry, rz, or 1 to 6, but is "
            f"{direction!r}.",
            remedy="Correct the table of degrees of freedom.",
        )
    return Dof(str(node).strip().removesuffix(".0"), _SPELLINGS[spelling])


def numbered_rows(size: int) -> tuple[Dof, ...]:
    """Return degrees of freedom for a model without a table: its rows, counted from 1."""
    return tuple(Dof(str(i), ROW) for i in range(1, size + 1))


def require_distinct(dofs: Sequence[Dof]) -> None:
    """Raise if two rows have the same node and direction."""
    rows: dict[Dof, int] = {}
    for i, dof in enumerate(dofs):
        if dof in rows:
            raise DataError(
                f"Every row of the matrices must have a different node and direction, but rows "
                f"{rows[dof] + 1} and {i + 1} are both `{dof}`.",
                remedy="Correct the table of degrees of freedom.",
            )
        rows[dof] = i


def weights_at(place: Place, dofs: Sequence[Dof], what: str) -> Weights:
    """Return the weights w of a point in the model, whose motion is w^T q.

    Args:
        place: Terms of the place, in a form of `Place`.
        dofs: Degree of freedom of every row of the model.
        what: Name of the place in messages, such as "Joint `bolt 1`".

    Raises:
        ConfigError: A term cannot be read, or the model has no such degree of freedom.
    """
    rows = {dof: i for i, dof in enumerate(dofs)}
    weights = np.zeros(len(dofs))
    for dof, factor in terms_of(place, what):
        if dof not in rows:
            raise _absent(dof, dofs, what)
        weights[rows[dof]] += factor
    return weights


def terms_of(place: Place, what: str) -> list[tuple[Dof, float]]:
    """Return the degrees of freedom of a point, and their factors.

    Args:
        place: Terms of the place, in a form of `Place`.
        what: Name of the place in messages.

    Raises:
        ConfigError: A term cannot be read.
    """
    if isinstance(place, Mapping):
        return [(_named(name, what), float(factor)) for name, factor in place.items()]
    terms = [place] if isinstance(place, str) else list(place)
    pairs = []
    for term in terms:
        name, star, factor = term.partition("*")
        try:
            weight = float(factor) if star else 1.0
        except ValueError:
            raise _unreadable(term, what) from None
        pairs.append((_named(name, what), weight))
    return pairs


def _named(name: str, what: str) -> Dof:
    node, colon, direction = name.strip().rpartition(":")
    if not colon or not node or direction.strip().lower() not in _SPELLINGS:
        raise _unreadable(name, what)
    return dof_of(node, direction)


def _unreadable(term: str, what: str) -> ConfigError:
    return ConfigError(
        f'{what} must be stated as "node:direction" or "node:direction*factor", but is `{term}`.',
        remedy='Write for example "17:x" or "17:rx*0.0025"; directions are x, y, z, rx, ry, rz.',
    )


def _absent(dof: Dof, dofs: Sequence[Dof], what: str) -> ConfigError:
    directions = [other.direction for other in dofs if other.node == dof.node]
    if directions:
        missing, remedy = messages.no_direction(dof.node, dof.direction, directions)
    else:
        missing, remedy = messages.no_node(dof.node, _nearest(dof.node, dofs))
    return ConfigError(
        f"{what} must be at degrees of freedom of the model, but {missing}.",
        why="A degree of freedom that is constrained or dependent has no row in the matrices.",
        remedy=remedy,
    )


def _nearest(node: str, dofs: Sequence[Dof]) -> list[str]:
    """Return the nodes with the nearest numbers; the first nodes if names are not numbers."""
    nodes = list(dict.fromkeys(dof.node for dof in dofs))
    numbered = [name for name in nodes if name.lstrip("-").isdigit()]
    if node.lstrip("-").isdigit() and numbered:
        nodes = sorted(numbered, key=lambda name: abs(int(name) - int(node)))
    return nodes[:_LISTED]
