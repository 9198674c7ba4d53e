"""Messages on the model discrepancy: the error of a law for runs that were not fitted."""

from collections.abc import Sequence
from typing import NamedTuple

from jbw.report.messages.message import listed, percent

IN_BANDS = (
    "The bands of tests that were not fitted include the model discrepancy: the error of the law "
    "on runs that are left out of the fit. Beyond the largest fitted amplitude this error grows "
    "with the square of the amplitude, as the equivalent stiffness of a cubic spring does."
)
SHIFT_OF_RUN = "error of a fit without this run"


class Unscored(NamedTuple):
    """The reason why no test shows how well a law predicts other levels."""

    reason: str
    sentence: str


UNSCORED = {
    "one run": Unscored(
        "one run was fitted",
        "The model discrepancy cannot be estimated: only one run was fitted. Bands of other tests "
        "contain only the uncertainty of the parameters and the noise. Add a run of another level.",
    ),
    "two runs": Unscored(
        "two runs were fitted",
        "The model discrepancy cannot be estimated: two runs were fitted, and a fit without either "
        "of them has only one level. Bands of other tests contain only the uncertainty of the "
        "parameters and the noise. Add a run of another level.",
    ),
    "one level": Unscored(
        "every fitted run reaches the same amplitude",
        "Leaving runs out of the fit does not show how well the law predicts other levels: every "
        "fitted run reaches the same amplitude. Hold out a test of another level to determine the "
        "error there.",
    ),
}
ERROR_UNKNOWN = (
    "the error of the law exceeds noise, and no left-out run determines this error at the "
    "predicted amplitude"
)
FIT_THAT_LEVEL = "Fit a test of the level whose bands are withheld."


def rivals_not_excluded(laws: Sequence[str]) -> str:
    """Return the reason why the chosen law has no bands beyond the fitted amplitudes."""
    return (
        f"the campaign states no law, and the fitted tests do not exclude {listed(laws)}, whose "
        "joint may slip fully beyond the largest fitted displacement"
    )


def withheld(why: str) -> str:
    """Return the note on a test without a band, with the reason and the remedy."""
    return (
        f"The bands of tests and of measurements are withheld: {why}. Fit a test of the same level"
    )


def bands_withheld(names: Sequence[str]) -> str:
    """Return the sentence on held-out tests without a band, with the reason."""
    return (
        f"The bands of {listed(names)} are withheld: the error of the law is not known "
        "at the amplitude of these tests."
    )


def one_kind(kind: str) -> str:
    """Return the message that no kind of test can be predicted from the others."""
    return (
        "The error of the law in predicting another kind of test is unknown, because all fitted "
        f"tests are {kind}."
    )


def not_scored(levels: str, kind: str) -> str:
    """Return the sentence on predictions whose errors are unknown, with the reasons.

    `levels` is a key of `UNSCORED`, `kind` the kind of all tests; each is empty where others show
    it.
    """
    unscored = [f"other levels ({UNSCORED[levels].reason})"] if levels else []
    unscored += [f"other kinds of test (all fitted tests are {kind})"] if kind else []
    return (
        f"The error of the law in predicting {listed(unscored)} is unknown. To determine this "
        "error, fit tests of several levels and kinds."
    )


def missed(
    frequency: float,
    damping: float,
    rest: float,
    run: str,
    run_frequency: float,
    run_damping: float,
) -> str:
    """Return the sentence on the errors of a law for omitted runs, with the largest error."""
    parts = [f"{percent(frequency)} of the natural frequency"] if frequency else []
    parts += [f"{percent(damping)} of critical damping"] if damping else []
    parts += (
        [f"{percent(rest)} of the response (without errors due to frequency and damping)"]
        if rest
        else []
    )
    changes = []
    if run_frequency:
        size, side = percent(abs(run_frequency)), _side(run_frequency)
        changes.append(f"the natural frequency is {size} {side}")
    if run_damping:
        size, side = percent(abs(run_damping)), _side(run_damping)
        changes.append(f"the damping ratio is {size} of critical {side}")
    most = f" The error is largest on {run}: {listed(changes)} than predicted." if changes else ""
    return (
        "Runs that are left out of the fit are predicted with errors that exceed noise: "
        f"{listed(parts)} (standard deviations over the fitted amplitudes).{most}"
    )


def _side(change: float) -> str:
    return "higher" if change > 0 else "lower"
