"""Faults of free decays: what, why and remedy."""

from jbw.report.messages.message import FaultText

LONGER = "Measure longer, or shorten `settle`."


def few_values(
    count: int, least: int, band: tuple[float, float], length: tuple[float, float], remedy: str
) -> FaultText:
    """Return the message that a decay has too few independent values in its band [Hz]."""
    (low, high), (seconds, periods) = band, length
    return FaultText(
        f"The record has {count} independent values in `band` = [{low:g}, {high:g}] Hz after "
        f"`settle`; at least {least} are needed.",
        f"After `settle` the record lasts {seconds:.4g} s, which is {periods:.3g} periods.",
        remedy,
    )


def put_wider_band(low: float, high: float) -> str:
    """Return the remedy with a band [Hz] that is wide enough for the record's length."""
    return f"Put under [[test]]: `band = [{low:g}, {high:g}]`, if only one mode lies in this band."


def late_blow(blow_s: float, settle_s: float, settle: str) -> FaultText:
    """Return the message on a record that begins before its blow, with a `settle` to state [s]."""
    return FaultText(
        f"The blow comes {blow_s:.3g} s after the start of the record"
        + (f" and its `settle` of {settle_s:g} s." if settle_s > 0 else "."),
        "A fit would take the motion before the blow for a part of the free decay.",
        f"Put under [[test]]: `settle = {settle}`.",
    )


def read_from_blow(test: str, first: str, last: str, count: int, of: int) -> str:
    """Return the message that records begin before their blows and are used after the blows."""
    when = first if first == last else f"{first} to {last}"
    return (
        f"{test}: in {count} of {of} records the blow comes {when} after the start; each "
        "record is used from one period after its blow."
    )


def still_driven(steady_s: float, settle: str) -> FaultText:
    """Return the message on a decay that is driven at first, with a `settle` to state [s]."""
    return FaultText(
        f"The motion is steady for the first {steady_s:.3g} s and decays only after that.",
        "During the steady motion the structure was driven; a fit as a free decay would find a "
        "joint without damping.",
        f"Put under [[test]]: `settle = {settle}`.",
    )


def second_blow(at_s: float, size: float, remedy: str, *, grows: bool) -> FaultText:
    """Return the message on a jump within a decay: its time [s], its relative size, the remedy."""
    return FaultText(
        f"At {at_s:.3g} s the motion jumps by {size:.2g} of its amplitude"
        + (
            ": there was a second blow."
            if grows
            else ": samples are missing, or there was a second blow."
        ),
        "A decay has one initial state; this record has two.",
        remedy,
    )


def steady_line(hz: str, share: float) -> FaultText:
    """Return the message on a spectral line [Hz] that does not decay, and its relative size."""
    return FaultText(
        f"A spectral line at {hz} Hz does not decay; its amplitude is {share:.2g} of the "
        "largest response in the band.",
        "Late in the decay a fit mistakes a line that does not decay for the mode, and finds a "
        "wrong frequency and damping.",
        f"Put under [[test]]: `lines_hz = [{hz}]`, which removes the line, or remove the source "
        "of the line and measure again.",
    )


def unpassed(low_hz: float, high_hz: float, hz: float) -> FaultText:
    """Return the message that a sweep between two frequencies [Hz] does not pass a resonance."""
    return FaultText(
        f"The sweep from {low_hz:.4g} to {high_hz:.4g} Hz does not pass the resonance near "
        f"{hz:.4g} Hz.",
        "A fit extrapolates frequency and damping from the motion away from the resonance.",
        "Measure a sweep that passes the resonance.",
    )


def line_beside_drive(hz: str) -> FaultText:
    """Return the message on a spectral line [Hz] that the drive does not cause."""
    return FaultText(
        f"A spectral line at {hz} Hz does not come from the drive.",
        "Near this frequency a fit mistakes the line for the response to the drive.",
        "Remove the source of the line and measure again.",
    )


def second_mode(
    first_hz: float, second_hz: float, band: tuple[float, float] | None, *, driven: bool
) -> FaultText:
    """Return the message on two modes in one band [Hz], with a band that has only the first."""
    structure = (
        f"tate both modes under [structure]{' or with `modes` under [identify]' if driven else ''}."
    )
    narrower = None if band is None else f"Put under [[test]]: `band = [{band[0]:g}, {band[1]:g}]`"
    return FaultText(
        f"`band` contains two modes, at {first_hz:.4g} and {second_hz:.4g} Hz.",
        "Two modes in one band beat; fitted as one mode, they give a wrong frequency and damping.",
        f"S{structure}" if narrower is None else f"{narrower}, or s{structure}",
    )


def unexplained(share: float) -> FaultText:
    """Return the message on the fraction of a response that neither mode nor fault explains."""
    return FaultText(
        f"{share:.2g} of the response is explained neither by one mode nor by a known fault.",
        "Frequency and damping that are fitted to this response do not belong to a mode.",
        "Look at the record: `band` may contain several modes, or no mode.",
    )


def windowed(tau_s: float, error: float) -> FaultText:
    """Return the message on an exponential window: its time constant and standard error [s]."""
    return FaultText(
        f"The noise decays too, with a time constant of {tau_s:.3g} s (standard error "
        f"{error:.1g}).",
        "An exponential window was applied to the record, and adds damping to the mode.",
        f"Put under [[test]]: `window_s = {tau_s:.3g}`.",
    )
