"""Faults in sign or size of the ratio of response to drive: what, why and remedy."""

from jbw.report.messages.message import FaultText, number


def negative_gain(role: str) -> FaultText:
    """Return the message that the ratio of response to drive has a negative sign."""
    return FaultText(
        "At its resonance the response moves against the input: the gain is negative.",
        "The polarity of one channel is reversed, or the response was measured in the opposite "
        "direction.",
        f"Put under [[test]]: `scale = {{ {role} = -1.0 }}`.",
    )


def base_motion(gain: float) -> FaultText:
    """Return the message that a drive is a base's acceleration and the response absolute."""
    return FaultText(
        "At its resonance the response moves against the input, as a structure on a moving base "
        f"does: the gain is {gain:.3g} /kg.",
        "There are two possible causes. Either `force` contains the acceleration of a base and "
        "the response is absolute, or one channel has a reversed sign and the modal mass is about "
        "1 kg.",
        "If a base moves, subtract the drive from the response in the file. Then reverse the sign "
        "of the response, with `scale = { acceleration = -1.0 }` under [[test]].",
    )


def other_size(ratio: float) -> FaultText:
    """Return the message that a response differs in size from the input times the stated gain."""
    return FaultText(
        f"At its resonance the response is {number(ratio)} times the value that the campaign's "
        "gain or modal mass predicts from the input.",
        "A factor of 1000 suggests metre for millimetre, 9.81 suggests g for m/s^2, and 4.45 "
        "suggests lbf for N.",
        "Check the units of input and response, and `gain` or `modal_mass`.",
    )


def other_sign(source: str, test: str = "") -> FaultText:
    """Return the message that the response of a repeat or test has the wrong sign."""
    where, others, apart = _compared(test)
    return FaultText(
        f"The ratio of response to drive{where} has the opposite sign to that of {others}.",
        "The polarity of a channel was reversed: records of opposite sign cancel in the mean over "
        "all records, and a fit follows none of the records.",
        f"{apart}Put under [[test]]: `scale = {{ {source} = -1.0 }}`.",
    )


def other_gain(ratio: float, scale: float, source: str, unit: str, test: str = "") -> FaultText:
    """Return the message that the gain of a repeat or test differs, with the likely unit.

    `scale` is the factor to paste: that of the unit, or the measured ratio.
    """
    where, others, apart = _compared(test)
    sign = ", with the opposite sign" if ratio < 0 else ""
    hint = f" (the factor of a wrong unit: {unit})" if unit else ""
    pasted = f"{scale:.6g}" if unit else f"{scale:.4g}"
    return FaultText(
        f"The ratio of response to drive{where} is {abs(ratio):.4g} times that of {others}"
        f"{sign}{hint}.",
        "A channel has another unit or gain in this record than in the other records.",
        f"{apart}Put under [[test]]: `scale = {{ {source} = {pasted} }}`.",
    )


def _compared(test: str) -> tuple[str, str, str]:
    """Return the place of a deviating gain, the compared tests, and a remedy for a repeat."""
    if test:
        return f" in {test}", "the other tests", ""
    return "", "most repeats", "Give this record a separate [[test]]. "
