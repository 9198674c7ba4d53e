"""Tables of a structure with several joints: [structure] with matrices, and [[joint]]."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, StrictBool, model_validator

from jbw.assembly.dofs import Place as AnyPlace
from jbw.assembly.dofs import terms_of
from jbw.assembly.units import SYSTEMS
from jbw.campaign import values
from jbw.campaign.document import FileTable, key, unlike
from jbw.errors import ConfigError, did_you_mean
from jbw.quantities import DEFAULT_LAWS, label, law_name
from jbw.report.messages import campaign_faults as messages

FILES = ("mass", "stiffness", "damping", "dofs", "nodes")


def place(value: Any) -> AnyPlace:
    """Check where a joint acts: at a degree of freedom, several with factors, or named weights."""
    if isinstance(value, Mapping) and value:
        stated: AnyPlace = {values.text(name): values.number(x) for name, x in value.items()}
    else:
        terms = values.strings(value)
        stated = terms[0] if isinstance(value, str) else terms
    try:
        terms_of(stated, "it")
    except ConfigError as error:
        raise ValueError(f"{error.what.removeprefix('it ')} {error.remedy}") from None
    return stated


def _places(value: Any) -> dict[str, AnyPlace]:
    if not isinstance(value, Mapping) or not value:
        raise ValueError(f'must be a table such as {{ tip = "40:z" }}, but is {value!r}.')
    return {values.text(name): place(where) for name, where in value.items()}


def _matrices(value: Any) -> str | dict[str, str]:
    if isinstance(value, str) and value:
        return value
    if not isinstance(value, Mapping) or not {"mass", "stiffness"} <= set(value):
        raise ValueError(
            'must be a file, or files such as { mass = "M.mtx", stiffness = "K.mtx", '
            f'dofs = "dofs.csv" }}, but is {value!r}.'
        )
    for name, file in value.items():
        if name not in FILES:
            raise ValueError(f"key `{name}` is unknown{unlike(name, FILES)}.")
        if not isinstance(file, str) or not file:
            raise ValueError(f"`{name}` must be a file, but is {file!r}.")
    return dict(value)


def _ratios(value: Any) -> float | tuple[float, ...]:
    ratios = value if isinstance(value, list | tuple) else [value]
    for ratio in ratios:
        if not 0 <= values.number(ratio) < 1:
            raise ValueError(f"must be ratios from 0 to 1, such as 0.004, but one is {ratio}.")
    return tuple(ratios) if isinstance(value, list | tuple) else value


def _pair(value: Any) -> tuple[str, str]:
    names = values.strings(value)
    if len(names) != 2 or names[0] == names[1]:
        raise ValueError(
            f'must be two different degrees of freedom such as ["17:x", "112:x"], but is {value!r}.'
        )
    place(list(names))
    return names[0], names[1]


_Written = str | list[str] | dict[str, float]
Place = Annotated[Any, BeforeValidator(place, json_schema_input_type=_Written)]
Places = Annotated[Any, BeforeValidator(_places, json_schema_input_type=dict[str, _Written])]
MatrixFiles = Annotated[
    Any, BeforeValidator(_matrices, json_schema_input_type=str | dict[Literal[FILES], str])  # pyright: ignore[reportInvalidTypeForm]
]
Ratio = Annotated[float, Field(ge=0, lt=1)]
Ratios = Annotated[Any, BeforeValidator(_ratios, json_schema_input_type=Ratio | list[Ratio])]
Pair = Annotated[tuple[str, str], BeforeValidator(_pair)]
Motions = Annotated[tuple[float, ...], BeforeValidator(values.numbers)]


class AssembledStructure(FileTable):
    """The [structure] table of a structure that is given by the matrices of a model."""

    matrices: MatrixFiles = key(
        ...,
        (
            "file with M and K (and C, dofs, nodes), or one file for each; .mat, .npz, .mtx, "
            ".pch, .op4"
        ),
        "beams.mat",
    )
    units: Annotated[str, values.OneOf(lambda: SYSTEMS)] = key(
        ..., "consistent system of units of the matrices; the files do not state it", "N-mm-t-s"
    )
    holds_joints: StrictBool = key(
        False, "the stiffness matrix already contains the fully stuck joints", True
    )
    to_hz: values.Positive = key(
        ..., "modes up to this frequency are kept [Hz]; residual modes are added", 400.0
    )
    damping: Ratios | None = key(
        None, "damping ratio of every mode, or a list; by default from the matrix C", 0.004
    )
    input: Place = key(..., "place and direction of the source, node:direction", "5:z")
    points: Places = key(
        ..., "names and places of the responses; weighted sums are in SI", {"tip": "40:z"}
    )
    shapes: Literal["model", "uncertain"] = key(
        "model",
        "model: the joints' motion in every mode is that of the model; uncertain: within 10 %",
        "uncertain",
    )


class JointTable(FileTable):
    """A [[joint]] table: one of several joints of a structure."""

    name: values.Text = key(..., "name of the joint", "bolt 1")
    across: Pair | None = key(
        None, "degrees of freedom on both sides; the joint moves by the second minus the first",
        ["17:x", "112:x"],
    )  # fmt: skip
    weights: Place | None = key(
        None, "motion of the joint as a weighted sum of degrees of freedom [-, or m/rad]",
        {"17:rx": 0.0025, "112:rx": 0.0025},
    )  # fmt: skip
    shape: Motions | None = key(
        None, "motion of the joint in every measured mode, divided by that of the response",
        [1.0, -0.8],
    )  # fmt: skip
    stiffness: values.Positive | None = key(
        None, "stiffness of the fully stuck joint in SI [N/m, or N m/rad]", 1.5e7
    )
    laws: values.Laws = key(DEFAULT_LAWS, "laws of the joint, which act in parallel", ["bouc_wen"])
    same_as: values.Text | None = key(
        None,
        "name of the joint whose law this joint shares; leave out for a separate law",
        "bolt 1",
    )

    @model_validator(mode="after")
    def _stated_once(self) -> Self:
        stated_keys = [
            name for name in ("across", "weights", "shape") if getattr(self, name) is not None
        ]
        if len(stated_keys) > 1:
            raise ValueError(
                f"{stated_keys[1]}: states the same as `{stated_keys[0]}`; leave out one of the "
                "two."
            )
        return self


def joint_errors(
    joints: Sequence[JointTable], structure: AssembledStructure | None, num_modes: int
) -> Iterator[str]:
    """Yield a sentence on each contradiction between joints, or between joints and structure."""
    names = [joint.name for joint in joints]
    for joint in joints:
        where = f"[[joint]] `{joint.name}`"
        if names.count(joint.name) > 1:
            yield messages.joint_twice(where, names.count(joint.name))
        if structure is not None:
            if joint.shape is not None or (joint.across is None and joint.weights is None):
                yield messages.no_place(where)
            if joint.stiffness is None:
                yield messages.no_stiffness(where)
        else:
            stated = [
                k for k in ("across", "weights", "stiffness") if getattr(joint, k) is not None
            ]
            if stated:
                yield messages.without_matrices(where, stated[0])
            if joint.shape is not None and len(joint.shape) != num_modes:
                yield messages.shape_of_modes(where, num_modes, len(joint.shape))
    yield from _tie_errors(joints)


def _tie_errors(joints: Sequence[JointTable]) -> Iterator[str]:
    by_name = {joint.name: joint for joint in joints}
    for joint in joints:
        where = f"[[joint]] `{joint.name}` same_as"
        if joint.same_as is None:
            continue
        if joint.same_as not in by_name:
            yield messages.unknown_leader(
                where, joint.same_as, did_you_mean(joint.same_as, by_name), ", ".join(by_name)
            )
            continue
        if leader_of(joint, by_name) is None:
            yield messages.circle(where)
            continue
        other = by_name[joint.same_as]
        if "laws" in joint.model_fields_set and joint.laws != other.laws:
            yield messages.other_laws(
                where,
                joint.name,
                ", ".join(joint.laws) or "none",
                other.name,
                ", ".join(other.laws) or "none",
            )


def leader_of(joint: JointTable, by_name: Mapping[str, JointTable]) -> JointTable | None:
    """Return the joint whose law a joint uses (perhaps its own); None if `same_as` names none."""
    passed = set()
    while joint.same_as is not None:
        if joint.name in passed or joint.same_as not in by_name:
            return None
        passed.add(joint.name)
        joint = by_name[joint.same_as]
    return joint


def groups_of(joints: Sequence[JointTable]) -> list[int]:
    """Return, for each joint, the index of the joint whose law it uses."""
    by_name = {joint.name: joint for joint in joints}
    leaders = [leader_of(joint, by_name) or joint for joint in joints]
    return [[joint.name for joint in joints].index(leader.name) for leader in leaders]


def laws_of_joint(joint: JointTable, joints: Sequence[JointTable]) -> tuple[str, ...]:
    """Return the names of a joint's laws; a tied joint has those of the joint that it names."""
    return (leader_of(joint, {other.name: other for other in joints}) or joint).laws


def laws_by_joint(joints: Sequence[JointTable]) -> tuple[str, ...]:
    """Return the names of all laws, each with the joints that use it."""
    groups = groups_of(joints)
    shared = [
        (joints[leader], [t.name for t, g in zip(joints, groups, strict=True) if g == leader])
        for leader in dict.fromkeys(groups)
    ]
    labels = [label(table.name) for table in joints]
    if len(set(labels)) < len(labels):
        twice = next(table.name for table in joints if labels.count(label(table.name)) > 1)
        raise ConfigError(
            f"[[joint]] `{twice}` name: must differ from the names of other joints in letters "
            "or digits.",
            why="In names of parameters, _ replaces all characters except letters and digits.",
            remedy=f"Rename joint `{twice}`, or the joint with nearly the same name.",
        )
    return tuple(
        law_name(law, map(label, names)) for leader, names in shared for law in leader.laws
    )
