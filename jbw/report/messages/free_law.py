"""Messages on frequency and damping according to the free-form law of a joint."""

from collections.abc import Sequence

from jbw.report.messages.message import percent

FREQUENCY = "natural frequency, without assuming a law"
DAMPING = "damping ratio, without assuming a law"
LEAST_DAMPING = "smallest damping ratio of any law that follows Masing's rule"
BAND = "99 % band, without assuming a law"
TABLE = "Scores of laws that were fitted only to measured frequency and damping"


def _band(hz: Sequence[float], zeta: Sequence[float]) -> str:
    ends = " to ".join(f"{100 * value:.3g}" for value in (zeta[0], zeta[2]))
    return (
        f"{hz[1]:.6g} Hz ({hz[0]:.6g} to {hz[2]:.6g}) and {100 * zeta[1]:.3g} % of critical "
        f"damping ({ends})"
    )


def bands(y: float, hz: Sequence[float], zeta: Sequence[float]) -> str:
    """Return the sentence on frequency and damping at the largest amplitude [m] (99 % bands)."""
    return (
        f"Without assuming a law, natural frequency and damping at {1000.0 * y:.3g} mm are "
        f"{_band(hz, zeta)} (99 % bands)."
    )


def bands_beyond(times: float, hz: Sequence[float], zeta: Sequence[float]) -> str:
    """Return the sentence on frequency and damping beyond the measured amplitudes (99 % bands)."""
    return (
        f"Extrapolated to {times:g} times the largest measured amplitude without assuming a "
        f"law, natural frequency and damping are {_band(hz, zeta)} (99 % bands)."
    )


def masing(rule: str, nats: float, limit: float) -> str:
    """Return the sentence on whether damping and stiffness follow Masing's rule."""
    evidence = f"(evidence {abs(nats):.1f} nats; limit {limit:g})"
    if rule == "broken":
        return (
            f"Damping and stiffness do not follow Masing's rule {evidence}: no law of sliders and "
            "springs alone describes both. Try bouc_wen, or a law with a damper."
        )
    if rule == "holds":
        return f"Damping and stiffness follow Masing's rule {evidence}."
    return (
        "The measured frequency and damping do not decide whether the joint follows Masing's "
        f"rule {evidence}."
    )


def least_damping(times: float, zeta: float) -> str:
    """Return the sentence on the least damping above the measured amplitudes by Masing's rule."""
    return (
        f"Every law that follows Masing's rule has at least {100 * zeta:.3g} % of critical "
        f"damping at {times:g} times the largest measured amplitude (99 % confidence)."
    )


def scattered(times: float) -> str:
    """Return the sentence that frequency and damping vary by more than their errors explain."""
    return (
        "No function of the amplitude describes the measured frequency and damping within "
        f"their errors: the deviations are {times:.2g} times as large as the errors. The bands "
        "include this variation."
    )


def gap_sliders(count: int, error: float, gap: float) -> str:
    """Return the sentence on how well sliders behind gaps fit the force loops."""
    return (
        f"Without assuming a law, {count} sliders behind gaps (mean gap {1e3 * gap:.3g} mm) fit "
        f"the force loops with an error of {percent(error)} of the rms."
    )


def held_out_loop(test: str, error: float, with_own: float) -> str:
    """Return the sentence on how well sliders behind gaps predict a held-out loop."""
    return (
        f"The sliders behind gaps predict the held-out test `{test}` with an error of "
        f"{percent(error)} of the rms ({percent(with_own)} with a separate constant force for it)."
    )
