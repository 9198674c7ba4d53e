"""Messages on matrices of a model, and on the modes to which they are reduced."""

from collections.abc import Mapping, Sequence

WITHOUT_GAPS = "Number the degrees of freedom without gaps, or reduce the model in its own program."
AS_SPARSE = "Save a sparse matrix instead, or reduce the model in its own program."
ROWS_OF_DOFS = "Write a line `row,node,direction` for each row of the matrices, such as `1,17,x`."


def no_direction(node: str, direction: str, directions: Sequence[str]) -> tuple[str, str]:
    """Return the message that a node lacks a direction, with the directions that it has."""
    return (
        f"node {node} has no direction `{direction}`",
        f"Node {node} has the directions {', '.join(directions)}.",
    )


def no_node(node: str, nearest: Sequence[str]) -> tuple[str, str]:
    """Return the message that a model lacks a node, with the nearest nodes."""
    return f"there is no node {node}", f"The nearest nodes are {', '.join(nearest)}."


def fixed_dofs(limit: float, count: int) -> str:
    """Return the note on how many degrees of freedom are fixed by a very large stiffness."""
    return f"Degrees of freedom fixed by a stiffness above {limit:g}: {count}."


def shown(matrices: str, dofs: int, nodes: int) -> str:
    """Return the one-line text of a matrix model: its source, degrees of freedom and nodes."""
    return f"MatrixModel({matrices}: {dofs} degrees of freedom at {nodes} nodes)"


def asymmetric(name: str, error: float, first: str, second: str) -> str:
    """Return the message that a matrix is symmetric only to the round-off in its file."""
    return (
        f"Matrix {name} is symmetric only to {error:.1e} (at {first} and {second}); its "
        "symmetric part is used."
    )


def reduced(count: int, frequencies: str, residual: int, joints: Sequence[str]) -> str:
    """Return the message on a reduced model in one line."""
    return (
        f"ReducedModel: {count} modes with fully stuck joints at {frequencies} Hz, {residual} "
        f"residual modes, joints {', '.join(joints)}"
    )


def coupled_damping(first: int, second: int, share: float) -> str:
    """Return the message on modes that the damping matrix couples."""
    return (
        f"The damping matrix couples modes {first} and {second} by {100 * share:.3g} % of their "
        "own damping; this coupling is neglected."
    )


def dashpots(by_joint: Mapping[str, float]) -> str:
    """Return the message on dashpots across joints that the damping matrix contains [N s/m]."""
    dampings = ", ".join(f"{d:.4g} N s/m across {name}" for name, d in by_joint.items())
    return (
        "The damping matrix is a sum of terms proportional to mass and stiffness, and of "
        f"dashpots at the joints: {dampings}. A `Structure` contains these dashpots; an "
        "identification includes only what they add to each mode's damping ratio."
    )


def damping_of_joints(note: str) -> str:
    """Return the advice to describe the damping of joints by their laws."""
    return f"{note} Describe damping of the joints themselves by their laws."


def massless(count: int) -> str:
    """Return the note on the number of degrees of freedom without mass."""
    return f"Degrees of freedom without mass, which were condensed statically: {count}."


def slowed(limit_hz: float, count: int, fastest: str) -> str:
    """Return the note on residual modes whose frequencies were lowered to a limit [Hz]."""
    return (
        f"Residual modes whose frequency was lowered to {limit_hz:.4g} Hz: {count}, the highest "
        f"from {fastest}; their static flexibility is kept."
    )


def inseparable(
    first: str, second: str, modes: str, numbers: str, angle: str, likeness: str
) -> str:
    """Return the message on joints that the modes cannot distinguish (parallel columns of B)."""
    return (
        f"Joints `{first}` and `{second}` are not distinguished by {modes} {numbers}: their "
        f"columns of the matrix B are {angle} degrees apart ({likeness})."
    )
