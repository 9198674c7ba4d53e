"""The messages on the model discrepancy: the error of a law on runs that its fit has not seen."""

from collections.abc import Sequence
from typing import NamedTuple

from jbw.report.messages.message import listed, percent

IN_BANDS = (
    "Bands of tests that were not fitted include what the law misses of runs that are left out. "
    "Beyond the largest amplitude fitted it grows with the square of the amplitude, as the "
    "equivalent stiffness of a cubic spring does."
)
SHIFT_OF_RUN = "missed by the fit without it"


class Unscored(NamedTuple):
    """Why nothing shows how a law predicts other levels."""

    reason: str
    sentence: str


UNSCORED = {
    "one run": Unscored(
        "one run was fitted",
        "The model discrepancy cannot be estimated: only one run was fitted. Bands of other tests "
        "contain the uncertainty of parameters and noise alone; add a run of another level.",
    ),
    "two runs": Unscored(
        "two runs were fitted",
        "The model discrepancy cannot be estimated: two runs were fitted, and a fit without one of "
        "them sees one level alone. Bands of other tests contain the uncertainty of parameters and "
        "noise alone; add a run of another level.",
    ),
    "one level": Unscored(
        "every fitted run reaches the same amplitude",
        "Leaving runs out does not show how the law predicts other levels: every fitted run "
        "reaches the same amplitude. Held-out tests of another level show it.",
    ),
}
WITHHELD = (
    "withheld, and with it the band of a measurement: the law misses more than noise, and no run "
    "that is left out shows how much at the amplitude of these tests; fit a test of their level"
)
FIT_THAT_LEVEL = "Fit a test of that level."


def bands_withheld(names: Sequence[str]) -> str:
    """Return the message on which held-out tests have no band, and why."""
    return (
        f"No band is stated for {listed(names)}: the law misses more than noise, and no run that "
        "is left out shows how much at that amplitude."
    )


def one_kind(kind: str) -> str:
    """Return the message that no kind of test can be predicted from the others."""
    return (
        f"How the law predicts another kind of test cannot be scored: the fitted tests are {kind} "
        "alone."
    )


def not_scored(levels: str, kind: str) -> str:
    """Return the message on what no test shows of a law's predictions.

    `levels` is a key of `UNSCORED`, `kind` the kind of all tests; each is empty where others show
    it.
    """
    unscored = [f"other levels ({UNSCORED[levels].reason})"] if levels else []
    unscored += [f"other kinds of test (the fitted tests are {kind} alone)"] if kind else []
    return f"Not scored: how the law predicts {listed(unscored)}."


def missed(
    frequency: float,
    damping: float,
    rest: float,
    run: str,
    run_frequency: float,
    run_damping: float,
) -> str:
    """Return the message on what a law misses, and how the run lies on which it shows most."""
    parts = [f"{percent(frequency)} of the natural frequency"] if frequency else []
    parts += [f"{percent(damping)} of critical damping"] if damping else []
    parts += [f"{percent(rest)} of the response in shape"] if rest else []
    changes = []
    if run_frequency:
        size, side = percent(abs(run_frequency)), _side(run_frequency)
        changes.append(f"its natural frequency is {size} {side}")
    if run_damping:
        size, side = percent(abs(run_damping)), _side(run_damping)
        changes.append(f"its damping ratio is {size} of critical {side}")
    most = f" Largest on {run}: {listed(changes)} than predicted." if changes else ""
    return (
        f"Predictions of runs left out of the fit err by more than noise: by {listed(parts)} "
        f"(standard deviations over the fitted amplitudes).{most}"
    )


def _side(change: float) -> str:
    return "higher" if change > 0 else "lower"
