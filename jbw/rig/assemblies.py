r"""Assembled structures of Euler-Bernoulli beams with several joints, as matrices.

An element of length L, mass per length rho A and bending stiffness EI has, in (w_1, theta_1, w_2,
theta_2),

$$K = \frac{EI}{L^3}\begin{bmatrix}12&6L&-12&6L\\&4L^2&-6L&2L^2\\&&12&-6L\\&&&4L^2\end{bmatrix},
  \qquad M = \frac{\rho AL}{420}
  \begin{bmatrix}156&22L&54&-13L\\&4L^2&13L&-3L^2\\&&156&-22L\\&&&4L^2\end{bmatrix}$$

Reference:
    Przemieniecki, Theory of Matrix Structural Analysis (1968), chapters 5 and 11.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import Any, NamedTuple, Self

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from jbw.assembly.dofs import Dof, Place
from jbw.assembly.joint import Joint
from jbw.assembly.matrices import MatrixModel, matrix_model
from jbw.assembly.reduce import ReducedModel, reduce


class BeamSection(NamedTuple):
    """A rectangular section of a beam; the bending axis is parallel to the width."""

    width: float  # width of the section [m]
    thickness: float  # thickness of the section [m]
    modulus: float = 70e9  # Young's modulus of aluminium [N/m^2]
    density: float = 2700.0  # density of aluminium [kg/m^3]

    @property
    def bending(self) -> float:
        """The bending stiffness EI [N m^2]."""
        return self.modulus * self.width * self.thickness**3 / 12

    @property
    def axial(self) -> float:
        """The axial stiffness EA [N]."""
        return self.modulus * self.width * self.thickness

    @property
    def mass(self) -> float:
        """The mass per length [kg/m]."""
        return self.density * self.width * self.thickness


@dataclass(frozen=True)
class JointedModel:
    """Matrices with joints, an input and outputs, as the reduction needs them."""

    model: MatrixModel
    joints: tuple[Joint, ...]
    input: Place
    outputs: Mapping[str, Place]
    to_hz: float
    zeta: float = 0.004

    def reduced(self, **options: Any) -> ReducedModel:
        """Reduce the model to fully stuck and residual modes; options are those of `jbw.reduce`."""
        stated = {"to_hz": self.to_hz, "zeta": self.zeta, "input": self.input}
        return reduce(self.model, self.joints, outputs=self.outputs, **(stated | options))

    def with_laws(self, *laws: Any) -> Self:
        """Return the model with a law, or a tuple of laws, for each joint in order."""
        joints = tuple(
            Joint(joint.name, joint.weights, stiffness=joint.stiffness, laws=law)
            for joint, law in zip(self.joints, laws, strict=True)
        )
        return replace(self, joints=joints)


BAR = BeamSection(0.03, 0.005)
PLATE = BeamSection(0.2, 0.008)
BOLT = 1.5e7  # stiffness of a fully stuck lap in shear [N/m]
CLAMPING = 5e7  # normal stiffness between two beams at a bolt [N/m]


def lapped_beams(
    *,
    section: BeamSection = BAR,
    first: Sequence[float] = (0.1, 0.1, 0.05, 0.04),
    second: Sequence[float] = (0.04, 0.08, 0.08, 0.08),
    stiffness: Sequence[float] = (BOLT, BOLT),
) -> JointedModel:
    r"""Return two lapped beams with two bolts, the first beam cantilevered.

    The last element of the first beam and the first element of the second beam overlap between the
    bolts, where stiff springs tie their deflections. Joint j is the slip of the faces there, $x_j =
    \tfrac t2(\theta_A + \theta_B)$. Nodes 1, 2, ... belong to the first beam after its root, nodes
    101, 102, ... to the second beam; node 1 is driven, the last node is the tip.

    Args:
        section: Section of both beams.
        first: Lengths of the first beam's elements from its root [m].
        second: Lengths of the second beam's elements from the first bolt [m].
        stiffness: Stiffness of the two fully stuck joints [N/m].
    """
    nodes_a = [0, *range(1, len(first) + 1)]
    base = _numbers_from(len(first)) + 1
    nodes_b = list(range(base, base + 1 + len(second)))
    assembly = _Mesh()
    assembly.add_beam(nodes_a, first, section)
    assembly.add_beam(nodes_b, second, section)
    bolts = ((nodes_a[-2], nodes_b[0]), (nodes_a[-1], nodes_b[1]))
    for a, b in bolts:
        assembly.add_spring({(a, "z"): 1.0, (b, "z"): -1.0}, CLAMPING)
    lever = section.thickness / 2
    joints = tuple(
        Joint(f"bolt {j}", {f"{a}:ry": lever, f"{b}:ry": lever}, stiffness=k)
        for j, ((a, b), k) in enumerate(zip(bolts, stiffness, strict=True), 1)
    )
    along = [0.0, *accumulate(first)]
    at = {a: (x, 0.0, 0.0) for a, x in zip(nodes_a, along, strict=True)}
    lap = accumulate(second, initial=along[-2])
    at |= {b: (x, 0.0, section.thickness) for b, x in zip(nodes_b, lap, strict=True)}
    model = assembly.model(fixed=[(0, "z"), (0, "ry")], at=at)
    return JointedModel(model, joints, "1:z", {"tip": f"{nodes_b[-1]}:z"}, to_hz=1000.0)


def portal_frame(
    *,
    section: BeamSection = BAR,
    heights: tuple[float, float] = (0.4, 0.5),
    span: float = 0.6,
    stiffness: tuple[float, float] = (400.0, 400.0),
    elements: int = 4,
) -> JointedModel:
    r"""Return a portal frame whose beam has hysteretic rotational joints to both columns.

    The columns are clamped. Deflections are continuous at the corners, and joint j is the rotation
    of the beam minus that of the column there, $x_j = \theta_{beam} - \theta_{column}$ [rad]. With
    equal heights the joints are mirror images, which no single mode can separate.

    Args:
        section: Section of columns and beam.
        heights: Heights of the two columns [m].
        span: Length of the beam [m].
        stiffness: Stiffness of the two fully stuck joints [N m/rad].
        elements: Number of elements of every member.
    """
    mesh = _Mesh()
    base = _numbers_from(elements)
    first_column, second_column = (np.arange(n, n + elements + 1) for n in (base, 2 * base))
    beam = [first_column[-1], *range(3 * base + 1, 3 * base + elements), second_column[-1]]
    top = heights[0]
    steps = np.linspace(0, 1, elements + 1)
    at = {int(node): (0.0, top * s) for node, s in zip(first_column, steps, strict=True)}
    at |= {
        int(n): (span, top - (1 - s) * heights[1])
        for n, s in zip(second_column, steps, strict=True)
    }
    at |= {int(node): (span * s, top) for node, s in zip(beam, steps, strict=True)}
    for column in (first_column, second_column):
        for a, b in pairwise(column):
            mesh.add_frame(int(a), int(b), at, section)
    corners = {int(beam[0]): "beam", int(beam[-1]): "beam"}
    for a, b in pairwise(beam):
        mesh.add_frame(int(a), int(b), at, section, corners)
    joints = tuple(
        Joint(name, across=(f"{corner}:ry", f"{corner}.beam:ry"), stiffness=k)
        for name, corner, k in zip(
            ("left link", "right link"), (beam[0], beam[-1]), stiffness, strict=True
        )
    )
    fixed = [
        (int(column[0]), d) for column in (first_column, second_column) for d in ("x", "z", "ry")
    ]
    outputs = {"sway": f"{beam[0]}:x", "middle": f"{beam[elements // 2]}:z"}
    driven = {f"{first_column[elements // 2]}:x": 1.0}
    spatial = {node: (x, 0.0, z) for node, (x, z) in at.items()}
    return JointedModel(mesh.model(fixed, spatial), joints, driven, outputs, to_hz=400.0)


def plate_chain(
    *,
    section: BeamSection = PLATE,
    lengths: Sequence[float] = (0.20, 0.15, 0.25, 0.18, 0.22),
    stiffness: Sequence[float] = (6000.0, 4000.0, 5000.0, 3000.0),
    elements: int = 3,
    clamped: bool = True,
) -> JointedModel:
    r"""Return a chain of plates in cylindrical bending, with a joint between neighbouring plates.

    Deflections are continuous, and joint j is the relative rotation of two plates, $x_j =
    \theta_{j+1} - \theta_j$ [rad]. Plate j has the nodes 100 j + 0 ... `elements` (1000 j for 100
    elements or more).

    Args:
        section: Section of all plates.
        lengths: Lengths of the plates [m].
        stiffness: Stiffness of the fully stuck joints [N m/rad].
        elements: Number of elements of every plate.
        clamped: Whether the first plate is clamped at its end; a free chain has two rigid-body
            modes.
    """
    mesh = _Mesh()
    names, at, start = [], {}, 0.0
    base = _numbers_from(elements)
    for j, length in enumerate(lengths, 1):
        nodes: list[Any] = [base * j + i for i in range(elements + 1)]
        deflections = nodes.copy()
        if j > 1:
            # The previous plate has this deflection, too.
            deflections[0] = base * (j - 1) + elements
        mesh.add_beam(nodes, [length / elements] * elements, section, deflections)
        names.append((nodes[0], nodes[-1]))
        at |= {n: (start + length * i / elements, 0.0, 0.0) for i, n in enumerate(nodes)}
        start += length
    joints = tuple(
        Joint(f"joint {j}", across=(f"{names[j - 1][1]}:ry", f"{names[j][0]}:ry"), stiffness=k)
        for j, k in enumerate(stiffness, 1)
    )
    fixed = [(base, "z"), (base, "ry")] if clamped else []
    outputs = {"tip": f"{names[-1][1]}:z"}
    driven = f"{base + elements - 1}:z"
    return JointedModel(mesh.model(fixed, at), joints, driven, outputs, to_hz=400.0)


def _numbers_from(elements: int) -> int:
    """Return the first node number of a member: 100, or a larger power of ten if needed."""
    return 10 ** max(2, len(str(elements)))


class _Mesh:
    """A mesh of elements that is assembled into matrices over nodes and directions."""

    def __init__(self) -> None:
        self._rows: dict[tuple[Any, str], int] = {}
        self._mass: list[tuple[list[int], np.ndarray]] = []
        self._stiffness: list[tuple[list[int], np.ndarray]] = []

    def add_beam(
        self,
        nodes: Sequence[Any],
        lengths: Sequence[float],
        section: BeamSection,
        deflections: Sequence[Any] | None = None,
    ) -> None:
        """Add a straight beam; its deflections may be shared with other nodes."""
        shared = nodes if deflections is None else deflections
        for i, length in enumerate(lengths):
            rows = self._numbers(
                [(shared[i], "z"), (nodes[i], "ry"), (shared[i + 1], "z"), (nodes[i + 1], "ry")]
            )
            self._mass.append((rows, section.mass * bending_mass(length)))
            self._stiffness.append((rows, section.bending * bending_stiffness(length)))

    def add_frame(
        self,
        first: int,
        second: int,
        at: Mapping[int, tuple[float, float]],
        section: BeamSection,
        rotations: Mapping[int, str] | None = None,
    ) -> None:
        """Add a plane frame element; its ends may have other rotations than the nodes."""
        along = np.subtract(at[second], at[first])
        length = float(np.hypot(*along))
        cosine, sine = along / length
        turn = np.zeros((6, 6))
        turn[:2, :2] = turn[3:5, 3:5] = [[cosine, sine], [-sine, cosine]]
        turn[2, 2] = turn[5, 5] = 1.0
        bending, extension = [1, 2, 4, 5], [0, 3]
        mass, stiffness = np.zeros((6, 6)), np.zeros((6, 6))
        mass[np.ix_(bending, bending)] = section.mass * bending_mass(length)
        stiffness[np.ix_(bending, bending)] = section.bending * bending_stiffness(length)
        mass[np.ix_(extension, extension)] = section.mass * length / 6 * np.array([[2, 1], [1, 2]])
        stiffness[np.ix_(extension, extension)] = (
            section.axial / length * np.array([[1, -1], [-1, 1]])
        )
        rows = []
        for node in (first, second):
            part = (rotations or {}).get(node)
            turned = node if part is None else f"{node}.{part}"
            rows += self._numbers([(node, "x"), (node, "z"), (turned, "ry")])
        self._mass.append((rows, turn.T @ mass @ turn))
        self._stiffness.append((rows, turn.T @ stiffness @ turn))

    def add_spring(self, weights: Mapping[tuple[Any, str], float], stiffness: float) -> None:
        """Add a spring across a weighted sum of degrees of freedom."""
        rows, factors = self._numbers(list(weights)), np.array(list(weights.values()))
        self._stiffness.append((rows, stiffness * np.outer(factors, factors)))

    def model(
        self,
        fixed: Sequence[tuple[Any, str]],
        at: Mapping[Any, tuple[float, float, float]] | None = None,
    ) -> MatrixModel:
        """Return the matrices without the fixed degrees of freedom, and the node positions [m]."""
        free = [row for place, row in self._rows.items() if place not in set(fixed)]
        names = {row: Dof(str(node), direction) for (node, direction), row in self._rows.items()}
        mass, stiffness = (
            self._assembled(elements)[free][:, free] for elements in (self._mass, self._stiffness)
        )
        nodes = {str(node): position for node, position in (at or {}).items()}
        dofs = [names[row] for row in free]
        return matrix_model(mass, stiffness, units="SI", dofs=dofs, nodes=nodes)

    def _numbers(self, dofs: Sequence[tuple[Any, str]]) -> list[int]:
        return [self._rows.setdefault(dof, len(self._rows)) for dof in dofs]

    def _assembled(self, elements: Sequence[tuple[list[int], np.ndarray]]) -> sp.csc_array:
        row = np.concatenate([np.repeat(rows, len(rows)) for rows, _ in elements])
        column = np.concatenate([np.tile(rows, len(rows)) for rows, _ in elements])
        entries = np.concatenate([matrix.ravel() for _, matrix in elements])
        return sp.csc_array((entries, (row, column)), shape=(len(self._rows),) * 2)


def bending_stiffness(length: float) -> Float[np.ndarray, "4 4"]:
    """Return a beam element's stiffness per unit EI in (w_1, theta_1, w_2, theta_2), theta = w'."""
    L = length
    return (
        np.array(
            [
                [12, 6 * L, -12, 6 * L],
                [6 * L, 4 * L**2, -6 * L, 2 * L**2],
                [-12, -6 * L, 12, -6 * L],
                [6 * L, 2 * L**2, -6 * L, 4 * L**2],
            ]
        )
        / L**3
    )


def bending_mass(length: float) -> Float[np.ndarray, "4 4"]:
    """Return an element's consistent mass per unit rho A, in (w_1, theta_1, w_2, theta_2)."""
    L = length
    return (
        np.array(
            [
                [156, 22 * L, 54, -13 * L],
                [22 * L, 4 * L**2, 13 * L, -3 * L**2],
                [54, 13 * L, 156, -22 * L],
                [-13 * L, -3 * L**2, -22 * L, 4 * L**2],
            ]
        )
        * L
        / 420
    )
