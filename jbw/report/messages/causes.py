"""The messages on causes of a fit's residual, with the causes that only a fit can detect."""

from collections.abc import Sequence

from jbw.report.messages.message import FaultText, percent
from jbw.report.messages.remedies import put


def causes(explained: Sequence[tuple[float, str]]) -> str:
    """Return the sentence on possible causes of the residual, with the fraction each explains."""
    shares = [f"{text.rstrip('.')} ({percent(share, '.0f')})" for share, text in explained]
    return (
        "Possible causes of the residual, each with the share of the residual that it alone "
        f"would explain: {'; '.join(shares)}."
    )


def residual_term(constant: float) -> FaultText:
    """Return the fault that modes outside the band respond, with the line to fit these modes."""
    return FaultText(
        f"Modes outside the band respond by {constant:.3g} m per unit of the input.",
        "A model of one mode does not contain the response of other modes.",
        f"Fit residual terms, or restrict the band. {put('[test]', 'residuals', 'both')}",
    )


def natural_frequencies(scatter: float) -> FaultText:
    """Return the message that natural frequencies differ between tests, with its remedy."""
    return FaultText(
        "Natural frequency and damping differ between the tests (standard deviation of the natural "
        f"frequency {percent(scatter, '.2f')}).",
        "With one joint and one law, the natural frequency at rest is the same in all tests.",
        "If all tests were made on one assembly, the law is wrong: compare laws by `jbw laws`. "
        "Otherwise name the run of every test, and measure a noise record in each run. "
        f"{put('[test]', 'run', 'day 1')}",
    )
