"""The messages on readings of frequency and damping of a joint without the form of a law."""

from collections.abc import Sequence

from jbw.report.messages.message import percent

FREQUENCY = "natural frequency, without a form of the law"
DAMPING = "damping ratio, without a form of the law"
LEAST_DAMPING = "least damping ratio under any law of Masing's kind"
BAND = "99 % without a form"
TABLE = "Laws by the readings alone"


def _band(hz: Sequence[float], zeta: Sequence[float]) -> str:
    ends = " to ".join(f"{100 * value:.3g}" for value in (zeta[0], zeta[2]))
    return (
        f"{hz[1]:.6g} Hz ({hz[0]:.6g} to {hz[2]:.6g}) and {100 * zeta[1]:.3g} % of critical "
        f"damping ({ends})"
    )


def bands(y: float, hz: Sequence[float], zeta: Sequence[float]) -> str:
    """Return the sentence on frequency and damping at the largest amplitude [m] (99 % bands)."""
    return f"Without a form of the law, the joint has {_band(hz, zeta)} at {1e3 * y:.3g} mm (99 %)."


def bands_beyond(times: float, hz: Sequence[float], zeta: Sequence[float]) -> str:
    """Return the message on the same beyond the readings."""
    return f"At {times:g} times that amplitude, which no reading reaches, it has {_band(hz, zeta)}."


def masing(rule: str, nats: float, limit: float) -> str:
    """Return the message on whether damping and stiffness are bound to each other."""
    evidence = f"(evidence {abs(nats):.1f} nats; limit {limit:g})"
    if rule == "broken":
        return (
            f"Damping is not bound to stiffness by Masing's rule {evidence}: no law of sliders and "
            "springs alone describes both. Try bouc_wen, or a law with a damper."
        )
    if rule == "holds":
        return f"Damping is bound to stiffness by Masing's rule {evidence}."
    return f"The readings do not decide whether Masing's rule holds {evidence}."


def least_damping(times: float, zeta: float) -> str:
    """Return the message on the least damping that any law of sliders has beyond the readings."""
    return (
        f"Every law that follows Masing's rule has at least {100 * zeta:.3g} % of critical damping "
        f"at {times:g} times the largest amplitude (99 %)."
    )


def scattered(times: float) -> str:
    """Return the sentence that no law of the amplitude fits the readings within their errors."""
    return (
        f"No law of the amplitude describes the readings within their errors: they scatter "
        f"{times:.2g} times as much. The bands include this scatter."
    )


def gap_sliders(count: int, error: float, gap: float) -> str:
    """Return the sentence on the fit of the force loops by sliders behind gaps, without a law."""
    return (
        f"Without a form of the law, {count} sliders behind gaps (mean gap {1e3 * gap:.3g} mm) fit "
        f"the force loops to {percent(error)} of the rms."
    )


def held_out_loop(test: str, error: float, with_own: float) -> str:
    """Return the sentence on how well sliders behind gaps predict a held-out loop."""
    return (
        f"They predict held-out {test} to {percent(error)} ({percent(with_own)} with a constant "
        "force of its own)."
    )
