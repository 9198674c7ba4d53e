"""The paper's steps one after another, compared with the joint posterior."""

from collections.abc import Sequence

CONDITIONAL = (
    "Gamma depends on the means of Steps 2 and 3: their errors shift gamma, but its interval does "
    "not include them."
)


def held_parameters(names: str, times: str, far: str) -> str:
    """Return the message on the effect on gamma of the parameters that Step 4 takes as known."""
    return (
        f"The paper's Step 4 takes {names} as exactly known; its gamma is valid only if they are. "
        f"With all parameters free, the standard deviation of gamma is {times} that of Step 4, and "
        f"the two means differ by {far} of these standard deviations. Use the joint posterior."
    )


def outside_interval(names: Sequence[str]) -> str:
    """Return the message on parameters that the paper's steps find outside the joint interval."""
    return (
        f"The paper's steps give means of {', '.join(names)} outside the 99 % interval of the "
        "joint posterior. Use the joint posterior."
    )


def wall_time(cut_s: float, joint_s: float) -> str:
    """Return the sentence on wall times [s] of the paper's route and of the joint posterior."""
    return (
        f"Wall time: {cut_s:.3g} s for the paper's steps, {joint_s:.3g} s for the joint posterior, "
        "compiling included."
    )


def product(product: float, low: float, high: float) -> str:
    """Return the message on the product alpha*delta with its interval [1/(m s^2)]."""
    return (
        "Third harmonics determine lambda_3 and with it the product alpha*delta: "
        f"{product:.6g} 1/(m s^2), 99 % interval [{low:.6g}, {high:.6g}]. They do not "
        "separate alpha and delta: use the product, or the joint posterior."
    )


def left_out(why: str) -> str:
    """Return the sentence on the reason why Steps 3 and 4 of the paper are skipped."""
    return f"The paper's Steps 3 and 4 are left out. {why}"


def other_law(laws: str) -> str:
    """Return the message that the joint has none of the law of Steps 3 and 4."""
    return f"The paper's Steps 3 and 4 need the Bouc-Wen law and are omitted: the joint has {laws}."


def further_laws(others: str) -> str:
    """Return the sentence that Steps 3 and 4 do not contain all laws of the joint."""
    return (
        "The paper's Steps 3 and 4 contain only the Bouc-Wen law, and attribute the effect of "
        f"{others} to it. The joint posterior contains all laws."
    )
