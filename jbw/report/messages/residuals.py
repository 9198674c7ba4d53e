"""Residuals of tests: as fitted, held out of the fit, or predicted from others."""

from collections.abc import Mapping, Sequence

from jbw.report.messages.message import percent

ERROR_FROM_REST = "error predicted from the rest"
SD_RATIO = "sd without the kind over that with it"
WITH_FREQUENCY = ", with its own natural frequency"
Z_SCORE = "change over its sd by chance"
WIDER_WITHOUT = "sd without the run over that with it"
IN_GRADE = "The grade of the law counts this."
NOT_PREDICTED = "The law does not predict tests that no fit saw."
FIT_MISSED = "Fit these tests too, or look for what differs between the tests: jbw look."


def across_kinds(
    errors: Mapping[str, tuple[float, float]],
    identified: Mapping[str, Sequence[str]],
    *,
    own_frequency: bool,
) -> str:
    """Return the sentence on each kind of test: RMS errors, parameters that it alone identifies."""
    listed = "; ".join(
        f"{kind} {percent(error)} ({percent(fitted)} as fitted)"
        for kind, (error, fitted) in errors.items()
    )
    proviso = " and their own natural frequency" if own_frequency else ""
    return (
        f"RMS error of each kind of test, predicted from the other kinds{proviso}: {listed}."
        f"{identified_by(identified)}"
    )


def identified_by(needed: Mapping[str, Sequence[str]]) -> str:
    """Return the text on parameters that only one kind of test or session identifies, if any."""
    words = [f"{', '.join(names)} by {which} alone" for which, names in needed.items() if names]
    return f" Identified: {'; '.join(words)}." if words else ""


def each_session(
    proviso: str, errors: Sequence[str], identified: Mapping[str, Sequence[str]]
) -> str:
    """Return the sentence on each session: its RMS error, parameters that it alone identifies."""
    return (
        f"RMS error of each session, predicted from the others{proviso}: {', '.join(errors)}."
        f"{identified_by(identified)}"
    )


def outside_band(terms: str, share: float) -> str:
    """Return the message on fitted residual terms and their reduction of chi-square."""
    return (
        "Modes outside the band contribute to the response; residual terms were fitted: "
        f'{terms}. They reduce chi-square by {percent(share, ".0f")}; `residuals = "none"` in '
        "a test omits them."
    )


def neighbour(hz: float, zeta: float, share: float, fall: float) -> str:
    """Return the message on a linear mode next to the joint's, and the reduction of chi-square."""
    return (
        f"A linear mode at {hz:.4g} Hz, zeta {percent(zeta, '.2f')}, with {share:.2g} times "
        "the gain of the joint's mode was added to the fit: chi-square falls by "
        f'{percent(fall, ".0f")}; `residuals = "none"` in a test omits it.'
    )


def usable_within(error: float, test: str) -> str:
    """Return the sentence on the largest RMS error of a fitted test: the error of the law."""
    return (
        f"RMS error of the fitted tests: at most {percent(error)} ({test}); within this the law "
        "may be used up to the fitted amplitudes."
    )


def worse_than_fitted(factor: float) -> str:
    """Return the clause that tests outside the fit have larger errors than fitted tests."""
    return f", more than {factor:g} times as much: the law fits better than it predicts"


def unseen_errors(tests: str, error: float, fitted: float, comparison: str) -> str:
    """Return the sentence on the RMS error of tests outside the fit and of fitted tests."""
    return (
        f"RMS error of {tests}: {percent(error)}, against {percent(fitted)} of the fitted ones"
        f"{comparison}."
    )
