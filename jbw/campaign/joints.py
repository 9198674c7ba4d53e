"""Checks of several joints before any fit: fully stuck modes, energy shares, separability."""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jbw.assembly.files.read import read_matrices
from jbw.assembly.joint import Joint
from jbw.assembly.reduce import ReducedModel, reduce
from jbw.assembly.separability import (
    InseparablePair,
    JointSeparability,
    energy_shares,
    joint_separability,
    moving_modes,
)
from jbw.assembly.starts import JointStarts as Starts
from jbw.assembly.starts import joint_starts
from jbw.campaign.assembled import (
    AssembledStructure,
    JointTable,
    groups_of,
    laws_by_joint,
    laws_of_joint,
)
from jbw.campaign.document import toml
from jbw.campaign.files import found_files
from jbw.campaign.schema import CampaignSpec
from jbw.errors import ConfigError
from jbw.measurement.faults.fault import Fault, doubt, refusal
from jbw.quantities import label, split
from jbw.report.messages import campaign_faults as messages

STRUCTURE = "[structure]"
MATRICES = "matrices"
# A joint whose motion is below this fraction of the largest motion contributes at most a millionth
# to B.
_UNMOVED = 1e-2


@dataclass(frozen=True)
class JointsCheck:
    """The energy shares of a campaign's joints in its modes, and whether they can be separated.

    Attributes:
        joints: Names of the joints.
        frequencies_hz: Natural frequencies with fully stuck joints [Hz].
        shares: Energy share of each joint in each mode; None for measured modes.
        swept: Indices of the modes in the bands of the tests; all modes if no test has a band.
        separability: B of the swept modes, with one column for joints that share a law; None if the
            shapes are not stated.
        notes: Changes and assumptions, one sentence each.
        model: The reduced model; None for measured modes.
    """

    joints: tuple[str, ...]
    frequencies_hz: Float[np.ndarray, " mode"]
    shares: Float[np.ndarray, "joint mode"] | None
    swept: tuple[int, ...]
    separability: JointSeparability | None
    notes: tuple[str, ...] = ()
    model: ReducedModel | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the check of joints as plain values for JSON."""
        separability = self.separability
        return {
            "joints": list(self.joints),
            "frequencies_hz": self.frequencies_hz.tolist(),
            "energy_shares": None if self.shares is None else self.shares.tolist(),
            "swept_modes": [mode + 1 for mode in self.swept],
            "separability": None
            if separability is None
            else {
                "joints": list(separability.joints),
                "participation": separability.participation.tolist(),
                "condition": separability.condition,
            },
            "notes": list(self.notes),
        }


def reduced_model(spec: CampaignSpec, folder: Path, *, allow_outside: bool = False) -> ReducedModel:
    """Return the modes and joints of a campaign whose structure is given by matrices.

    Args:
        spec: Checked campaign file.
        folder: Folder of the campaign file, which contains the files of matrices.
        allow_outside: Whether the files may be elsewhere.

    Raises:
        ConfigError: There are no matrices, or a place or joint is not in the model.
        DataError: A file of matrices is missing, damaged, or fails a check.
        ModelError: The matrices are not those of a structure at rest.
    """
    structure = spec.assembled
    if structure is None:
        raise ConfigError(
            "The campaign must have `matrices` under [structure], but has none.",
            remedy="Name the files of the mass and stiffness matrices.",
        )
    model = read_matrices(_files(structure, folder, allow_outside), units=structure.units)
    joints = [
        Joint(table.name, table.weights, across=table.across, stiffness=table.stiffness or np.nan)
        for table in spec.joints
    ]
    return reduce(
        model,
        joints,
        to_hz=structure.to_hz,
        input=structure.input,
        outputs=structure.points,
        zeta=structure.damping,
        holds_joints=structure.holds_joints,
    )


def _files(
    structure: AssembledStructure, folder: Path, allow_outside: bool
) -> Path | dict[str, Path]:
    """Return the paths of the files of matrices, which must be in the campaign's folder."""
    stated = structure.matrices
    if isinstance(stated, Mapping):
        return {
            role: found_files([file], folder, allow_outside)[0] for role, file in stated.items()
        }
    return found_files([stated], folder, allow_outside)[0]


def check_joints(
    spec: CampaignSpec, folder: Path, *, allow_outside: bool = False
) -> tuple[JointsCheck | None, list[Fault]]:
    """Check a campaign's joints against its modes; return the check with its findings.

    Raises:
        ConfigError: A place or joint is not in the model.
        DataError: A file of matrices is missing, damaged, or fails a check.
        ModelError: The matrices are not those of a structure at rest.
    """
    if not spec.joints:
        return None, []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assembled = spec.assembled is not None
        model = reduced_model(spec, folder, allow_outside=allow_outside) if assembled else None
        shares = None if model is None else energy_shares(model)
    faults = [doubt(MATRICES, str(warning.message)) for warning in caught]
    stated = () if spec.structure is None else spec.structure.modes
    frequencies_hz = np.array(stated, float) if model is None else model.frequencies_hz
    shapes = [table.shape for table in spec.joints]
    is_known = None not in shapes and len(stated) > 0
    motion = np.array(shapes, float) if model is None and is_known else model
    swept = _swept(spec, frequencies_hz)
    separability, separability_faults = _separability(motion, swept, spec.joints)
    names = tuple(table.name for table in spec.joints)
    notes = () if model is None else model.notes
    checked = JointsCheck(names, frequencies_hz, shares, swept, separability, notes, model)
    return checked, [*faults, *separability_faults]


def _separability(
    motion: ReducedModel | np.ndarray | None, swept: Sequence[int], joints: Sequence[JointTable]
) -> tuple[JointSeparability | None, list[Fault]]:
    """Return the separability matrix B of the swept modes that move a joint, and its findings."""
    if motion is None:
        return None, []
    moving = moving_modes(motion)
    rows = [mode for mode in swept if moving[mode]]
    if not rows:
        return None, [doubt("joint", *messages.NO_MODE)]
    separability = replace(
        joint_separability(motion, rows, groups=groups_of(joints)),
        joints=_names_of_groups(joints),
    )
    H = motion.H if isinstance(motion, ReducedModel) else motion
    names = [table.name for table in joints]
    return separability, [
        *_too_few(separability),
        *_inseparable(separability, joints),
        *_unseen(np.abs(H[:, rows]), names),
    ]


def _names_of_groups(joints: Sequence[JointTable]) -> tuple[str, ...]:
    """Return the joints' names, with one combined name for joints that share a law."""
    groups = groups_of(joints)
    return tuple(
        " = ".join(table.name for table, g in zip(joints, groups, strict=True) if g == group)
        for group in dict.fromkeys(groups)
    )


def _swept(spec: CampaignSpec, frequencies_hz: np.ndarray) -> tuple[int, ...]:
    """Return the elastic modes in the tests' bands; all elastic modes if no test has a band."""
    bands = [test.band for test in spec.tests if test.band]
    elastic = [i for i, hz in enumerate(frequencies_hz) if hz > 0]
    if not bands:
        return tuple(elastic)
    return tuple(
        i for i in elastic if any(low <= frequencies_hz[i] <= high for low, high in bands)
    ) or tuple(elastic)


def _inseparable(separability: JointSeparability, joints: Sequence[JointTable]) -> Iterator[Fault]:
    """Yield a finding for each pair of joints whose laws the swept modes cannot separate.

    With one kind of law, the posterior has a mode for each order of the joints, which is refused.
    With different kinds it is only a doubt, and also with a single mode, which determines the sum
    of all joints.
    """
    is_sum = len(separability.modes) == 1
    leaders = [joints[group] for group in dict.fromkeys(groups_of(joints))]
    for pair in separability.inseparable:
        first, second = leaders[pair.first], leaders[pair.second]
        same_laws = laws_of_joint(first, joints) == laws_of_joint(second, joints)
        make = refusal if same_laws and not is_sum else doubt
        yield make(
            "joint",
            separability.sentence(pair),
            _reason(pair, separability),
            messages.put_same_as(second.name, toml(first.name)),
        )


def _too_few(separability: JointSeparability) -> Iterator[Fault]:
    """Yield a warning if several modes are swept, but fewer than there are laws.

    Two laws of one mode are reported as an inseparable pair instead.
    """
    modes, joints = len(separability.modes), len(separability.joints)
    if 1 < modes < joints:
        yield doubt("joint", *messages.few_modes(joints, modes))


def _reason(pair: InseparablePair, separability: JointSeparability) -> str:
    if len(separability.modes) == 1:
        return messages.ONE_MODE
    if pair.likeness == "same motion":
        return messages.EXCHANGEABLE
    return messages.SUM_OF_LAWS


def _unseen(motion: np.ndarray, names: Sequence[str]) -> Iterator[Fault]:
    """Yield a warning for each joint that no swept mode moves, so that data do not constrain it."""
    reach = (motion / motion.max(axis=0)).max(axis=1)
    for name, largest in zip(names, reach, strict=True):
        if largest < _UNMOVED:
            yield doubt("joint", *messages.unmoved(name))


@dataclass(frozen=True)
class SeveralJoints:
    """A structure with several joints, ready for identification.

    Attributes:
        model: Modes and joints of the structure.
        laws: Names of the laws, each with the joints that share it.
        uncertain: Whether the joints' motion in the modes is uncertain, instead of the model's.
    """

    model: ReducedModel
    laws: tuple[str, ...]
    uncertain: bool = False


def several_joints(
    spec: CampaignSpec, folder: Path, *, allow_outside: bool = False
) -> SeveralJoints | None:
    """Return the joints of a campaign with matrices; None for a campaign without matrices.

    Raises:
        ConfigError: As in `reduced_model`; or the tests cannot separate two joints with one kind
            of law; or the campaign states facts that follow from the matrices.
    """
    if spec.assembled is None:
        return None
    _refuse_stated_twice(spec)
    checked, faults = check_joints(spec, folder, allow_outside=allow_outside)
    for fault in faults:
        if fault.severity == "error":
            raise ConfigError(fault.what, why=fault.why, remedy=fault.remedy)
        if fault.channel == MATRICES:
            warnings.warn(fault.what, stacklevel=2)
    model = None if checked is None else checked.model
    if model is None:
        model = reduced_model(spec, folder, allow_outside=allow_outside)
    uncertain = spec.assembled.shapes == "uncertain"
    return SeveralJoints(model, laws_by_joint(spec.joints), uncertain)


def _refuse_stated_twice(spec: CampaignSpec) -> None:
    """Raise a ConfigError for keys that contradict the matrices of a structure."""
    stated = {
        "gain": spec.gain is not None,
        "modal_mass": spec.modal_mass is not None,
    }
    for name, is_stated in stated.items():
        if is_stated:
            raise ConfigError(
                f"[campaign] {name}: not allowed if [structure] has `matrices`, because the "
                "matrices determine the masses of the modes.",
                remedy=f"Leave `{name}` out.",
            )
    if spec.instruments.is_stated:
        raise ConfigError(
            "[campaign]: errors of instruments are not allowed if [structure] has `matrices`.",
            why="The effect of errors of instruments on the parameters of several joints cannot be "
            "computed yet.",
            remedy="Leave the errors of instruments out of [campaign].",
        )


def refuse_unknown_shapes(spec: CampaignSpec) -> None:
    """Raise a ConfigError for [[joint]] tables without matrices, which cannot be identified yet.

    Raises:
        ConfigError: The campaign has [[joint]] tables without matrices.
    """
    if spec.assembled is not None or not spec.joints:
        return
    raise ConfigError(
        "A campaign with [[joint]] tables but no matrices can be checked, but its joints cannot be "
        "identified yet.",
        why="The identification takes modes of unit mass, and the joints' motion in them, from a "
        "model.",
        remedy="`jbw check` shows which joints the tests can separate. State `matrices` of a "
        "model under [structure]. Or state measured modes of unit mass as `matrices`: M is the "
        "unit matrix, K has (2 pi f)^2 on its diagonal, `dofs` has i:x for mode i, and "
        "`holds_joints = true`. Then `input`, `points` and `weights` are mode shapes, such as "
        '{ "1:x" = 0.8, "2:x" = -0.3 }.',
    )


def starts_of(
    joints: SeveralJoints,
    modes_hz: Sequence[float],
    readings: Float[np.ndarray, " mode"],
    std: Float[np.ndarray, " mode"],
) -> Starts:
    """Return starting values of every law from fits of single modes.

    Args:
        joints: Joints and their laws, one law per joint.
        modes_hz: Natural frequencies in the model of the modes that were read [Hz].
        readings: Reading of each of these modes, for unit modal mass.
        std: Standard errors of the readings.

    Raises:
        ConfigError: There are fewer modes than laws.
    """
    model = joints.model
    modes = [int(np.argmin(np.abs(model.frequencies_hz - hz))) for hz in modes_hz]
    owner = {joint: k for k, law in enumerate(joints.laws) for joint in split(law)[1]}
    rows = [j for j, joint in enumerate(model.joints) if label(joint.name) in owner]
    groups = [owner[label(model.joints[j].name)] for j in rows]
    order = np.argsort(groups, kind="stable")
    motion = model.H[[rows[k] for k in order], : model.num_kept]
    separability = joint_separability(motion, modes, groups=[groups[k] for k in order])
    return joint_starts(separability, readings, np.diag(np.square(std)))


def require_one_joint(joints: SeveralJoints | None, what: str) -> None:
    """Raise a ConfigError if a structure has several joints and `what` supports only one.

    Raises:
        ConfigError: The structure has several joints.
    """
    if joints is not None:
        raise ConfigError(
            f"{what} needs a structure with one joint, but the campaign has `matrices` and "
            f"{len(joints.model.joints)} [[joint]] tables.",
            remedy="Use `jbw identify`; `posterior.nc` then contains the draws of all joints.",
        )
