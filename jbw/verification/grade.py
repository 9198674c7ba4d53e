"""The grade of a law: how well it predicts tests that no fit saw.

With errors over the rms of each test and the share c of values inside the 99 % bands, over held-out
tests within the fitted amplitudes:

| grade | rms error e | largest error | c |
| --- | --- | --- | --- |
| predictive | at most 5 %, or what the campaign states | twice that | 95 % |
| approximate | at most 25 %, and 0.6 times a linear oscillator's | - | 95 % |
| not predictive | else | | |

Where e is what noise makes, a larger error says nothing against the law: a law that leaves white
residuals, or no more than 1.25 times the scatter of repeats, needs not beat a linear oscillator,
and above 25 % it is not assessed.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from jbw.campaign.settings import LIMIT
from jbw.identification.accuracy import OF_MISFIT, another_law
from jbw.inference.posterior.finding import ASKED, GRADE, Amendment, Finding, Status, Verdict, judge
from jbw.measurement.channels import rms
from jbw.report.messages import residuals as messages
from jbw.verification.backbone import CARRIED_ON
from jbw.verification.predicted import ALIKE

WORST = 2.0  # times the limit: largest error of one test under a predictive law
APPROXIMATE, OF_LINEAR = 0.25, 0.6  # largest error, and over that of the best linear oscillator
LEAST_COVERAGE = 0.95  # of a 99 % band over a record
LEAST_VALUES = 50  # of a record whose coverage says something
TO_SCATTER = 1.25  # times the scatter of a repeat: what a prediction of its mean misses by noise
Tests = Mapping[str, Mapping[str, Any]]


class Seen(NamedTuple):
    """The errors and coverage of a law on held-out tests within the fitted amplitudes.

    Attributes:
        count: Of these tests.
        error: Root mean square of their errors.
        worst: The largest of their errors.
        linear: Root mean square of a linear oscillator's errors; NaN where it is not compared.
        coverage: Share of their values inside the 99 % bands; NaN where nothing tells.
        is_withheld: Whether one of them has no band.
        to: "repeats" or "noise" where no more is missed than that; else empty.
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
    """Return the verdict by findings, their amendments and the grade of the law, where it has one.

    Arguments as for `grade`.
    """
    graded = grade(tests, laws, findings, limit)
    if graded is None:
        return judge(findings, amendments)
    return judge([*findings, graded], [*amendments, *_of_others(graded)])


def grade(
    tests: Tests, laws: Sequence[str], findings: Sequence[Finding], limit: float = LIMIT
) -> Finding | None:
    """Return the grade as a finding; None where no test was held out within the amplitudes.

    Args:
        tests: Attributes of every test beside its prediction, by name.
        laws: Of the joint.
        findings: Of the fit, which tell whether it leaves white residuals.
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
    """Return what the held-out tests within the fitted amplitudes show."""
    unseen = [
        attrs
        for attrs in tests.values()
        if not attrs.get("fitted") and attrs.get("extrapolation", 1.0) <= CARRIED_ON
    ]
    if not unseen:
        return None
    # A law that cannot be solved misses all.
    errors = [float(np.nan_to_num(attrs["nrmse"], nan=np.inf)) for attrs in unseen]
    linear = [attrs.get("nrmse_linear", np.nan) for attrs in unseen]
    scatter = [attrs.get("scatter", np.nan) for attrs in unseen]
    # Noise of other tests is no measure of harmonics and loops of another level.
    sized = [
        (attrs["coverage"], attrs.get("num_values", 0))
        for attrs in unseen
        if (attrs["group"] == "sweep" or attrs.get("noise") != ALIKE)
        and np.isfinite(attrs.get("coverage", np.nan))
    ]
    size = sum(number for _, number in sized)
    coverage = sum(share * number for share, number in sized) / max(size, 1)
    of_fit = [finding.status for finding in findings if finding.code in OF_MISFIT]
    is_white = bool(of_fit) and set(of_fit) == {"ok"}
    to_scatter = rms(errors) <= TO_SCATTER * rms(scatter)
    return Seen(
        count=len(unseen), error=rms(errors), worst=max(errors), linear=rms(linear),
        coverage=coverage if size >= LEAST_VALUES else np.nan,
        is_withheld=any(attrs.get("withheld") for attrs in unseen),
        to="repeats" if to_scatter else "noise" if is_white else "",
    )  # fmt: skip


def status_of(seen: Seen, limit: float) -> Status:
    """Return the status of a grade: ok is predictive, usable approximate, failed neither."""
    if seen.coverage < LEAST_COVERAGE:
        return "failed"
    if seen.error <= limit and seen.worst <= WORST * limit and not seen.is_withheld:
        return "ok"
    beats_linear = not seen.error > OF_LINEAR * seen.linear
    if seen.error <= max(APPROXIMATE, limit) and (beats_linear or seen.to):
        return "usable"
    return "not assessed" if seen.to else "failed"


def _of_others(graded: Finding) -> Sequence[Amendment]:
    """Return the grade's amendments of other findings on the law, which the grade includes."""
    if graded.status == "not assessed":
        return ()
    others = tuple(code for code in ASKED["law"] if code not in (GRADE, "cause", "no_hysteresis"))
    if graded.status == "failed":
        return (Amendment(others, "usable", "failed", messages.NOT_PREDICTED, messages.FIT_MISSED),)
    return (Amendment(others, "failed", "usable", messages.IN_GRADE),)
