"""Faults of measured loops: what, why and remedy."""

from jbw.report.messages.message import FaultText, percent


def degrading(amplitude: float, number: int, change: float, keep: str, *, falls: bool) -> FaultText:
    """Return the message that the force changes over equal cycles, and the part to keep."""
    return FaultText(
        f"Cycles of the amplitude {amplitude:.3g} m differ: from cycle 2 to cycle {number} the "
        f"force {'falls' if falls else 'rises'} by {percent(change, '.0f')}.",
        "The joint changes as it is loaded, whereas most laws give equal cycles the same loop.",
        f"{keep}, which keeps the last cycles of the record, and put the other states of the joint "
        "into separate tests and assemblies; or fit the wear with the law `bwbn`.",
    )


def lopsided(ratio: float, *, positive: bool) -> FaultText:
    """Return the message that a joint's force is larger in one direction."""
    return FaultText(
        f"The force of the joint is {ratio:.2g} times as large on the "
        f"{'positive' if positive else 'negative'} side as on the other side.",
        "Every law except `square` has the same force in both directions.",
        "A fit averages both sides; add the law `square` to the campaign's laws to fit a small "
        "difference.",
    )


def off_centre(offset: float, drift: float) -> FaultText:
    """Return the message on offset and drift of a measured force, relative to half its range."""
    return FaultText(
        f"The force begins {percent(offset, '.1f')} of its half range away from zero and moves "
        f"by {percent(drift, '.1f')} of the half range along the record.",
        "The load cell has an offset or drifts; a fit mistakes the error for a force of the joint.",
        'Put under [[test]]: `load_cell = "drift"`; or "offset" if the load cell cannot drift.',
    )


def late(lag: float, delay: float) -> FaultText:
    """Return the message that the force lags the displacement [s], and the delay to state."""
    return FaultText(
        f"The force lags the displacement by {lag:.3g} s.",
        "A lag of the force makes the loop narrower; no law of a joint describes this loss of "
        "energy.",
        f"Put under [[test]]: `delay = {delay:.4g}`, or give both channels the same filter.",
    )


def high_passed(time_constant: float) -> FaultText:
    """Return the message on the time constant of a charge amplifier for the force [s]."""
    return FaultText(
        f"The force falls back to zero with a time constant of {time_constant:.3g} s, as with the "
        "high-pass filter of a charge amplifier.",
        "With a high-pass filter the force leads the displacement, which makes the loop wider.",
        "Measure the force with a strain gauge load cell, or with a longer time constant of the "
        "amplifier.",
    )


def slipped(size: float, at_s: float, keep: str) -> FaultText:
    """Return the message on a jump of the measured displacement [m] at a time [s]."""
    return FaultText(
        f"The displacement jumps by {size:.3g} m at {at_s:.5g} s while the force does not.",
        "The displacement gauge slipped; the joint did not move.",
        keep,
    )


def free_travel(gap: float, amplitude: float, laws: str) -> FaultText:
    """Return the message on a joint's free travel and amplitude [m], and laws with a gap."""
    return FaultText(
        f"The joint moves freely over {2e3 * gap:.3g} mm, at an amplitude of "
        f"{1e3 * amplitude:.3g} mm, and is stiff beyond that: it has a gap between two contacts.",
        "No law of the campaign describes a gap; a cubic spring is smooth where a contact has "
        "a kink.",
        f"Put under [joint]: `laws = [{laws}]`.",
    )
