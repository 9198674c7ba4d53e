"""Several modes: those that share a joint, take no part, or ended outside the band."""

from collections.abc import Sequence

from jbw.report.messages.message import percent

NOT_COMMON = "one common joint is rejected, as far as the modes' own laws follow the data"
MAY_BE_COMMON = "they may meet in one joint"
LOSS_SHARE = "share in the joints' losses"
ENERGY_AT_MOTION = "share in the mode's strain energy at that amplitude"
SOFTENING_SHARE = "share in the joints' softening"
LOOP_FORCE = "force, laws at posterior medians"


def growth_by_neighbours(growth: float) -> str:
    """Return the clause on the growth of chi-square if the neighbouring modes are linear."""
    return f"chi-square grows by {growth:.3g} if the other modes are linear"


def one_joint(evidence: str, least: float) -> str:
    """Return the message that modes share a joint, by chi-square and its limit."""
    return f"One joint across the modes: {evidence}, by chance {least:.3g}."


def no_shared_joint(evidence: str) -> str:
    """Return the message that nothing shows a shared joint."""
    return (
        f"Nothing shows that the other modes move the joint: {evidence}; drive harder, or "
        "leave them out of `modes`."
    )


def compared(
    name: str, first: float, other: float, hz: float, ratio: tuple[float, float], conclusion: str
) -> str:
    """Return the sentence that compares a law's parameter in two modes, with their ratio."""
    low, high = ratio
    return (
        f"{name} is {first:.3g} in the first mode and {other:.3g} in that at {hz:g} Hz, their "
        f"ratio {low:.3g} to {high:.3g}: {conclusion}."
    )


def still_mode(hz: float, ratio: str, low: float, high: float) -> str:
    """Return the message on a mode that source or sensor do not see."""
    return (
        f"The mode at {hz:g} Hz does not take part: {ratio} lies within {low:.2g} and {high:.2g}. "
        "The source or the sensor lies in its node; leave it out of `modes`, or measure elsewhere."
    )


def one_serves(factor: float) -> str:
    """Return the message on the ratio of residuals from which one joint is rejected."""
    return (
        "One joint fits the free decays of all modes: no residual is more than "
        f"{factor:g} times that of an independent joint."
    )


def left_by_joint(hz: float, shared: float, other: float) -> str:
    """Return the clause on a mode's residual with a shared joint and with a separate joint."""
    return (
        f"at {hz:.4g} Hz its residual is {percent(shared)} of the motion, that of an independent "
        f"joint {percent(other)}"
    )


def rejected(clauses: str) -> str:
    """Return the message that free decays reject one joint for all modes."""
    return (
        f"One joint across the modes is rejected by the free decays: {clauses}. Identify the "
        "modes one by one, each in a band of its own, or state other laws."
    )


def hardly_seen(name: str) -> str:
    """Return the message on a mode with hardly any motion at the first point."""
    return f"{name} hardly moves the first point: shares of its losses are not determined."


def all_joints(
    name: str, change: Sequence[float], damping: Sequence[float], *, is_free: bool
) -> str:
    """Return the sentence on the effect of all joints on a mode, with intervals [%]."""
    shape = "in the shape that the joints leave it" if is_free else "in its shape of full stick"
    return (
        f"{name} at its largest motion, {shape}: all joints together change its frequency by "
        f"{change[1]:.3g} % [{change[0]:.3g}, {change[2]:.3g}] and add {damping[1]:.3g} % "
        f"[{damping[0]:.3g}, {damping[2]:.3g}] of damping."
    )


def damped_by(mode: int, joint: str, share: float, low: float, high: float) -> str:
    """Return the sentence on the joint with the largest share of a mode's losses, with interval."""
    return (
        f"Mode {mode} is damped by {joint} ({100 * share:.3g} % of the joints' losses, "
        f"{100 * low:.3g} to {100 * high:.3g} %)."
    )


def numbered(mode: int, hz: float) -> str:
    """Return the message on a mode with its number and frequency, as a subject."""
    return f"Mode {mode}, at {hz:.4g} Hz,"


MOTION_FACTOR = "motion over that of the matrices"
LAWS_BY_MODEL = (
    "The matrices' shapes are uncertain: every other motion of a joint is theirs, and its laws are "
    "in units of that."
)


def moved_by_factor(mode: int, joint: str, factor: float, low: float, high: float) -> str:
    """Return the sentence on a mode's motion of a joint over that of the matrices (99 %)."""
    return (
        f"Mode {mode} moves {joint} by {factor:.3g} [{low:.3g}, {high:.3g}] times its motion by "
        "the matrices."
    )


def identified(joints: str) -> str:
    """Return the message on joints that are identified by themselves."""
    return f"Identified by themselves: {joints}."


def outside_band(hz: float, low: float, high: float) -> str:
    """Return the message on a mode that a fit put outside the band [Hz]."""
    return f"A mode ended at {hz:.4g} Hz, outside the band {low:.4g} to {high:.4g} Hz"
