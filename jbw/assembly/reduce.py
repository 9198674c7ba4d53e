r"""Reduction of a model with joints to modes with fully stuck joints, and residual modes.

$$M\ddot q + C\dot q + K_sq + \sum_j w_jr_j = Bu, \quad x_j = w_j^Tq, \quad r_j = F_j(x_j) - k_jx_j,
  \quad K_s = K + \sum_jk_jw_jw_j^T$$

becomes, in mass-normalised modes of $(M, K_s)$,

$$\ddot q_i + 2\zeta_i\omega_i\dot q_i + \omega_i^2q_i + \sum_jH_{ji}r_j = b_iu, \quad
  x_j = \sum_iH_{ji}q_i, \quad y = cq$$
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from jbw.assembly.dofs import Dof, Place, weights_at
from jbw.assembly.factorisation import Sparse
from jbw.assembly.joint import Joint
from jbw.assembly.matrices import MatrixModel, ModalDamping, modal_damping
from jbw.assembly.stuck_modes import (
    StuckModes,
    residual_modes,
    residual_shapes,
    rotated_clusters,
    stuck_modes,
)
from jbw.errors import ConfigError, ModelError
from jbw.report.messages import matrices as messages

# frequency to which faster residual modes are slowed, as a multiple of to_hz
_SLOWEST_RESIDUAL = 5.0
# A mode does not move a joint if the joint's motion is below this fraction of the motion of its
# degrees of freedom.
_STILL = 1e-9
# Two joints act at the same point if 1 - |cos| between their weights is below this.
_PARALLEL = 1e-10
_ROUND_OFF = 1e-6  # largest excess of an energy share over 1 that counts as round-off
_PLAUSIBLE_HZ = (1e-2, 1e5)
_SHOWN = 5


@dataclass(frozen=True, eq=False, repr=False)
class ReducedModel:
    """The modes of the fully stuck structure, and residual modes, with unit modal mass in SI.

    Kept modes come first; residual modes follow and obey the same equations.

    Attributes:
        omega: Natural frequencies with fully stuck joints [rad/s].
        zeta: Damping ratios [-].
        H: Motion of each joint per unit of each mode [1/sqrt(kg), or rad/(m sqrt(kg))].
        b: Effect of the input on each mode [1/sqrt(kg)].
        c: Motion of each output per unit of each mode [1/sqrt(kg)].
        joints: Joints, one per row of H.
        outputs: Names of the outputs, one per row of c.
        num_kept: Number of kept modes.
        residual_flexibility: R_JJ = W^T K_s^-1 W - H Lambda^-1 H^T of the kept modes [m/N].
        flexibility: W^T K_s^-1 W, without rigid-body modes [m/N].
        notes: Sentences on changes and assumptions.
        matrices: Model that was reduced.
        shapes: Shapes of the kept modes [1/sqrt(kg)].
        holds_joints: Whether its K contains the stiffness of the fully stuck joints.
        dashpots: Coefficient of a dashpot across each joint [N s/m]. Its diagonal part is in
            `zeta`; `structure` also contains its coupling of modes.

    Examples:
        The virtual lapped beams have two joints; five modes lie below 1000 Hz:

        >>> import jbw
        >>> import numpy as np
        >>> reduced = jbw.rig.lapped_beams().reduced()
        >>> print([joint.name for joint in reduced.joints], reduced.num_kept)
        ['bolt 1', 'bolt 2'] 5
        >>> print((reduced.omega[:2] / (2 * np.pi)).round(1), "Hz")
        [32.2 90.5] Hz
    """

    omega: Float[np.ndarray, " mode"]
    zeta: Float[np.ndarray, " mode"]
    H: Float[np.ndarray, "joint mode"]
    b: Float[np.ndarray, " mode"]
    c: Float[np.ndarray, "output mode"]
    joints: tuple[Joint, ...]
    outputs: tuple[str, ...]
    num_kept: int
    residual_flexibility: Float[np.ndarray, "joint joint"]
    flexibility: Float[np.ndarray, "joint joint"]
    notes: tuple[str, ...]
    matrices: MatrixModel
    shapes: Float[np.ndarray, "dof kept"]
    holds_joints: bool
    dashpots: Float[np.ndarray, " joint"]

    @property
    def stiffness(self) -> Float[np.ndarray, " joint"]:
        """The stiffness of every fully stuck joint [N/m]."""
        return np.array([joint.stiffness for joint in self.joints])

    @property
    def frequencies_hz(self) -> Float[np.ndarray, " kept"]:
        """The natural frequencies [Hz] of the kept modes, with fully stuck joints."""
        return self.omega[: self.num_kept] / (2 * np.pi)

    def frequencies_at(self, stiffness: Sequence[float] | np.ndarray) -> np.ndarray:
        r"""Return the natural frequencies for given stiffnesses of the joints [Hz].

        These are the eigenvalues of $\Lambda + H^T\,\mathrm{diag}(\kappa_j - k_j)\,H$.

        Args:
            stiffness: Stiffness kappa_j of every joint [N/m]; zero for a free joint.
        """
        change = np.asarray(stiffness, float) - self.stiffness
        matrix = np.diag(self.omega**2) + (self.H.T * change) @ self.H
        return np.sqrt(np.maximum(np.linalg.eigvalsh(matrix), 0.0)) / (2 * np.pi)

    def structure(self) -> Any:
        """Return the `jbw.Structure` of these modes, with the joints' laws."""
        return structure_of_joints(self)

    def __repr__(self) -> str:
        shown = ", ".join(f"{hz:.4g}" for hz in self.frequencies_hz[:_SHOWN])
        more = ", ..." if self.num_kept > _SHOWN else ""
        residual = self.omega.size - self.num_kept
        joints = [joint.name for joint in self.joints]
        lines = [
            messages.reduced(self.num_kept, f"{shown}{more}", residual, joints),
            *(f"  {note}" for note in self.notes),
        ]
        return "\n".join(lines)


def reduce(
    model: MatrixModel,
    joints: Sequence[Joint],
    *,
    to_hz: float,
    input: Place,
    outputs: Mapping[str, Place],
    zeta: float | Sequence[float] | None = None,
    holds_joints: bool = False,
    slow_residual_modes: bool = True,
) -> ReducedModel:
    """Compute the modes with fully stuck joints, and residual modes of joints and input.

    Args:
        model: Matrices of the structure.
        joints: Joints of the structure.
        to_hz: Highest frequency of the kept modes [Hz].
        input: Place where the source pushes: "node:direction", or a weighted sum.
        outputs: Place of every response, by name.
        zeta: Damping ratio of all modes, or one per kept mode, with the last for residual modes;
            None takes the ratios from the model's damping matrix.
        holds_joints: Whether K already contains the joints' stiffness, so that none is added.
        slow_residual_modes: Whether residual modes beyond 5 `to_hz` are slowed to that frequency,
            which keeps their static part and saves time steps.

    Returns:
        The modes.

    Raises:
        ConfigError: A place is not in the model, a joint does not move, two joints are at the same
            place, or damping is not stated.
        ModelError: K is indefinite, or does not contain the joints although it should.

    Examples:
        Oscillators of 1 kg and 2e4 N/m, joined by 1e4 N/m, have modes at sqrt(2e4) and sqrt(4e4):

        >>> import jbw
        >>> import numpy as np
        >>> model = jbw.matrix_model(np.eye(2), 2e4 * np.eye(2), units="SI", dofs=["1:x", "2:x"])
        >>> bolt = jbw.Joint("bolt", across=("1:x", "2:x"), stiffness=1e4)
        >>> place = {"input": "1:x", "outputs": {"tip": "2:x"}}
        >>> reduced = jbw.reduce(model, [bolt], to_hz=100.0, zeta=0.004, **place)
        >>> print(reduced.omega.round(2))
        [141.42 200.  ]
    """
    _require_names(joints, to_hz)
    across = np.column_stack(
        [weights_at(joint.weights, model.dofs, f"Joint `{joint.name}`") for joint in joints]
    )
    push = weights_at(input, model.dofs, "The input")
    seen = np.array([weights_at(p, model.dofs, f"Output `{n}`") for n, p in outputs.items()])
    seen = seen.reshape(len(outputs), model.num_dofs)
    _require_moving(joints, across)
    stiffness = model.stiffness if holds_joints else _stuck(model.stiffness, joints, across)
    loads = np.column_stack((across, push))
    modes = rotated_clusters(stuck_modes(stiffness, model.mass, to_hz), loads)
    _require_plausible(modes, model.units)
    _require_participation(joints, across, modes, model.dofs)
    if holds_joints:
        _require_shares(joints, across, modes)
    attached, own, mass, whole = _residual_basis(stiffness, model.mass, modes, loads)
    limit = 2 * np.pi * to_hz * (_SLOWEST_RESIDUAL if slow_residual_modes else np.inf)
    residual, combinations, slowed = residual_modes(own, mass, np.diag(whole), limit)
    shapes = np.hstack((modes.shapes, attached @ combinations))
    omega = np.concatenate((modes.omega, residual))
    H = across.T @ shapes
    damping = _damping(zeta, model, stiffness, joints, across, modes)
    num = len(joints)
    return ReducedModel(
        omega=omega,
        zeta=_of_every_mode(damping, omega, H),
        H=H,
        b=shapes.T @ push,
        c=seen @ shapes,
        joints=tuple(joints),
        outputs=tuple(outputs),
        num_kept=modes.omega.size,
        residual_flexibility=own[:num, :num],
        flexibility=whole[:num, :num],
        notes=(*model.notes, *_notes(model, modes, slowed, limit), *damping.notes),
        matrices=model,
        shapes=modes.shapes,
        holds_joints=holds_joints,
        dashpots=damping.dashpots,
    )


def structure_of_joints(reduced: ReducedModel) -> Any:
    """Return the `jbw.Structure` of a reduced model, in its form for one joint or several.

    Dashpots act across the joints, and modes have the rest of their damping ratios.
    """
    from jbw.oscillator.laws.dashpot import Dashpot  # This import loads JAX.
    from jbw.oscillator.modes.structure import Structure

    single = len(reduced.joints) == 1
    H = reduced.H[0] if single else reduced.H
    laws: tuple = tuple(
        (*joint.laws, Dashpot(float(d))) if d else joint.laws
        for joint, d in zip(reduced.joints, reduced.dashpots, strict=True)
    )
    elastic = np.where(reduced.omega > 0, reduced.omega, np.inf)
    zeta = reduced.zeta - reduced.dashpots @ reduced.H**2 / (2 * elastic)
    c = reduced.c[0] if len(reduced.outputs) == 1 else reduced.c
    return Structure(reduced.omega, zeta, H, H.T, reduced.b, c, laws[0] if single else laws)


def _residual_basis(
    stiffness: Sparse, mass: Sparse, modes: StuckModes, loads: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return attachment modes Psi, Psi^T K_s Psi, Psi^T M Psi, and the whole flexibility."""
    shapes = residual_shapes(stiffness, mass, modes, loads)
    flexibility = shapes.T @ (stiffness @ shapes)
    flexibility = (flexibility + flexibility.T) / 2
    elastic = modes.omega > 0
    participation = loads.T @ modes.shapes[:, elastic] / modes.omega[elastic]
    reduced_mass = shapes.T @ (mass @ shapes)
    whole = flexibility + participation @ participation.T
    return shapes, flexibility, (reduced_mass + reduced_mass.T) / 2, whole


def _stuck(stiffness: Sparse, joints: Sequence[Joint], across: np.ndarray) -> Sparse:
    """Return the stiffness matrix with stuck joints, K_s = K + sum k_j w_j w_j^T."""
    weights = sp.csc_array(across)
    springs = sp.diags_array(np.array([joint.stiffness for joint in joints]))
    return sp.csc_array(stiffness + weights @ springs @ weights.T)


def _damping(
    zeta: float | Sequence[float] | None,
    model: MatrixModel,
    stiffness: Sparse,
    joints: Sequence[Joint],
    across: np.ndarray,
    modes: StuckModes,
) -> ModalDamping:
    """Return the kept modes' damping ratios, as stated or from the model's damping matrix."""
    if zeta is None:
        if model.damping is None:
            raise ConfigError(
                "The model has no damping matrix, so damping ratios must be stated.",
                remedy="Give one ratio such as zeta=0.004 (in a campaign file `damping = "
                "0.004` under [structure]), or one ratio per kept mode.",
            )
        names = [joint.name for joint in joints]
        return modal_damping(model.damping, model.mass, stiffness, across, modes, names)
    num = modes.omega.size
    ratios = np.asarray(zeta, float)
    if ratios.ndim == 0:
        ratios = np.full(num, float(ratios))
    if ratios.shape != (num,):
        raise ConfigError(
            f"Damping ratios must be one number, or {num}, one for each mode up to `to_hz`, "
            f"but are {ratios.size}.",
            remedy="Give one damping ratio, or one damping ratio for every kept mode.",
        )
    if not (np.isfinite(ratios) & (ratios >= 0)).all():
        raise ModelError(
            f"Damping ratios must be finite and not negative, but are {ratios.tolist()}.",
            remedy="Give ratios such as 0.004, not percentages.",
        )
    ratios = np.where(modes.omega > 0, ratios, 0.0)
    return ModalDamping(ratios, None, 0.0, np.zeros(len(joints)), ())


def _of_every_mode(
    damping: ModalDamping, omega: np.ndarray, H: np.ndarray
) -> Float[np.ndarray, " mode"]:
    """Return the damping ratios of all modes; a residual mode gets that of the last kept mode.

    If the damping matrix consists of mass, stiffness and dashpot terms, it gives those of residual
    modes, too.
    """
    residual = omega[damping.zeta.size :]
    if damping.mass_factor is None:
        return np.concatenate((damping.zeta, np.full(residual.size, damping.zeta[-1])))
    proportional = damping.mass_factor + damping.stiffness_factor * residual**2
    felt = damping.dashpots @ H[:, damping.zeta.size :] ** 2
    return np.concatenate((damping.zeta, (proportional + felt) / (2 * residual)))


def _require_names(joints: Sequence[Joint], to_hz: float) -> None:
    if not joints:
        raise ConfigError(
            "At least one joint must be stated, but there is none.",
            remedy="Give a `jbw.Joint` for every contact at which the structure may slip.",
        )
    names = [joint.name for joint in joints]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ConfigError(
            f"Every joint must have a unique name, but `{twice}` occurs twice.",
            remedy=f"Rename one of the joints `{twice}`.",
        )
    if not 0 < to_hz < float("inf"):
        raise ConfigError(
            f"`to_hz` must be positive and finite, but is {to_hz!r}.",
            remedy="Give a frequency slightly above the highest frequency of the tests [Hz].",
        )


def _require_moving(joints: Sequence[Joint], across: np.ndarray) -> None:
    """Raise if the weights of a joint cancel each other, or if two joints act at the same point."""
    norms = np.linalg.norm(across, axis=0)
    for joint, norm in zip(joints, norms, strict=True):
        if norm == 0:
            raise _immovable(joint, "its weights cancel")
    cosines = np.abs((across / norms).T @ (across / norms))
    for j in range(len(joints)):
        for i in range(j):
            if 1 - cosines[i, j] < _PARALLEL:
                raise ConfigError(
                    f"Joints `{joints[i].name}` and `{joints[j].name}` must act at different "
                    "points, but their weights are the same up to a factor.",
                    why="No test can separate two joints with the same relative motion.",
                    remedy=f"Combine `{joints[i].name}` and `{joints[j].name}` into one joint "
                    "with two laws.",
                )


def _immovable(joint: Joint, reason: str) -> ConfigError:
    return ConfigError(
        f"Joint `{joint.name}` must move, but {reason}.",
        why="If a joint does not move, its law never acts, and no test can determine the law.",
        remedy="Give the degrees of freedom on both sides of the joint, not those that a "
        "constraint ties together, or raise `to_hz`.",
    )


def _require_participation(
    joints: Sequence[Joint], across: np.ndarray, modes: StuckModes, dofs: Sequence[Dof]
) -> None:
    """Raise if no kept mode moves a joint; warn if a rigid-body mode moves one."""
    motion = across.T @ modes.shapes
    rotates = np.array([dof.direction in ("rx", "ry", "rz") for dof in dofs])
    reach = np.zeros(len(dofs))
    for kind in (rotates, ~rotates):
        reach[kind] = np.abs(modes.shapes[kind]).max(initial=0.0)
    still = np.abs(motion) <= _STILL * (np.abs(across).T @ reach)[:, None]
    rigid = modes.omega == 0
    for joint, row in zip(joints, still, strict=True):
        if row.all():
            raise _immovable(joint, "no mode up to `to_hz` moves this joint")
        if not row[rigid].all():
            warnings.warn(
                f"A rigid-body mode moves joint `{joint.name}`. Check that the joint leads to "
                "ground; if rotations state its slip, add the axial degrees of freedom.",
                stacklevel=4,
            )


def _require_shares(joints: Sequence[Joint], across: np.ndarray, modes: StuckModes) -> None:
    r"""Raise if the joints' shares of a mode's strain energy exceed the whole."""
    springs = np.array([joint.stiffness for joint in joints])
    energy = springs @ (across.T @ modes.shapes) ** 2
    floor = modes.omega[modes.omega > 0].min(initial=np.inf) ** 2
    excess = energy - modes.omega**2 * (1 + _ROUND_OFF) > _ROUND_OFF * floor
    if excess.any():
        i = int(np.argmax(excess))
        ratio = f"{energy[i] / modes.omega[i] ** 2:.3g}" if modes.omega[i] > 0 else "infinity"
        raise ModelError(
            "Joints can store at most all of a mode's strain energy, but their shares of mode "
            f"{i + 1} add up to {ratio}.",
            why="`holds_joints = true` states that K contains the stiffness of the joints, but K "
            "does not.",
            remedy="Set `holds_joints = false`, or correct the joints' stiffness.",
        )


def _require_plausible(modes: StuckModes, units: str) -> None:
    """Warn if the first elastic frequency is implausible for a bolted structure."""
    elastic = modes.omega[modes.omega > 0]
    if elastic.size == 0:
        return
    first = float(elastic[0]) / (2 * np.pi)
    if not _PLAUSIBLE_HZ[0] <= first <= _PLAUSIBLE_HZ[1]:
        warnings.warn(
            f"The first natural frequency is {first:.4g} Hz with matrices in {units}, outside "
            f"{_PLAUSIBLE_HZ[0]:g} to {_PLAUSIBLE_HZ[1]:g} Hz. Check `units`: matrices in N, mm "
            "and kg are in no consistent system, and give frequencies that are off by a factor of "
            "31.6.",
            stacklevel=4,
        )


def _notes(model: MatrixModel, modes: StuckModes, slowed: np.ndarray, limit: float) -> list[str]:
    """Return notes on steps of the reduction that were not requested."""
    notes = []
    if massless := model.massless.size:
        notes.append(messages.massless(massless))
    if rigid := int(np.sum(modes.omega == 0)):
        notes.append(f"Rigid-body modes: {rigid}.")
    if slowed.size:
        highest = slowed[-1]
        fastest = "infinity" if not np.isfinite(highest) else f"{highest / (2 * np.pi):.4g} Hz"
        notes.append(messages.slowed(limit / (2 * np.pi), slowed.size, fastest))
    return notes
