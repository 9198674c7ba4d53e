"""The grade of a law, from its errors in predicting tests that were not fitted.

It follows from the errors relative to the rms of each test, and the share c of values inside the 99
% bands, over held-out tests within the fitted amplitudes:

| grade | rms error e | largest error | c |
| --- | --- | --- | --- |
| predictive | at most 5 %, or what the campaign states | twice that | 95 % |
| approximate | at most 25 %, and 0.6 times a linear oscillator's | - | 95 % |
| not predictive | else | | |

If noise explains e, a larger error is no evidence against the law. So a law with white residuals,
or with an error of at most 1.25 times the scatter of repeats, need not beat a linear oscillator,
and above 25 % it is not assessed.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jbw.campaign.settings import LIMIT
from jbw.identification.accuracy import OF_MISFIT, another_law
from jbw.inference.posterior.finding import ASKED, GRADE, Amendment, Finding, Status, Verdict, judge
from jbw.measurement.channels import rms
from jbw.report.messages import residuals as messages
from jbw.results.attributes import PredictedTest
from jbw.verification.backbone import CARRIED_ON
from jbw.verification.predicted import ALIKE

WORST = 2.0  # largest error of a single test of a predictive law, relative to the limit
# largest error of an approximate law, and largest ratio to a linear oscillator's error
APPROXIMATE, OF_LINEAR = 0.25, 0.6
LEAST_COVERAGE = 0.95  # smallest share of a record that its 99 % band must contain
LEAST_VALUES = 50  # smallest number of values from which coverage is computed
# ratio of error to variation between repeats up to which noise explains the error
TO_SCATTER = 1.25
Tests = Mapping[str, PredictedTest]


class Seen(NamedTuple):
    """Errors and coverage of a law on held-out tests within the fitted amplitudes.

    Attributes:
        count: Number of these tests.
        error: Root mean square of the relative errors of these tests.
        worst: Largest relative error of these tests.
        linear: Root mean square of a linear oscillator's errors; NaN if it is not compared.
        coverage: Share of their values inside the 99 % bands; NaN if it cannot be assessed.
        is_withheld: Whether a test has no band.
        to: "repeats" or "noise" if that explains the error; else empty.
    """

    count: int
    error: float
    worst: float
    linear: float
    coverage: float
    is_withheld: bool
    to: str


def judged(
    findings: Sequence[Finding],
    amendments: Sequence[Amendment | None],
    tests: Tests,
    laws: Sequence[str],
    limit: float = LIMIT,
) -> Verdict:
    """Return the verdict from the law's grade and all findings, after their amendments.

    The arguments are those of `grade`.
    """
    graded = grade(tests, laws, findings, limit)
    if graded is None:
        return judge(findings, amendments)
    return judge([*findings, graded], [*amendments, *_of_others(graded)])


def grade(
    tests: Tests, laws: Sequence[str], findings: Sequence[Finding], limit: float = LIMIT
) -> Finding | None:
    """Return the grade of a law as a finding, or None if no held-out test can show it.

    Args:
        tests: Attributes of every test's comparison with its prediction, by name.
        laws: Names of the joint's laws.
        findings: Findings on the fit, which show whether its residuals are white.
        limit: Largest error of a predictive law.
    """
    seen = held_out(tests, findings)
    if seen is None:
        return None
    status = status_of(seen, limit)
    values = {**seen._asdict(), "status": status, "limit": limit}
    remedy = {} if status == "ok" else {"another_law": another_law(laws)}
    return Finding("law_grade", status, values, seen.error, remedy)


def held_out(tests: Tests, findings: Sequence[Finding]) -> Seen | None:
    """Return errors and coverage of held-out tests within the fitted amplitudes, or None."""
    unseen = [
        test
        for test in tests.values()
        if not test.fitted and (test.extrapolation is None or test.extrapolation <= CARRIED_ON)
    ]
    if not unseen:
        return None
    # A law for which the model cannot be solved has an infinite error.
    errors = [float(np.nan_to_num(test.nrmse, nan=np.inf)) for test in unseen]
    linear = [test.nrmse_linear for test in unseen]
    scatter = [test.scatter for test in unseen]
    # The noise of other tests is not valid for harmonics and loops at another level.
    sized = [
        (test.coverage, test.num_values)
        for test in unseen
        if (test.group == "sweep" or test.noise != ALIKE) and np.isfinite(test.coverage)
    ]
    size = sum(number for _, number in sized)
    coverage = sum(share * number for share, number in sized) / max(size, 1)
    of_fit = [finding.status for finding in findings if finding.code in OF_MISFIT]
    is_white = bool(of_fit) and set(of_fit) == {"ok"}
    to_scatter = rms(errors) <= TO_SCATTER * rms(scatter)
    return Seen(
        count=len(unseen), error=rms(errors), worst=max(errors), linear=rms(linear),
        coverage=coverage if size >= LEAST_VALUES else np.nan,
        is_withheld=any(test.withheld for test in unseen),
        to="repeats" if to_scatter else "noise" if is_white else "",
    )  # fmt: skip


def status_of(seen: Seen, limit: float) -> Status:
    """Return the status of a grade: ok if predictive, usable if approximate, else failed."""
    if seen.coverage < LEAST_COVERAGE:
        return "failed"
    if seen.error <= limit and seen.worst <= WORST * limit and not seen.is_withheld:
        return "ok"
    beats_linear = not seen.error > OF_LINEAR * seen.linear
    if seen.error <= max(APPROXIMATE, limit) and (beats_linear or seen.to):
        return "usable"
    return "not assessed" if seen.to else "failed"


def _of_others(graded: Finding) -> Sequence[Amendment]:
    """Return changes of findings: the grade of a law replaces other findings on the same law."""
    if graded.status == "not assessed":
        return ()
    others = tuple(code for code in ASKED["law"] if code not in (GRADE, "cause", "no_hysteresis"))
    if graded.status == "failed":
        return (Amendment(others, "usable", "failed", messages.NOT_PREDICTED, messages.FIT_MISSED),)
    return (Amendment(others, "failed", "usable", messages.IN_GRADE),)
