"""Messages on the sequential steps of Teloli et al., compared with the joint posterior."""

from collections.abc import Sequence

CONDITIONAL = (
    "Gamma depends on the means of Steps 2 and 3: their errors shift gamma, but its interval "
    "does not include them."
)


def held_parameters(names: str, times: str, far: str) -> str:
    """Return the sentence on how the fixed parameters of Step 4 affect gamma."""
    return (
        f"Step 4 of Teloli et al. takes {names} as exactly known; its gamma is valid only if "
        f"they are. With all parameters free, the standard deviation of gamma is {times} "
        f"that of Step 4, and the two means differ by {far} of these standard deviations. Use "
        "the joint posterior of all parameters."
    )


def outside_interval(names: Sequence[str]) -> str:
    """Return the sentence on means of Steps 3 and 4 outside the joint posterior's interval."""
    return (
        f"Steps 2 to 4 of Teloli et al. give means of {', '.join(names)} outside the 99 % "
        "interval of the joint posterior of all parameters. Use the joint posterior."
    )


def wall_time(cut_s: float, joint_s: float) -> str:
    """Return the sentence on wall times [s] of Steps 3 and 4 and of the joint posterior."""
    return (
        f"Wall time: {cut_s:.3g} s for Steps 2 to 4 of Teloli et al., {joint_s:.3g} s for the "
        "joint posterior of all parameters, including compilation."
    )


def product(product: float, low: float, high: float) -> str:
    """Return the sentence on the product alpha*delta with its interval [1/(m s^2)]."""
    return (
        f"Third harmonics determine lambda_3 and with it the product alpha*delta: {product:.6g} "
        f"1/(m s^2), 99 % interval [{low:.6g}, {high:.6g}]. They do not separate alpha and "
        "delta: use the product, or the joint posterior of all parameters."
    )


def left_out(why: str) -> str:
    """Return the sentence on why Steps 3 and 4 of Teloli et al. are skipped."""
    return f"Steps 3 and 4 of Teloli et al. are left out. {why}"


def other_law(laws: str) -> str:
    """Return the message that the joint does not have the law which Steps 3 and 4 need."""
    return (
        "Steps 3 and 4 of Teloli et al. need the Bouc-Wen law and are omitted: the joint "
        f"has {laws}."
    )


def further_laws(others: str) -> str:
    """Return the sentence that Steps 3 and 4 do not contain all laws of the joint."""
    return (
        "Steps 3 and 4 of Teloli et al. contain only the Bouc-Wen law, and attribute the "
        f"effect of {others} to it. The joint posterior of all parameters contains all laws."
    )
