"""Findings about a posterior, and the verdict that follows from them."""

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
# Codes of the findings that answer each question, the most important first; others are of sampling.
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
    """Result of one check.

    Attributes:
        code: Short name, such as "r_hat".
        status: One of the four; usable means that it holds within a stated error.
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
        return "\n".join([self._heading(), *text_of(self.findings)])

    def _repr_html_(self) -> str:
        return f"<p><b>{self._heading()}</b></p>{table_of(self.findings)}"

    def _heading(self) -> str:
        statuses = ((name, answer.status) for name, answer in answers(self.findings))
        return first_line(self.status, statuses)


def judge(findings: Iterable[Finding]) -> Verdict:
    """The verdict that follows from findings; not assessed without any."""
    findings = tuple(findings)
    statuses: set[Status] = {finding.status for finding in findings}
    return Verdict(worst_of(statuses), findings)


def worst_of(statuses: Collection[Status]) -> Status:
    """The worst of some statuses; of none, not assessed."""
    for status in WORST_FIRST:
        if status in statuses:
            return status
    return "not assessed"


def qualified(verdict: Verdict, codes: Collection[str], limits: str) -> Verdict:
    """A verdict in which failed findings of some codes are usable within stated limits."""
    return judge(
        replace(finding, status="usable", reason=f"{finding.reason} {limits}")
        if finding.code in codes and finding.status == "failed"
        else finding
        for finding in verdict.findings
    )


def checked(code: str, ok: bool | np.bool_, reason: str, number: float, action: str) -> Finding:
    """A finding that is ok or failed; the action is for the failure."""
    return Finding(code, "ok" if ok else "failed", reason, float(number), "" if ok else action)


@dataclass(frozen=True)
class Answer:
    """Answer of the findings to one question of the verdict.

    Attributes:
        question: The question.
        status: Their verdict.
        because: Reasons of the findings against it, or of the first of those for it.
    """

    question: str
    status: Status
    because: str


def answers(findings: Iterable[Finding]) -> Iterator[tuple[str, Answer]]:
    """The three answers of a verdict by name; none without findings."""
    looked = tuple(findings)
    for name, question in QUESTIONS.items():
        relevant = [finding for finding in looked if ASKED_BY.get(finding.code, "sampling") == name]
        if relevant:
            rank = {code: place for place, code in enumerate(ASKED[name])}
            relevant.sort(key=lambda finding: rank.get(finding.code, len(rank)))
            against = [finding for finding in relevant if finding.status != "ok"] or relevant[:1]
            because = " ".join(finding.reason for finding in against)
            yield name, Answer(question, judge(relevant).status, because)
