"""Faults of the clocks of drive and response: what, why and remedy."""

from jbw.report.messages.message import FaultText, percent


def response_jumps(jump: float, ahead: str) -> str:
    """Return the clause that the response jumps against the drive by a lag [s]."""
    return f"the response jumps by {jump:.3g} s {ahead} the drive: one of the channels"


def lost_block(at_s: float, sign: str, keep: str) -> FaultText:
    """Return the message for a missing block of samples, and how to keep the part before it."""
    return FaultText(
        f"At {at_s:.3g} s {sign} lost a block of samples.",
        "After the loss, response and drive belong to different times.",
        f"{keep}, or export it again.",
    )


def another_clock(size: float, fast: str, change_s: float, ppm: float) -> FaultText:
    """Return the message that a lag grows along a record by two clocks."""
    return FaultText(
        f"The clock of the response runs {size:.2g} ppm {fast} compared with that of the drive: "
        f"their lag changes by {change_s:.2g} s along the record.",
        "The phase then drifts along the record, and a fit takes this for damping and stiffness.",
        f"Put under [[test]]: `clock_ppm = {ppm:.3g}`, which resamples the response, or record "
        "both channels with one clock.",
    )


def another_delay(way: str, size_s: float, stated_s: float, lag_s: float) -> FaultText:
    """Return the message that the lag of the response [s] differs from the stated delay [s]."""
    return FaultText(
        f"The response {way} the drive by {size_s:.2g} s; the campaign states a delay of "
        f"{stated_s:g} s.",
        "A fit takes a lag for damping, and a lead for negative damping; the signal of an "
        "AC-coupled sensor leads.",
        f"Put under [[test]]: `delay = {lag_s:.3g}`, or correct the phase of the channels.",
    )


def drop_off(share: float, noise: float) -> FaultText:
    """Return the message on the drop of the drive at resonance, and its share of noise there."""
    return FaultText(
        f"At the resonance the drive falls to {share:.2g} times its usual level; "
        f"{percent(noise, '.0f')} of what is left is noise.",
        "A fit takes this noise for a part of the drive, and finds too much damping.",
        "Measure the drive with a more sensitive sensor, or hold its level through the resonance.",
    )


def other_sign(source: str) -> FaultText:
    """Return the message for a repeat whose ratio of response to drive has the opposite sign."""
    return FaultText(
        "The ratio of response to drive has the opposite sign to that of most repeats.",
        "The polarity of a channel was reversed: the mean over the repeats cancels, and a fit "
        "follows none of them.",
        "Give this record a separate [[test]]. "
        f"Put under [[test]]: `scale = {{ {source} = -1.0 }}`.",
    )


def other_gain(ratio: float, source: str) -> FaultText:
    """Return the message for a repeat whose ratio of response to drive is unlike most repeats'."""
    return FaultText(
        f"The ratio of response to drive is {ratio:.4g} times that of most repeats.",
        "A channel has another unit or gain.",
        "Give this record a separate [[test]]. "
        f"Put under [[test]]: `scale = {{ {source} = {ratio:.4g} }}`.",
    )
