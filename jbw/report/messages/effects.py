"""Messages on a joint's effect on frequency and damping, and on its law from a backbone."""

from collections.abc import Sequence
from math import ceil, log10

from jbw.report.messages.message import number, percent

Estimate = tuple[float, float, float]
"""Lower end, median and upper end of an interval."""

HARDENS = "The joint hardens: its elastic stiffness grows with amplitude."
MORE_DAMPING = ": a part of the added damping comes without softening"
SLIDERS = ": the data agree with a joint of sliders"


def of_joint(y: float, frequency: Sequence[float], damping: Sequence[float]) -> str:
    """Return the sentence on how the joint changes frequency and damping at an amplitude [m]."""
    return (
        f"At {1e3 * y:.3g} mm, the largest fitted displacement, the joint "
        f"{_change('natural frequency', frequency)} and {_change('damping ratio', damping)}, "
        "compared with small motion, where the joint is fully stuck."
    )


def _change(quantity: str, quantiles: Sequence[float]) -> str:
    """Return the phrase on a change with its interval; an interval that contains zero is signed."""
    low, _, high = quantiles
    is_known = low * high > 0.0
    verb = ("lowers" if high < 0.0 else "raises") if is_known else "changes"
    return (
        f"{verb} the {quantity} by {_share(sorted(map(abs, quantiles)) if is_known else quantiles)}"
    )


def _share(quantiles: Sequence[float]) -> str:
    """Return percentages with as many decimals as the width of the interval needs."""
    percents = [100 * value for value in quantiles]
    width = max(percents[2] - percents[0], 1e-4)
    low, middle, high = (f"{x:.{max(0, ceil(-log10(width)))}f}" for x in percents)
    return f"{middle} % [{low}, {high}]"


def known_together(y: float, frequency: float, damping: float) -> str:
    """Return the sentence on the accuracy of frequency and damping if parameters trade off."""
    return (
        f"The combined effect of the unidentified parameters is identified: at {1000.0 * y:.2g} mm "
        f"the change of frequency is known to {percent(frequency, '.0f')} and the damping to "
        f"{percent(damping, '.0f')} (half widths of the 99 % intervals). Use products and "
        "responses instead of single parameters, and stay near the fitted amplitudes."
    )


def frequency_at(y: float) -> str:
    """Return the name of the natural frequency at an amplitude [m]."""
    return f"the natural frequency at {y:.2g} m"


def damping_at(y: float) -> str:
    """Return the name of the damping at an amplitude [m]."""
    return f"the damping at {y:.2g} m"


def turning(y: float, hz: float, last: float) -> str:
    """Return the clause that a frequency stops falling at an amplitude [m], and its values [Hz]."""
    first, then = ("falls", "rises") if last > hz else ("rises", "falls")
    return (
        f"the frequency {first} to {hz:.4g} Hz at {number(1e6 * y)} um, then {then} to "
        f"{last:.4g} Hz, which no power of the amplitude describes"
    )


def frequency_falls(softening: Estimate, exponent: Estimate) -> str:
    """Return the clause on how frequency changes, and with what power of the amplitude."""
    change = _trend(_negative(softening), rises="rises", falls="falls")
    return f"the frequency {change}, with the amplitude to the power {_number(exponent)}"


def damping_grows(damping: Estimate, exponent: Estimate) -> str:
    """Return the clause on how damping changes, and with what power of the amplitude."""
    change = _trend(damping, rises="grows", falls="shrinks")
    return f"the damping ratio {change}, with the amplitude to the power {_number(exponent)}"


def _trend(change: Estimate, *, rises: str, falls: str) -> str:
    """Return verb and size of a change; the verb is "changes" if the interval contains zero."""
    if change[2] < 0.0:
        return f"{falls} by {_percent(_negative(change))}"
    return f"{rises if change[0] > 0.0 else 'changes'} by {_percent(change)}"


def _negative(change: Estimate) -> Estimate:
    low, middle, high = change
    return -high, -middle, -low


def readings(count: int, range_mm: tuple[float, float], of_frequency: str, of_damping: str) -> str:
    """Return the sentence on measured frequency and damping: their number, range and changes."""
    low, high = range_mm
    return (
        f"{count} values of frequency and damping between {low:.2g} and {high:.2g} mm: "
        f"{of_frequency}; {of_damping}."
    )


def no_softening(*, grows: bool) -> str:
    """Return the message that no softening is detected, and whether the damping grows."""
    if grows:
        return "The damping grows without softening, as with Dahl's law or a damper."
    return (
        "Neither softening nor a growing damping is detected, as in a joint whose sliders "
        "are fully stuck."
    )


def elastic_softening(share: Estimate) -> str:
    """Return the sentence on the fraction of the softening that dissipates no energy."""
    return (
        f": {_percent(share)} of the softening is elastic, or the joint does not follow "
        "Masing's rule"
    )


def masing(ratio: Estimate, of_masing: float, comparison: str, opening: Estimate) -> str:
    """Return the sentence that compares damping and softening with Masing's rule."""
    return (
        f"The ratio of damping to softening is {_number(ratio)}; laws that follow Masing's rule "
        f"have {of_masing:.2g}{comparison}. For a Bouc-Wen law gamma/delta is {_number(opening)}."
    )


def smooth_alternative(spring: Estimate, damper: Estimate) -> str:
    """Return the sentence on a smooth spring [1/(m s^2)] and damper [1/m] that fit equally well."""
    return (
        f"A smooth spring c y|y| with c = {_number(spring)} 1/(m s^2) and a damper c v|v| with "
        f"c = {_number(damper)} 1/m describe frequency and damping equally well: frequency and "
        "damping alone do not prove hysteresis."
    )


def _number(band: Estimate) -> str:
    return f"{band[1]:.2g} [{band[0]:.2g}, {band[2]:.2g}]"


def _percent(band: Estimate) -> str:
    return f"{100 * band[1]:.2g} % [{100 * band[0]:.2g}, {100 * band[2]:.2g}]"


def threshold(y: Estimate, y_peak: float, rests: str) -> str:
    """Return the phrase on a law's threshold [m], and whether the largest motion reached it."""
    low, middle, high = y
    place = (
        f"at {1e3 * middle:.2g} mm [{1e3 * low:.2g}, {1e3 * high:.2g}], {middle / y_peak:.2g} "
        f"[{low / y_peak:.2g}, {high / y_peak:.2g}] times the largest motion"
    )
    if high <= y_peak:
        return f"{place}: the tests reached this motion"
    if low > y_peak:
        return (
            f"{place}: the tests did not reach this motion, so that only the prior determines "
            f"{rests}"
        )
    return (
        f"{place}: the tests may not have reached this motion, so that the prior helps to "
        f"determine {rests}"
    )
