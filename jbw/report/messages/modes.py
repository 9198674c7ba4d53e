"""Messages on several modes: shared joints, modes that are not visible or left the band."""

from collections.abc import Sequence

from jbw.report.messages.message import percent

NOT_COMMON = "the data reject one common joint, provided that the separate laws describe the data"
MAY_BE_COMMON = "the modes may share one joint"
LOSS_SHARE = "share of the losses of all joints"
ENERGY_AT_MOTION = "share of the mode's strain energy at the mode's largest motion"
SOFTENING_SHARE = "share of the softening by all joints"
LOOP_FORCE = "force of the laws, for the posterior medians of their parameters"


def growth_by_neighbours(growth: float) -> str:
    """Return the clause on the growth of chi-square if neighbouring modes are linear."""
    return f"chi-square grows by {growth:.3g} if the other modes are linear"


def one_joint(evidence: str, least: float) -> str:
    """Return the message that modes share a joint, with chi-square and its limit."""
    return (
        f"The modes share one joint: {evidence} (chance alone raises chi-square by at most "
        f"{least:.3g})."
    )


def no_shared_joint(evidence: str) -> str:
    """Return the message that there is no sign of a shared joint."""
    return (
        f"The data do not show that the other modes move the joint: {evidence}. Drive the "
        "structure harder, or leave these modes out of `modes`."
    )


def compared(
    name: str, first: float, other: float, hz: float, ratio: tuple[float, float], conclusion: str
) -> str:
    """Return the sentence that compares a law's parameter in two modes, with the ratio."""
    low, high = ratio
    return (
        f"{name} is {first:.3g} in the first mode and {other:.3g} in the mode at {hz:g} Hz (ratio "
        f"{low:.3g} to {high:.3g}): {conclusion}."
    )


def still_mode(hz: float, ratio: str, low: float, high: float) -> str:
    """Return the message that a mode is not visible: the source or sensor lies at a node."""
    return (
        f"The mode at {hz:g} Hz is not visible: {ratio} lies between {low:.2g} and {high:.2g}. The "
        "source or the sensor lies at a node of this mode. Leave the mode out of `modes`, or "
        "measure elsewhere."
    )


def one_serves(factor: float) -> str:
    """Return the message that one joint fits all modes, with the limit of the residual ratio."""
    return (
        "One joint fits the free decays of all modes: no residual is more than "
        f"{factor:g} times that of a separate joint."
    )


def left_by_joint(hz: float, shared: float, other: float) -> str:
    """Return the clause on a mode's residual, with a shared and with a separate joint."""
    return (
        f"at {hz:.4g} Hz the residual of the shared joint is {percent(shared)} of the motion, that "
        f"of a separate joint {percent(other)}"
    )


def rejected(clauses: str) -> str:
    """Return the message that free decays contradict a shared joint for all modes."""
    return (
        f"The free decays reject one joint for all modes: {clauses}. Identify the modes one by "
        "one, each in its own band, or state other laws."
    )


def hardly_seen(name: str) -> str:
    """Return the message that a mode hardly moves the first response point."""
    return (
        f"{name} hardly moves the first response point. The joints' shares of the losses in this "
        "mode cannot be determined. Measure the response at a point that the mode moves."
    )


def all_joints(
    name: str, change: Sequence[float], damping: Sequence[float], *, is_free: bool
) -> str:
    """Return the sentence on the effect of all joints together on a mode, with intervals [%]."""
    shape = (
        "with the mode shape at this motion"
        if is_free
        else "with the mode shape of fully stuck joints"
    )
    return (
        f"{name} at its largest motion, {shape}: all joints together change its frequency by "
        f"{change[1]:.3g} % [{change[0]:.3g}, {change[2]:.3g}] and add {damping[1]:.3g} % "
        f"[{damping[0]:.3g}, {damping[2]:.3g}] of damping."
    )


def damped_by(mode: int, joint: str, share: float, low: float, high: float) -> str:
    """Return the sentence on the joint with the largest share of a mode's losses, with interval."""
    return (
        f"Mode {mode} is damped mainly by {joint} ({100 * share:.3g} % of the joints' losses, "
        f"{100 * low:.3g} to {100 * high:.3g} %)."
    )


def numbered(mode: int, hz: float) -> str:
    """Return the name of a mode with its frequency, as the subject of a sentence."""
    return f"Mode {mode}, at {hz:.4g} Hz,"


MOTION_FACTOR = "measured motion relative to the structural model"
LAWS_BY_MODEL = (
    "In every mode without a factor for a joint, the matrices determine the motion of the joint. "
    "The laws of the joint refer to this motion."
)


def moved_by_factor(mode: int, joint: str, factor: float, low: float, high: float) -> str:
    """Return the sentence on a joint's motion in a mode, relative to the model (99 %)."""
    return (
        f"Mode {mode} moves {joint} {factor:.3g} [{low:.3g}, {high:.3g}] times as much as the "
        "matrices predict."
    )


def identified(joints: str) -> str:
    """Return the sentence on joints that are identified separately."""
    return f"Joints that are identified separately: {joints}."


def outside_band(hz: float, low: float, high: float) -> str:
    """Return the message on a mode that a fit placed outside the band [Hz]."""
    return f"The fit moved a mode to {hz:.4g} Hz, outside the band {low:.4g} to {high:.4g} Hz"
