"""Faults of the clocks of drive and response: what, why and remedy."""

from jbw.report.messages.message import FaultText, number, percent


def lost_block(at_s: float, jump_s: float, keep: str) -> FaultText:
    """Return the message for a lag that jumps [s], and how to keep the part before it."""
    ahead = "ahead of" if jump_s < 0 else "behind"
    return FaultText(
        f"At {at_s:.3g} s the response jumps by {abs(jump_s):.3g} s {ahead} the drive: one of the "
        "channels lost a block of samples.",
        "After the loss, response and drive belong to different times.",
        f"{keep}, or export it again.",
    )


def another_clock(slope: float, change_s: float | None = None) -> FaultText:
    """Return the message on a growing lag by two clocks [s/s], and its change in a record [s]."""
    fast = "fast" if slope > 0 else "slow"
    change = "" if change_s is None else f": their lag changes by {change_s:.2g} s along the record"
    return FaultText(
        f"The clock of the response runs {number(abs(1e6 * slope), '.2g')} ppm {fast} compared "
        f"with that of the drive{change}.",
        "The phase then drifts along the record, and a fit takes this for damping and stiffness.",
        f"Put under [[test]]: `clock_ppm = {1e6 * slope:.3g}`, which resamples the response, or "
        "record both channels with one clock.",
    )


def another_delay(lag_s: float, stated_s: float | None = None) -> FaultText:
    """Return the message that a response lags its drive [s], unlike a stated delay [s]."""
    way = "lags behind" if lag_s > 0 else "leads"
    stated = "" if stated_s is None else f"; the campaign states a delay of {stated_s:g} s"
    return FaultText(
        f"The response {way} the drive by {abs(lag_s):.2g} s{stated}.",
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


def other_sign(source: str, test: str = "") -> FaultText:
    """Return the message for a repeat or a test whose response over drive has the wrong sign."""
    where, others, apart = _compared(test)
    return FaultText(
        f"The ratio of response to drive{where} has the opposite sign to that of {others}.",
        "The polarity of a channel was reversed: the mean over all cancels, and a fit follows none "
        "of them.",
        f"{apart}Put under [[test]]: `scale = {{ {source} = -1.0 }}`.",
    )


def other_gain(ratio: float, source: str, unit: str, test: str = "") -> FaultText:
    """Return the message for a repeat or a test of another gain, and the unit that explains it."""
    where, others, apart = _compared(test)
    sign = ", with the opposite sign" if ratio < 0 else ""
    hint = f" (the factor of a wrong unit: {unit})" if unit else ""
    return FaultText(
        f"The ratio of response to drive{where} is {abs(ratio):.4g} times that of {others}"
        f"{sign}{hint}.",
        "A channel has another unit or gain.",
        f"{apart}Put under [[test]]: `scale = {{ {source} = {ratio:.4g} }}`.",
    )


def _compared(test: str) -> tuple[str, str, str]:
    """Return where a ratio differs, from which others, and the remedy to set a repeat apart."""
    if test:
        return f" in {test}", "the other tests", ""
    return "", "most repeats", "Give this record a separate [[test]]. "
