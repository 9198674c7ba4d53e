"""Messages on records without a model: nonlinearity, its onset, variation between repeats."""

from collections.abc import Sequence
from math import floor, log10

from jbw.report.messages.message import percent

Estimate = tuple[float, float, float]
"""Lower end, middle and upper end of an interval."""

NO_OSCILLATOR = (
    "The oscillator fitted in this band has no damping, or its error exceeds half of the response: "
    "`band` may contain several modes, or none."
)


NOT_STATED = "Nonlinear: not assessed, because the errors of frequency and damping are unknown."


def coherence(smallest: tuple[float, str], largest: tuple[float, str]) -> str:
    """Return the sentence on the coherence at resonance, for the smallest and largest motion."""
    (first, first_test), (last, last_test) = smallest, largest
    return (
        f"Coherence at the resonance: {first:.3f} at the smallest motion ({first_test}), "
        f"{last:.3f} at the largest ({last_test})."
    )


def secant(first: float, last: float, change: float, unit: str = "mm") -> str:
    """Return the sentence on the secant stiffness at two amplitudes [m], or [rad] in mrad."""
    return (
        f"The secant stiffness changes by {percent(change)} from {1e3 * first:.3g} to "
        f"{1e3 * last:.3g} {unit}."
    )


def worn(test: str, cycle: int, change: float) -> str:
    """Return the sentence on the cycle whose stiffness differs most from the first cycle's."""
    direction = "lower" if change < 0 else "higher"
    return (
        f"{test}: the secant stiffness of cycle {cycle} is {percent(abs(change))} {direction} "
        "than that of the first cycle of the same amplitude."
    )


def not_read(tests: Sequence[str], why: str) -> str:
    """Return the sentence on tests whose frequency and damping could not be measured."""
    return f"Frequency and damping could not be determined in {', '.join(tests)}. {why}"


def of_mode(hz: float, sentence: str) -> str:
    """Return a sentence that begins with the name of one of several modes."""
    return f"Mode near {hz:.4g} Hz: {sentence}"


def reach(y: Sequence[float]) -> str:
    """Return the range of measured amplitudes [m] as text."""
    return f"{1e3 * y[0]:.3g} to {1e3 * y[-1]:.3g} mm"


def no_change(what: str, change: float, sd: float, unit: str) -> str:
    """Return the clause that a quantity changes by no more than its error."""
    return f"no change of the {what} is detected ({_with_error(change, sd)}{unit})"


def change(what: str, size: float, sd: float, power: Estimate | None, unit: str) -> str:
    """Return the clause on the change of a quantity with amplitude, and its exponent."""
    verb = "falls" if size < 0 else "rises"
    text = f"the {what} {verb} by {_with_error(abs(size), sd)}{unit}"
    if power is None:
        return text
    exponent, least, most = power
    return f"{text}, with the amplitude to the power {exponent:.2g} [{least:.2g}, {most:.2g}]"


def turning(what: str, y: float, value: float, change: float) -> str:
    """Return the clause on the amplitude [m] at which a trend reverses, and the value there."""
    first, then = ("falls", "rises") if change > 0 else ("rises", "falls")
    return f"the {what} {first} to {value:.4g} at {1e3 * y:.3g} mm, then {then}"


def _with_error(value: float, sd: float) -> str:
    """Return a ratio in per cent with its standard deviation, which determines the digits."""
    digits = max(0, 1 - floor(log10(100 * sd))) if sd > 0 else 3
    return f"{100 * value:.{digits}f} ± {100 * sd:.{digits}f} %"


def nonlinear(answer: bool, y: Sequence[float], count: int, changes: Sequence[str]) -> str:
    """Return the sentence on whether frequency or damping change with amplitude, with sizes."""
    word = "yes" if answer else "not detected"
    return f"Nonlinear: {word}. From {reach(y)} ({_records(count)}) {'; '.join(changes)}."


def one_amplitude(y: float, count: int) -> str:
    """Return the sentence that records at one amplitude cannot show a change."""
    return (
        f"Nonlinear: not assessed, because {_records(count)} at one amplitude ({1e3 * y:.3g} mm) "
        "cannot show a change with amplitude."
    )


def _records(count: int) -> str:
    return "1 record" if count == 1 else f"{count} records"


def records_differ(scatter: Sequence[tuple[str, float]], goes_with: str) -> str:
    """Return the sentence on records that differ at equal amplitude, with the likely cause."""
    sizes = " and ".join(f"the {name} by {percent(size)}" for name, size in scatter)
    causes = {
        "order": "The difference grows from record to record: the joint relaxes, wears or warms "
        "up.",
        "runs": "The records of one run or assembly agree; the stated runs or assemblies differ.",
        "": "The day, the torque, the temperature, or the mass or place of the sensor may differ "
        "between the records.",
    }
    return (
        f"Records differ at equal amplitude, {sizes} (standard deviation between records). "
        f"{causes[goes_with]}"
    )


def another_unit(number: int, count: int, factor: float, unit: str) -> str:
    """Return the sentence on one record whose values are in another unit than stated."""
    return (
        f"Record {number} of {count} has other frequencies than the others at equal amplitude, "
        f"and the same if its values are multiplied by {factor:.6g} ({unit}): "
        "check the unit of this record, and state it in a [[test]] of its own."
    )


def likely_laws(laws: Sequence[str]) -> str:
    """Return the sentence on the laws that have the measured powers of the amplitude."""
    return (
        "Laws whose frequency and damping change with the same powers of the amplitude: "
        f"{', '.join(laws)}."
    )


def between_ends(
    y: Sequence[float], shift: float, half_widths: float, damping: tuple[float, float], kind: str,
) -> str:  # fmt: skip
    """Return the sentence on the difference between the weakest and the strongest motion."""
    yes = f"yes, the joint {kind}, if the records differ only in amplitude"
    word = yes if kind else "not detected"
    return (
        f"Nonlinear: {word}. From {reach(y)} ({len(y)} values, too few for an exponent) the "
        f"frequency {'falls' if shift < 0 else 'rises'} by {percent(abs(shift))}, "
        f"{half_widths:.2g} half-widths of the resonance, and the damping ratio changes from "
        f"{percent(damping[0], '.3g')} to {percent(damping[1], '.3g')}."
    )


def onset(y: float, *, is_linear: bool) -> str:
    """Return the sentence on the amplitude [m] above which a change is certain."""
    below = "; below it, the structure may be taken as linear" if is_linear else ""
    return (
        f"The change of the frequency is certain (99 %) above an amplitude of {1e3 * y:.3g} mm"
        f"{below}."
    )


def session_scatter(count: int, rows: Sequence[tuple[str, float, float]]) -> str:
    """Return the sentence on how frequency and damping vary within and between sessions."""
    parts = (
        f"{name} {percent(a)} within a session, {percent(b)} between sessions"
        for name, a, b in rows
    )
    return (
        f"Standard deviations between records of any amplitude, in {count} sessions or assemblies: "
        f"{'; '.join(parts)}."
    )


# sentences on one test, printed after its name
def not_assessed(reason: str) -> str:
    """Return the reason why a test's repeats, harmonics or noise are not assessed."""
    return f"not assessed: {reason}"


def repeats(count: int, scatter: float, floor: float, how: str) -> str:
    """Return the sentence on how much repeats vary relative to the response; it ends with `how`."""
    return (
        f"{count} repeats vary by {of_response(scatter)} of the response, {how}; the mean of the "
        f"repeats cannot show effects that are smaller than {of_response(floor)} of the response."
    )


AS_NOISE = "which noise explains"


def more_than_noise(noise: float, p: float, size: float) -> str:
    """Return the phrase that repeats differ by more than noise, with its p-value."""
    return (
        f"more than the noise of {of_response(noise)} (p = {p:.0e}): the amplitude, start time "
        f"or speed of the repeats differs; the amplitude differs by {of_response(size)}"
    )


def harmonic(order: str, share: float, hz: float) -> str:
    """Return the clause on the largest harmonic of one order during a sweep."""
    return f"the {order} {of_response(share)} at {hz:.4g} Hz"


def harmonics(listed: Sequence[str], residual: float) -> str:
    """Return the sentence on a sweep's harmonics and residual, relative to the response."""
    if not listed:
        return (
            f"no harmonic exceeds the residual of the fit, {of_response(residual)} of the response."
        )
    return (
        f"largest harmonics, relative to the largest response: {', '.join(listed)}; residual of "
        f"the fit {of_response(residual)}."
    )


def distortion(noise: float, nonlinear_share: float, num_realisations: int) -> str:
    """Return the sentence on noise and nonlinear distortion of the best linear approximation."""
    return (
        f"noise is {of_response(noise)} of the best linear approximation; in a single realisation "
        f"(of {num_realisations}), nonlinear distortion is {of_response(nonlinear_share)} of the "
        "best linear approximation."
    )


def noise_of_periods(noise: float, num_periods: int) -> str:
    """Return the sentence on noise, estimated from the variation between periods."""
    return f"noise of the mean over {num_periods} periods is {of_response(noise)} of the response."


def idle_lines(shares: Sequence[tuple[str, float]], noise: float) -> str:
    """Return the sentence on response and noise at even and odd lines without excitation."""
    listed = ", ".join(f"{name} lines {of_response(share)}" for name, share in shares)
    return (
        f"response at lines without excitation, relative to excited lines: {listed}; noise "
        f"{of_response(noise)}."
    )


def coherence_of_noise(hz: float, coherence_mean: float) -> str:
    """Return the sentence on the coherence at resonance under random noise."""
    return (
        f"coherence at the resonance ({hz:.4g} Hz) is {coherence_mean:.3f}; a value below 1 shows "
        "noise, too short a window, or distortion."
    )


def of_response(share: float) -> str:
    """Return a ratio to the response in per cent, with two decimals."""
    return f"{100 * share:.2f} %"
