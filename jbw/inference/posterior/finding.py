"""What a look at a posterior found, and the verdict that follows."""

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from jbw.inference.posterior.shown import first_line, table_of, text_of

Status = Literal["ok", "usable", "failed", "not assessed"]
WORST_FIRST: tuple[Status, ...] = ("failed", "not assessed", "usable", "ok")
QUESTIONS = {
    "sampling": "Did the computation converge?",
    "law": "Does the model follow the data?",
    "knowledge": "Do the data identify the parameters?",
}
# Codes of the findings that answer each, the most telling first; all others are of sampling.
ASKED = {
    "sampling": ("ess_bulk", "r_hat"),
    "law": (
        "no_hysteresis", "cause", "level_trend", "repeatability", "held_out_coverage",
        "simpler_model", "misfit", "coloured_residual", "chi_square", "leave_one_out",
        "records_apart",
    ),
    "knowledge": ("no_joint", "unidentified", "modes", "at_bound"),
}  # fmt: skip
ASKED_BY = {code: name for name, codes in ASKED.items() for code in codes}


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        code: Short name, such as "r_hat".
        status: Of the four; usable is what holds within an error that is stated.
        reason: One sentence with the worst quantity by name.
        number: The worst number; NaN where there is none.
        action: What to do; empty when ok.
    """

    code: str
    status: Status
    reason: str
    number: float
    action: str = ""


@dataclass(frozen=True, repr=False)
class Verdict:
    """Findings in their order: failed if any is, else not assessed or usable if any is, else ok."""

    status: Status
    findings: tuple[Finding, ...]

    def __repr__(self) -> str:
        return "\n".join([self._told(), *text_of(self.findings)])

    def _repr_html_(self) -> str:
        return f"<p><b>{self._told()}</b></p>{table_of(self.findings)}"

    def _told(self) -> str:
        each = ((name, told.status) for name, told in answers(self.findings))
        return first_line(self.status, each)


def judge(findings: Iterable[Finding]) -> Verdict:
    """The verdict that follows from findings; one that says nothing is not assessed."""
    findings = tuple(findings)
    statuses: set[Status] = {finding.status for finding in findings}
    return Verdict(worst_of(statuses), findings)


def worst_of(statuses: Collection[Status]) -> Status:
    """The worst of some statuses; of none, not assessed."""
    for one in WORST_FIRST:
        if one in statuses:
            return one
    return "not assessed"


def qualified(found: Verdict, codes: Collection[str], said: str) -> Verdict:
    """A verdict in which findings that failed are usable within what is said of them."""
    return judge(
        replace(one, status="usable", reason=f"{one.reason} {said}")
        if one.code in codes and one.status == "failed"
        else one
        for one in found.findings
    )


def checked(code: str, ok: bool | np.bool_, reason: str, number: float, action: str) -> Finding:
    """A finding that is ok or failed; the action is for the failure."""
    return Finding(code, "ok" if ok else "failed", reason, float(number), "" if ok else action)


@dataclass(frozen=True)
class Answer:
    """What the findings say to one question of the verdict.

    Attributes:
        question: The question.
        status: Their verdict.
        because: Reasons of the findings against it, or of the first of those for it.
    """

    question: str
    status: Status
    because: str


def answers(findings: Iterable[Finding]) -> Iterator[tuple[str, Answer]]:
    """The three answers of a verdict by name; none where nothing was looked at."""
    looked = tuple(findings)
    for name, question in QUESTIONS.items():
        own = [one for one in looked if ASKED_BY.get(one.code, "sampling") == name]
        if own:
            rank = {code: place for place, code in enumerate(ASKED[name])}
            own.sort(key=lambda one: rank.get(one.code, len(rank)))
            against = [one for one in own if one.status != "ok"] or own[:1]
            because = " ".join(one.reason for one in against)
            yield name, Answer(question, judge(own).status, because)
