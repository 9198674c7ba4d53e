"""Faults of tones, response curves, loops and levels: what, why and remedy."""

from collections.abc import Sequence

from jbw.report.messages.message import FaultText, percent

NO_PHASE = FaultText(
    "The response is in phase with the input at every frequency.",
    "The response of a damped structure lags the input; without the phase the damping cannot "
    "be determined.",
    "Name the channel that contains the phase.",
)
NEGATIVE_AMPLITUDE = FaultText(
    "The amplitude of the input must be positive at every frequency, but is not.",
    remedy="Give amplitudes, not instantaneous values; correct the polarity in the response.",
)
RISING_PHASE = "its phase rises with frequency"
GIVES_ENERGY = "the force extracts energy"
STATE_BAND = "State a `band` around the mode of the joint that contains no other mode."


def drifting(tones: str, change: float) -> FaultText:
    """Return the message on tones that are not steady, with their change of amplitude."""
    return FaultText(
        f"{tones}: the amplitude changes by {percent(change, '.1f')} from one half of the "
        "record to the other.",
        "The record still contains a transient, or the stated frequency is not exact.",
        "Raise `settle`, or correct `tones`.",
    )


def buried_harmonic(tones: str, size: float, noise: float) -> FaultText:
    """Return the message on a third harmonic that does not exceed the noise [m]."""
    return FaultText(
        f"{tones}: the third harmonic ({size:.2g} m) does not exceed the noise ({noise:.2g} m).",
        "This record alone does not determine the joint's third-order kernel.",
        "Raise the level, measure longer, or leave the tone out.",
    )


def few_lines(count: int, least: int) -> FaultText:
    """Return the message on a response curve with too few points."""
    return FaultText(
        f"The curve has {count} points, but at least {least} are needed.",
        remedy="Measure more frequencies around the resonance.",
    )


def locked_phase(phase: float) -> FaultText:
    """Return the message that a curve of constant phase [degrees] is a backbone."""
    return FaultText(
        f"The phase is {phase:.3g} degrees at every frequency: these are points of a backbone, "
        "each at a different force.",
        "A response curve passes through the resonance at one force or one amplitude.",
        'Put under [[test]]: `kind = "backbone"`.',
    )


def active(doubts: Sequence[str], keys: Sequence[str]) -> FaultText:
    """Return the message on a response that no passive structure has, with the keys to correct."""
    return FaultText(
        f"The response cannot be that of a passive structure: {' and '.join(doubts)}.",
        "A wrong sign of a channel gives a joint with negative damping or stiffness.",
        " ".join(f"Put under [[test]]: {key}." for key in keys),
    )


def in_degrees(phase: float) -> FaultText:
    """Return the message on a phase that was written in degrees."""
    return FaultText(
        f"The phase reaches {phase:.3g} rad, more than three turns.",
        "The phase is probably in degrees.",
        'Put under [[test]]: `units = { phase = "deg" }`.',
    )


def loop_turned(rises: float, work: float) -> FaultText:
    """Return the message on a loop with a wrong sign: correlation and work [J]."""
    return FaultText(
        f"The force falls where the displacement rises (correlation {rises:.2g}); the work over "
        f"the record is {work:.3g} J.",
        "Force or displacement has a reversed sign: a joint has stiffness and dissipates energy.",
        "Put under [[test]]: `scale = { displacement = -1.0 }`.",
    )


def undecaying(times: float) -> FaultText:
    """Return the message that the response of a free decay does not decrease."""
    return FaultText(
        f"The response of the last quarter is {times:.2g} times the response of the first.",
        "A free decay falls; this record may be driven, or may begin before the impact.",
        "Correct the key `kind`, or cut the record with `span` or `settle`.",
    )


def offset(ratio: float, of: str = "") -> FaultText:
    """Return the message on a response's offset, relative to its standard deviation."""
    return FaultText(
        f"The response{of} has an offset of {ratio:.2g} times its standard deviation.",
        "A fit would take the offset of the channel for a motion.",
        "Put under [[test]]: `remove_mean = true`.",
    )


def already_moving(share: float) -> FaultText:
    """Return the message on motion at a record's start, relative to its usual motion."""
    return FaultText(
        f"The motion at the start of the record is {percent(share, '.0f')} of the usual motion, "
        "but the model of this kind of test starts from rest.",
        "A fit from rest attributes the effect of the earlier motion to an error of the law.",
        "Set `settle` to the time in which free motion dies out, about 6 / (zeta omega_n), or "
        "let `span` begin where the structure is at rest.",
    )


def unlike_level(level: float, role: str, peak: float, rms: float, unit: str) -> FaultText:
    """Return the message that `level` differs from the peak and the rms of every channel."""
    sizes = f"a peak of {peak:.3g} and an rms of {rms:.3g} {unit}".rstrip()
    return FaultText(
        f"`level` is {level:g}, but {role} has {sizes}.",
        "Predictions at a level, and comparisons of tests, use `level` as an amplitude.",
        f"State the amplitude that was held constant. Put under [[test]]: `level = {peak:.3g}`. If "
        "`level` was meant as a name, use `name`.",
    )


def put_band(low: float, high: float) -> str:
    """Return the remedy with a band around the strongest spectral line."""
    return (
        f"Put under [[test]]: `band = [{low:g}, {high:g}]`. This band lies around the strongest "
        "spectral line; it must not contain another mode."
    )


def without_band(remedy: str) -> FaultText:
    """Return the message that a decay has no band, with the remedy."""
    return FaultText(
        "A free decay needs `band`: the frequencies around the one mode that moves the joint.",
        "Without a band, a free decay contains all modes at once.",
        remedy,
    )


def several_modes(share: float, low: float, high: float) -> FaultText:
    """Return the message on the fraction of power outside a band about the strongest resonance."""
    return FaultText(
        f"{percent(share, '.0f')} of the displacement's power lies outside {low:g} to "
        f"{high:g} Hz, the band around the strongest resonance.",
        "A model of one mode with a joint cannot describe several modes.",
        f"Put under [[test]]: `band = [{low:g}, {high:g}]`, or state the modes by [structure].",
    )
