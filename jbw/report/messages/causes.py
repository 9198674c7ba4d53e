"""The messages on possible causes of a fit's residual: common mistakes, and their remedies."""

from collections.abc import Sequence

from jbw.report.messages.message import percent

Words = tuple[str, str]
"""What is wrong, and what to do about it."""


def causes(explained: Sequence[tuple[float, str]]) -> str:
    """Return the message on what would explain the residual, each with its share."""
    shares = [f"{text} ({percent(share, '.0f')})" for share, text in explained]
    return (
        "Possible causes of the residual, with the part of it that each alone would explain: "
        f"{'; '.join(shares)}."
    )


def swapped(test: str) -> Words:
    """Return the message that input and response of a test are exchanged."""
    return (
        f"an interchange of the input and response channels of {test}",
        f"Swap the channels of {test}.",
    )


def delay(seconds: float, line: str) -> Words:
    """Return the message on a response that is late [s], or early, and the line of its delay."""
    side = "lags" if seconds > 0 else "leads"
    return (
        f"a response that {side} the input by {abs(seconds):.3g} s",
        f"Correct the timing of the channels, or state the delay. {line}",
    )


def clock(ppm: float, line: str) -> Words:
    """Return the message on a response by another clock, and the line of its error."""
    pace = "faster" if ppm > 0 else "slower"
    return (
        f"a clock of the response that runs {abs(ppm):.3g} ppm {pace} than that of the drive",
        f"Record both channels with one clock, or resample the response. {line}",
    )


def turned(test: str, line: str) -> Words:
    """Return the message on a test whose sign is reversed, and the line that turns it."""
    return (
        f"a reversed sign of one channel of {test}",
        f"Reverse the sign of one channel of {test}, for example its input. {line}",
    )


def factor(test: str, size: float, unit: str | None, line: str, *, is_turned: bool) -> Words:
    """Return the message for a test whose response has another scale, such as a wrong unit."""
    sign = " and with the opposite sign" if is_turned else ""
    hint = f" (the factor of a wrong unit: {unit})" if unit else ""
    return (
        f"a response of {test} that is {size:.4g} times as large as the other tests predict"
        f"{sign}{hint}",
        f"Check the units and amplifiers of {test}; if its input is wrong, correct it. {line}",
    )


def offset(largest: float, line: str) -> Words:
    """Return the message on a constant offset of the response, and the line that removes it."""
    return (
        f"a constant offset of the response (at most {largest:.3g})",
        f"Measure AC coupled, or remove the mean. {line}",
    )


def clipping(tests: Sequence[str]) -> Words:
    """Return the message on tests whose responses are clipped."""
    return (
        f"clipping of {', '.join(tests)} at the largest values",
        "Measure again with a wider range, or leave the clipped part out.",
    )


def residual_term(constant: float, line: str) -> Words:
    """Return the message on the response of modes outside the band, and the line that fits it."""
    return (
        f"the response of modes outside the band, {constant:.3g} m per unit of the input",
        f"Fit residual terms, or restrict the band. {line}",
    )


def natural_frequencies(scatter: float, line: str) -> Words:
    """Return the message that natural frequencies differ between tests, and its remedy."""
    return (
        "differences of natural frequency and damping between the tests (standard deviation "
        f"{percent(scatter, '.2f')})",
        "If all tests were made on one assembly, the law is wrong: compare laws by `jbw laws`. "
        f"Otherwise name the run of every test, and measure a noise record in each run. {line}",
    )


def further_mode(hz: float, line: str) -> Words:
    """Return the message on one more mode in the band, and the line of a band without it."""
    return (
        f"another mode near {hz:.3g} Hz",
        "State the other mode by `modes` in [identify], restrict the `band` to one mode, or "
        f"measure at its node.{line}",
    )
