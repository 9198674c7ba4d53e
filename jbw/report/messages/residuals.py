"""Messages on residuals of tests: as fitted, held out, or predicted from others."""

from collections.abc import Mapping, Sequence

from jbw.report.messages.message import capital, listed, percent

ERROR_FROM_REST = "error of a test when it is predicted from the other tests"
SD_RATIO = (
    "standard deviation from a fit without this kind of test / standard deviation from the fit to "
    "all tests"
)
WITH_FREQUENCY = ", with a separate natural frequency"
Z_SCORE = "change of the fit divided by the standard deviation that chance would cause"
WIDER_WITHOUT = (
    "standard deviation from a fit without this run / standard deviation from the fit to all runs"
)
IN_GRADE = "The grade of the law already includes the error of these predictions."
NOT_PREDICTED = "The law does not predict tests that were not fitted."
FIT_MISSED = (
    "Fit the tests that the law does not predict, or look for a difference between the tests: "
    "jbw look."
)


def across_kinds(
    errors: Mapping[str, tuple[float, float]],
    identified: Mapping[str, Sequence[str]],
    *,
    own_frequency: bool,
) -> str:
    """Return the sentence on each kind of test: errors, and parameters that need this kind."""
    rows = "; ".join(
        f"{kind} {percent(error)} ({percent(fitted)} when fitted)"
        for kind, (error, fitted) in errors.items()
    )
    proviso = (
        " These predictions use a separate natural frequency for each run." if own_frequency else ""
    )
    return (
        f"RMS error of each kind of test, predicted from the other kinds: {rows}."
        f"{proviso}{identified_by(identified)}"
    )


def identified_by(needed: Mapping[str, Sequence[str]]) -> str:
    """Return the text on parameters that only one kind of test or session identifies, if any."""
    words = [
        f"identified only by {which}: {listed(names)}" for which, names in needed.items() if names
    ]
    return f" {capital('; '.join(words))}." if words else ""


def each_session(
    proviso: str, errors: Sequence[str], identified: Mapping[str, Sequence[str]]
) -> str:
    """Return the sentence on each session: errors, and parameters that need this session."""
    return (
        f"RMS error of each session, predicted from the other sessions{proviso}: "
        f"{', '.join(errors)}."
        f"{identified_by(identified)}"
    )


def outside_band(terms: str, share: float) -> str:
    """Return the sentence on fitted residual terms and the reduction of chi-square by them."""
    return (
        "Modes outside the band contribute to the response; they were fitted by residual terms: "
        f"{terms}. They reduce chi-square by {percent(share, '.0f')}; "
        'to omit them, state `residuals = "none"` in a test.'
    )


def neighbour(hz: float, zeta: float, share: float, fall: float) -> str:
    """Return the sentence on a linear mode near the joint's, and the reduction of chi-square."""
    return (
        f"A linear mode at {hz:.4g} Hz, zeta {percent(zeta, '.2f')}, with {share:.2g} times the "
        "gain of the joint's mode was added to the fit; this lowers chi-square by "
        f'{percent(fall, ".0f")}. To omit this mode, state `residuals = "none"` in a test.'
    )


def usable_within(error: float, test: str) -> str:
    """Return the sentence on the largest RMS error of a fitted test: the error of the law."""
    return (
        f"RMS error of the fitted tests: at most {percent(error)} ({test}). With this error the "
        "law may be used up to the fitted amplitudes."
    )


def worse_than_fitted(factor: float) -> str:
    """Return the clause that tests outside the fit have larger errors than fitted tests."""
    return f", more than {factor:g} times as large: the law fits better than it predicts"


def unseen_errors(tests: str, error: float, fitted: float, comparison: str) -> str:
    """Return the sentence on RMS errors of tests outside the fit and of fitted tests."""
    return (
        f"RMS error of {tests}: {percent(error)}, compared with {percent(fitted)} for the fitted "
        f"tests{comparison}."
    )
