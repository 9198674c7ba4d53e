"""The messages on possible causes of a fit's residual: common mistakes, and their remedies."""

from collections.abc import Sequence

from jbw.report.messages.message import percent

Words = tuple[str, str]
"""What is wrong, and what to do about it."""


def causes(explained: Sequence[tuple[float, str]]) -> str:
    """Return the message on what would explain the residual, each with its share."""
    shares = [f"{text} ({percent(share, '.0f')})" for share, text in explained]
    return f"Causes that would explain a part of the residual, each alone: {'; '.join(shares)}."


def swapped(test: str) -> Words:
    """Return the message that input and response of a test are exchanged."""
    return f"{test} with input and response swapped", f"Swap the channels of {test}."


def delay(seconds: float, line: str) -> Words:
    """Return the message on a response that is late [s], or early, and the line of its delay."""
    side = "behind" if seconds > 0 else "before"
    return (
        f"a response that is {abs(seconds):.3g} s {side} the input",
        f"Correct the channels' clock, or take it out. {line}",
    )


def clock(ppm: float, line: str) -> Words:
    """Return the message on a response by another clock, and the line of its error."""
    pace = "fast" if ppm > 0 else "slow"
    return (
        f"a clock of the response that runs {abs(ppm):.3g} ppm {pace} against the drive's",
        f"Record both by one clock, or resample the response. {line}",
    )


def turned(test: str, line: str) -> Words:
    """Return the message on a test whose sign is reversed, and the line that turns it."""
    return (
        f"{test} with its sign reversed",
        f"Reverse the sign of one channel of {test}, for example its input. {line}",
    )


def factor(test: str, size: float, unit: str | None, line: str, *, is_turned: bool) -> Words:
    """Return the message for a test whose response has another scale, such as a wrong unit."""
    sign = " and with the opposite sign" if is_turned else ""
    hint = f", as {unit} would be" if unit else ""
    return (
        f"{test} {size:.4g} times as large as by the others{sign}{hint}",
        f"Check units and amplifiers of {test}; if this is its input's, correct it. {line}",
    )


def offset(largest: float, line: str) -> Words:
    """Return the message on a constant offset of the response, and the line that removes it."""
    return (
        f"a constant offset of the response, {largest:.3g} at most",
        f"Measure AC coupled, or remove the mean. {line}",
    )


def clipping(tests: Sequence[str]) -> Words:
    """Return the message on tests whose responses are clipped."""
    return (
        f"clipping of {', '.join(tests)} at the largest value",
        "Measure again with a wider range, or leave out what is clipped.",
    )


def residual_term(constant: float, line: str) -> Words:
    """Return the message on the response of modes outside the band, and the line that fits it."""
    return (
        f"a residual term of the modes beyond the band, {constant:.3g} m per unit of the input",
        f"Fit residual terms, or restrict the band. {line}",
    )


def natural_frequencies(scatter: float, line: str) -> Words:
    """Return the message that natural frequencies differ between tests, and its remedy."""
    return (
        "a natural frequency and damping of each test's own, scattering by "
        f"{percent(scatter, '.2f')}",
        "If all tests are of one assembly, the law misses this: compare others by `jbw laws`. Else "
        f"name the run of every test, and measure a noise record in each. {line}",
    )


def further_mode(hz: float, line: str) -> Words:
    """Return the message on one more mode in the band, and the line of a band without it."""
    return (
        f"one more mode about {hz:.3g} Hz",
        "State it by `modes` in [identify], restrict the `band` to one mode, or measure in the "
        f"node of the other.{line}",
    )
