r"""The joints that given modes can separate, determined before any test.

Small motion of mode i at amplitude a determines only two numbers, its softening and its losses:

$$\omega^2 - \omega_i^2 = -c_q a^q \sum_j B_{ij}S_j, \qquad
  2\omega^2(\zeta - \zeta_i) = d_q a^q \sum_j B_{ij}O_j, \qquad B_{ij} = |H_{ji}|^{2+q}$$

with $q = 1$, $S_j = \alpha_j\delta_j$ and $O_j = \alpha_j\gamma_j$ for Bouc-Wen laws, and
$q = 1 + \chi$ for power laws. The rank of B is the number of joints that can be separated, and its
condition number multiplies the noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jbw.assembly.reduce import ReducedModel
from jbw.errors import ConfigError
from jbw.report.messages import matrices as messages

# angle between columns of B [degrees] below which two joints cannot be separated
INSEPARABLE_DEGREES = 5.0
_SHOWN_DEGREES = 0.1
# A joint does not move in a mode if its energy share or its squared relative motion is below this.
_MOVES = 1e-9

Likeness = Literal["same motion", "mirror images"]


class InseparablePair(NamedTuple):
    """A pair of joints whose columns of the separability matrix B are nearly parallel.

    Attributes:
        first: Index of the first joint.
        second: Index of the second joint.
        degrees: Angle between their columns of B.
        likeness: "same motion": their motions are equal up to one factor in every mode, so that no
            other sensor can separate them. "mirror images": the signs differ between modes; single
            modes determine only their sum, and motion of several modes at once their difference.
    """

    first: int
    second: int
    degrees: float
    likeness: Likeness


@dataclass(frozen=True, eq=False, repr=False)
class JointSeparability:
    """The separability matrix B of modes and joints, and the joints that the modes can separate.

    Attributes:
        modes: Indices of the modes, the rows of B.
        joints: Names of the joints, the columns of B.
        participation: B_ij = |H_ji|^(2+q).
        condition: Condition number of B with rows of unit length, each mode read with the same
            relative error; infinite if there are fewer modes than joints.
        angles: Angles between the columns of this matrix [degrees].
        inseparable: Pairs of joints that these modes do not separate.
    """

    modes: tuple[int, ...]
    joints: tuple[str, ...]
    participation: Float[np.ndarray, "mode joint"]
    condition: float
    angles: Float[np.ndarray, "joint joint"]
    inseparable: tuple[InseparablePair, ...]

    @property
    def over_largest(self) -> Float[np.ndarray, "mode joint"]:
        """The separability matrix B with every row divided by its largest entry, as for tables."""
        return self.participation / self.participation.max(axis=1, keepdims=True)

    def loss_shares(self, opening: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return each joint's share in the losses of every mode at small motion.

        Args:
            opening: O_j of every joint, alpha_j gamma_j for Bouc-Wen laws.
        """
        losses = self.participation * np.asarray(opening, float)
        return losses / losses.sum(axis=1, keepdims=True)

    def __repr__(self) -> str:
        lines = [f"JointSeparability: condition number {self.condition:.3g}"]
        for mode, row in zip(self.modes, self.over_largest, strict=True):
            shares = ", ".join(f"{name} {x:.2g}" for name, x in zip(self.joints, row, strict=True))
            lines.append(f"  mode {mode + 1}: {shares}")
        lines += [f"  {self.sentence(pair)}" for pair in self.inseparable]
        return "\n".join(lines)

    def sentence(self, pair: InseparablePair) -> str:
        """Return the sentence on a pair of inseparable joints."""
        first, second = self.joints[pair.first], self.joints[pair.second]
        angle = "less than 0.1" if pair.degrees < _SHOWN_DEGREES else f"{pair.degrees:.2g}"
        modes = "mode" if len(self.modes) == 1 else "modes"
        numbers = ", ".join(str(mode + 1) for mode in self.modes)
        return messages.inseparable(first, second, modes, numbers, angle, pair.likeness)


def energy_shares(model: ReducedModel) -> Float[np.ndarray, "joint kept"]:
    r"""Return each joint's share of every kept mode's strain energy, $k_jH_{ji}^2/\omega_i^2$.

    It does not depend on the scaling of modes and laws. The sum over all joints is at most 1, and
    zero for rigid-body modes.

    Examples:
        A bolt of 1e4 N/m between two oscillators of 2e4 N/m holds no energy where they move alike,
        and half of it where they move against each other:

        >>> import jbw
        >>> import numpy as np
        >>> model = jbw.matrix_model(np.eye(2), 2e4 * np.eye(2), units="SI", dofs=["1:x", "2:x"])
        >>> bolt = jbw.Joint("bolt", across=("1:x", "2:x"), stiffness=1e4)
        >>> place = {"input": "1:x", "outputs": {"tip": "2:x"}}
        >>> reduced = jbw.reduce(model, [bolt], to_hz=100.0, zeta=0.004, **place)
        >>> print(jbw.energy_shares(reduced).round(3))
        [[0.  0.5]]
    """
    omega = model.omega[: model.num_kept]
    energy = model.stiffness[:, None] * model.H[:, : model.num_kept] ** 2
    return np.where(omega > 0, energy / np.where(omega > 0, omega, 1.0) ** 2, 0.0)


def joint_separability(
    model: ReducedModel | Float[np.ndarray, "joint mode"],
    modes: Sequence[int] | None = None,
    *,
    exponent: float = 1.0,
    groups: Sequence[int] | None = None,
) -> JointSeparability:
    """Return the separability matrix B, its condition number, and inseparable pairs of joints.

    Args:
        model: A reduced model, or the motion of every joint (row) per unit of every mode.
        modes: Indices of the swept modes, from 0; by default all kept modes that move a joint.
        exponent: Power q of the amplitude by which the joint softens: 1 for Bouc-Wen, 1 + chi for
            power laws.
        groups: Group number of every joint: joints of one group share a law and one column of B,
            the sum of their columns. By default each joint is a group.

    Raises:
        ConfigError: A mode is not in the model, or moves no joint.

    Examples:
        Two modes of the virtual lapped beams separate the bolts: bolt 1 hardly moves in mode 2.

        >>> import jbw
        >>> reduced = jbw.rig.lapped_beams().reduced()
        >>> print(jbw.joint_separability(reduced, modes=[0, 1]))
        JointSeparability: condition number 2.47
          mode 1: bolt 1 0.97, bolt 2 1
          mode 2: bolt 1 0.0032, bolt 2 1
    """
    if isinstance(model, ReducedModel):
        H, names = model.H[:, : model.num_kept], tuple(joint.name for joint in model.joints)
    else:
        H = np.atleast_2d(np.asarray(model, float))
        names = tuple(f"joint {j + 1}" for j in range(H.shape[0]))
    moving = moving_modes(model)
    swept = tuple(int(i) for i in (np.flatnonzero(moving) if modes is None else modes))
    outside = [i for i in swept if not 0 <= i < H.shape[1]]
    if outside or not swept:
        raise ConfigError(
            f"`modes` must be indices from 0 to {H.shape[1] - 1}, but "
            + (f"one is {outside[0]}." if outside else "there is none."),
            remedy="Raise `to_hz` to include more modes.",
        )
    still = [i for i in swept if not moving[i]]
    if still:
        raise ConfigError(
            f"Every swept mode must move a joint, but mode {still[0] + 1} moves none.",
            why="The row of B of a mode that moves no joint is only round-off, and would seem to "
            "separate joints.",
            remedy=f"Leave index {still[0]} out of `modes`.",
        )
    motion = H[:, swept].T
    participation = np.abs(motion) ** (2 + exponent)
    if groups is not None:
        members = [
            [j for j, g in enumerate(groups) if g == group] for group in dict.fromkeys(groups)
        ]
        motion = motion[:, [joints[0] for joints in members]]
        columns = [participation[:, joints].sum(axis=1) for joints in members]
        participation = np.column_stack(columns)
        names = tuple(" = ".join(names[j] for j in joints) for joints in members)
    rows = participation / np.linalg.norm(participation, axis=1, keepdims=True)
    angles = _angles(rows)
    return JointSeparability(
        swept, names, participation, _condition(rows), angles, tuple(_alike(motion, angles))
    )  # fmt: skip


def moving_modes(
    model: ReducedModel | Float[np.ndarray, "joint mode"],
) -> Bool[np.ndarray, " mode"]:
    """Return which kept modes move a joint: energy share or motion are above round-off."""
    if isinstance(model, ReducedModel):
        return energy_shares(model).max(axis=0) > _MOVES
    H = np.atleast_2d(np.asarray(model, float))
    largest = np.abs(H).max() or 1.0
    return (np.abs(H).max(axis=0) / largest) ** 2 > _MOVES


def _condition(matrix: np.ndarray) -> float:
    singular = np.linalg.svd(matrix, compute_uv=False)
    if matrix.shape[0] < matrix.shape[1] or singular[-1] == 0:
        return float("inf")
    return float(singular[0] / singular[-1])


def _angles(matrix: np.ndarray) -> np.ndarray:
    """Return the angles between a matrix's columns [degrees]; 90 for a column of zeros."""
    norms = np.linalg.norm(matrix, axis=0)
    unit = matrix / np.where(norms > 0, norms, 1.0)
    # Small angles are computed from differences of unit vectors, because the arc cosine would lose
    # half of the digits.
    apart = np.linalg.norm(unit[:, :, None] - unit[:, None, :], axis=0)
    angles = np.degrees(2 * np.arcsin(np.minimum(apart / 2, 1.0)))
    return np.where(np.outer(norms > 0, norms > 0), angles, 90.0)


def _alike(motion: np.ndarray, angles: np.ndarray) -> list[InseparablePair]:
    pairs = []
    for second in range(angles.shape[0]):
        for first in range(second):
            if angles[first, second] < INSEPARABLE_DEGREES:
                signs = np.sign(motion[:, first] * motion[:, second])
                felt = signs[signs != 0]
                same = felt.size == 0 or np.all(felt == felt[0])
                kind: Likeness = "same motion" if same else "mirror images"
                pairs.append(InseparablePair(first, second, float(angles[first, second]), kind))
    return pairs
