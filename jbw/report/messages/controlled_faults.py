"""Faults of controlled tests, whose points a controller holds: what, why and remedy."""

from collections.abc import Sequence

from jbw.report.messages.message import FaultText

PUT_CONJUGATE = "Put under [[test]]: `conjugate = true`."


def not_positive(name: str, point: int) -> FaultText:
    """Return the message that an amplitude is not positive, with the number of its point."""
    return FaultText(
        f"The {name} of every point must be positive, but that of point {point} is not.",
        remedy="Give amplitudes, not instantaneous values; correct the polarity in the response.",
    )


def few_points(least: int, count: int) -> FaultText:
    """Return the message that too few points have a nonzero amplitude."""
    return FaultText(
        f"A controlled test needs {least} points that move, but {count} were found.",
        remedy="Measure more levels.",
    )


def put_scale(role: str) -> str:
    """Return the remedy with the campaign line that reverses the sign of a response."""
    return f"Put under [[test]]: `scale = {{ {role} = -1.0 }}`."


def leading(degrees: float, remedy: str) -> FaultText:
    """Return the message that a displacement leads its force [degrees], with the remedy."""
    return FaultText(
        f"The displacement leads the force by {degrees:.3g} degrees: the force extracts energy.",
        "A wrong sign gives a joint with negative damping.",
        remedy,
    )


def put_locked_phase(phase: float) -> str:
    """Return the remedy with the campaign line for the phase that was held [degrees]."""
    return f"Put under [[test]]: `locked_phase = {phase:g}`."


def put_tolerance(tolerance: float) -> str:
    """Return the remedy with the campaign line for the tolerance of a held phase [degrees]."""
    return (
        "If the points were steady, accept the deviation: the fit uses the measured phase. "
        f"Put under [[test]]: `phase_tolerance = {tolerance:g}`. If the points were not steady, "
        'replace their values by NaN and state gaps = "mask".'
    )


def off_phase(points: str, error: float, held: float, remedy: str) -> FaultText:
    """Return the message on points whose phase deviates from the held phase [degrees]."""
    return FaultText(
        f"The phase of {points} deviates by up to {error:.3g} degrees from the phase that the "
        f"controller was to hold, {held:g} degrees.",
        "A backbone is measured at one phase; at another phase, frequency and force differ.",
        remedy,
    )


def frequency_jumps(before: float, after: float) -> str:
    """Return the clause on the jump of frequency between two neighbouring points [Hz]."""
    return f"the frequency jumps from {before:.5g} to {after:.5g} Hz"


def amplitude_jumps(before: float, after: float) -> str:
    """Return the clause on the jump of amplitude between two neighbouring points [m]."""
    return f"the amplitude jumps from {before:.3g} to {after:.3g} m"


def jumps(pairs: Sequence[str], jump: str) -> FaultText:
    """Return the message on pairs of points between which the motion jumps, with its size."""
    return FaultText(
        f"Between points {', '.join(pairs)} {jump}: the points lie on different branches of the "
        "response.",
        "A controlled test follows one branch; a point next to a jump may not have been steady.",
        'Replace the values of unsteady points by NaN and state gaps = "mask", or measure more '
        "points near the jump. If the points were steady, keep the points. "
        'Put under [[test]]: `jumps = "keep"`.',
    )
