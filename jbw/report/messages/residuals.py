"""Residuals of tests: as fitted, held out of the fit, or predicted from others."""

from collections.abc import Mapping, Sequence

from jbw.report.messages.message import percent

ERROR_FROM_REST = "error predicted from the rest"
SD_RATIO = "sd without the kind over that with it"
WITH_FREQUENCY = ", with its own natural frequency"
Z_SCORE = "change over its sd by chance"
WIDER_WITHOUT = "sd without the run over that with it"
WITHIN_BANDS = ", and the 99 % bands hold them"
FIT_MISSED = "Fit the tests that are missed too, or look for what differs between them: jbw look."


def across_kinds(
    errors: Mapping[str, tuple[float, float]],
    identified: Mapping[str, Sequence[str]],
    *,
    own_frequency: bool,
) -> str:
    """RMS error of every kind of test, predicted and as fitted, and what it alone identifies."""
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
    """Parameters that one kind of test or one session alone identifies; empty where none is."""
    words = [f"{', '.join(names)} by {which} alone" for which, names in needed.items() if names]
    return f" Identified: {'; '.join(words)}." if words else ""


def each_session(
    proviso: str, errors: Sequence[str], identified: Mapping[str, Sequence[str]]
) -> str:
    """RMS errors of sessions, predicted from the others, and what each alone identifies."""
    return (
        f"RMS error of each session, predicted from the others{proviso}: {', '.join(errors)}."
        f"{identified_by(identified)}"
    )


def outside_band(terms: str, share: float) -> str:
    """Residual constants that were fitted, and by how much they reduce chi-square."""
    return (
        f"Modes outside the band are seen, and were taken in: {terms}. It takes {share:.0%} off "
        'what the fit left; `residuals = "none"` in a test goes without.'
    )


def neighbour(hz: float, zeta: float, share: float, fall: float) -> str:
    """A linear mode beside that of the joint, and by how much it reduces chi-square."""
    return (
        f"One linear neighbour at {hz:.4g} Hz, zeta {zeta:.2%}, with {share:.2g} times the gain "
        f"of the joint's own mode, was taken in: chi-square falls by {fall:.0%}; "
        '`residuals = "none"` in a test goes without.'
    )


def usable_within(error: float, test: str) -> str:
    """The largest RMS error of a fitted test, within which the law may be used."""
    return (
        f"The fit leaves {error:.2g} of {test}, and less of every other test: within this the law "
        "may be used, for motions as large as those that were fitted."
    )


def worse_than_fitted(factor: float) -> str:
    """That tests without a part in the fit are missed by more than fitted ones."""
    return (
        f", more than {factor:g} times as much: what was not fitted is not predicted to the error "
        "of what was"
    )


def unseen_errors(tests: str, error: float, fitted: float, comparison: str) -> str:
    """RMS error of tests without a part in the fit, beside that of fitted ones."""
    return (
        f"Error of {tests}: {error:.2g} of the rms, against {fitted:.2g} of the fitted "
        f"ones{comparison}."
    )
