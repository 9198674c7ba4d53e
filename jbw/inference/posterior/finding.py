"""Findings of the checks of a posterior, and the verdict that follows from them."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from html import escape
from textwrap import shorten
from typing import Any, Literal, NamedTuple, cast

import numpy as np

from jbw.report.messages.findings import FINDINGS, remedy_of, sentence_of
from jbw.report.messages.questions import QUESTIONS
from jbw.results.run import StoredAnswer, StoredFinding, StoredVerdict

Status = Literal["ok", "usable", "failed", "not assessed"]
GRADE = "law_grade"  # code of the finding that states whether the law describes the data
GRADES = {"ok": "predictive", "usable": "approximate", "failed": "not predictive"}
WORST_FIRST: tuple[Status, ...] = ("failed", "not assessed", "usable", "ok")
# Codes of the findings that answer each question of the verdict, most important first. Every other
# finding concerns sampling, or names its question itself.
ASKED = {
    "sampling": ("ess_bulk", "r_hat"),
    "law": (
        GRADE, "no_hysteresis", "cause", "level_trend", "repeatability", "held_out_coverage",
        "simpler_model", "law_replaced", "discrepancy", "misfit", "coloured_residual", "chi_square",
        "leave_one_out", "records_apart",
    ),
    "knowledge": ("no_joint", "unidentified_joints", "unidentified", "modes", "at_bound"),
}  # fmt: skip
ASKED_BY = {code: name for name, codes in ASKED.items() for code in codes}
CHARACTERS = 200  # largest number of characters of a reason or a remedy
SIZE = 1500  # largest number of bytes of a table
# Colours are Okabe and Ito's green and vermilion; orange stands for a doubtful result.
COLOURS, DOUBT = {"ok": "#009e73", "failed": "#d55e00"}, "#e69f00"


@dataclass(frozen=True)
class Finding:
    """The result of one check, from which its sentence and remedy are made.

    Attributes:
        code: Short name, such as "r_hat".
        status: One of the four statuses; usable means that it holds within a stated error.
        values: Values of the sentence, by the names of the catalogue's fields; or the sentence
            itself, as stored in a run's folder.
        number: The worst number of the check; NaN if there is none.
        remedy: Values of the remedy, by the names of the catalogue's fields; or its text.
        test: Name of the checked test; empty if all tests were checked.
        entry: The catalogue's entry if it differs from the code, such as "r_hat.one_chain".
        additions: Sentences and remedies that later checks added.
    """

    code: str
    status: Status
    values: Mapping[str, Any] | str
    number: float
    remedy: Mapping[str, Any] | str = field(default_factory=dict)
    test: str = ""
    entry: str = ""
    additions: tuple[tuple[str, str], ...] = ()

    @property
    def reason(self) -> str:
        """Return the result of the check as a sentence, with the additions of later checks."""
        return " ".join([self.fact, *(sentence for sentence, _ in self.additions)])

    @property
    def fact(self) -> str:
        """Return the result of the check as a sentence, without the additions of later checks."""
        if isinstance(self.values, str):
            return self.values
        return sentence_of(self.entry or self.code, self.values, passed=self.status == "ok")

    @property
    def action(self) -> str:
        """The recommended actions; empty when ok."""
        first = self.remedy
        if not isinstance(first, str):
            is_data = self.status != "ok" and not isinstance(self.values, str)
            first = remedy_of(self.entry or self.code, first) if is_data else ""
        return " ".join(filter(None, (first, *(action for _, action in self.additions))))

    def stored(self) -> StoredFinding:
        """Return the finding as a run's summary stores it, with the parameter's name if any."""
        of = self.values.get("name") if isinstance(self.values, Mapping) else None
        facts = {
            "code": self.code, "status": self.status, "reason": self.reason,
            "number": float(self.number) if np.isfinite(self.number) else None,
            "action": self.action,
        }  # fmt: skip
        return StoredFinding.read(facts | ({"of": of} if of else {}))


@dataclass(frozen=True, repr=False)
class Verdict:
    """The findings on a posterior, with the worst status of its three answers."""

    status: Status
    findings: tuple[Finding, ...]

    def __repr__(self) -> str:
        return "\n".join([self._heading(), *text_of(self.findings)])

    def _repr_html_(self) -> str:
        badge = f"border-left:.6em solid {COLOURS.get(self.status, DOUBT)};padding-left:.5em"
        return f'<p style="{badge}"><b>{self._heading()}</b></p>{table_of(self.findings)}'

    def stored(self) -> StoredVerdict:
        """Return the verdict as a run's summary stores it: status, answers and findings."""
        answered = dict(answers(self.findings))
        findings = [finding.stored() for finding in self.findings]
        return StoredVerdict.read(
            {"status": self.status, "answers": answered, "findings": findings}
        )

    def _heading(self) -> str:
        statuses = ((name, answer.word) for name, answer in answers(self.findings))
        return first_line(self.status, statuses)


def kept_verdict(stored: StoredVerdict) -> Verdict:
    """Return the verdict that is stored in a run's summary."""
    findings = (
        Finding(
            row.code, cast("Status", row.status), row.reason,
            np.nan if row.number is None else row.number, row.action,
        )
        for row in stored.findings
    )  # fmt: skip
    return Verdict(cast("Status", stored.status), tuple(findings))


class Amendment(NamedTuple):
    """A change that one check makes to another check's finding: status, reason and remedy.

    Attributes:
        codes: Codes of the findings that are amended.
        before: Status of the findings that are amended; findings with another status are not
            changed.
        status: New status of the findings.
        sentence: Sentence that is added to the reasons of these findings.
        remedy: Remedy that is added to the remedies of these findings.
    """

    codes: tuple[str, ...]
    before: Status
    status: Status
    sentence: str
    remedy: str = ""

    def applied_to(self, finding: Finding) -> Finding:
        """Return a finding, changed if the amendment applies to its code and status."""
        if finding.code not in self.codes or finding.status != self.before:
            return finding
        return amended(finding, self.status, self.sentence, self.remedy)


def judge(findings: Iterable[Finding], amendments: Iterable[Amendment | None] = ()) -> Verdict:
    """Return the verdict on amended findings; it is `not assessed` if there are no findings."""
    in_order = [amendment for amendment in amendments if amendment is not None]
    judged = tuple(
        reduce(lambda finding, amendment: amendment.applied_to(finding), in_order, finding)
        for finding in findings
    )
    by_question: dict[str, list[Finding]] = {}
    for finding in judged:
        by_question.setdefault(question_of(finding.code), []).append(finding)
    return Verdict(worst_of({answered(group) for group in by_question.values()}), judged)


def answered(findings: Sequence[Finding]) -> Status:
    """Return the status of one question: the law's grade if there is one, else the worst status."""
    grade = next((finding for finding in findings if finding.code == GRADE), None)
    return grade.status if grade else worst_of({finding.status for finding in findings})


def worst_of(statuses: Collection[Status]) -> Status:
    """Return the worst of several statuses; not assessed if there is none."""
    for status in WORST_FIRST:
        if status in statuses:
            return status
    return "not assessed"


def usable_within(codes: tuple[str, ...], limits: str) -> Amendment:
    """Return an amendment that makes failed findings usable; `limits` states the limits of use."""
    return Amendment(codes, "failed", "usable", limits)


def amended(finding: Finding, status: Status, sentence: str, remedy: str = "") -> Finding:
    """Return a finding whose status, sentence and remedy are changed by a later check.

    If a usable finding becomes failed, its earlier additions, the limits of its use, are removed.
    """
    fails = status == "failed" and finding.status == "usable"
    earlier = () if fails else finding.additions
    return replace(finding, status=status, additions=(*earlier, (sentence, remedy)))


def checked(
    code: str,
    ok: bool | np.bool_,
    values: Mapping[str, Any] | str,
    number: float,
    remedy: Mapping[str, Any] | str | None = None,
    *,
    entry: str = "",
) -> Finding:
    """Return a finding that is ok or failed; only a failed one has the remedy."""
    needed = {} if ok or remedy is None else remedy
    return Finding(code, "ok" if ok else "failed", values, float(number), needed, entry=entry)


def question_of(code: str) -> str:
    """Return the question of the verdict that findings with this code answer."""
    if code in ASKED_BY:
        return ASKED_BY[code]
    return FINDINGS[code].question if code in FINDINGS else "sampling"


def answers(findings: Iterable[Finding]) -> Iterator[tuple[str, StoredAnswer]]:
    """Yield the three answers of a verdict by name; yield none if there are no findings."""
    looked = tuple(findings)
    for name, question in QUESTIONS.items():
        relevant = [finding for finding in looked if question_of(finding.code) == name]
        if relevant:
            rank = {code: place for place, code in enumerate(ASKED[name])}
            relevant.sort(key=lambda finding: rank.get(finding.code, len(rank)))
            against = [finding for finding in relevant if finding.status != "ok"] or relevant[:1]
            sentences = (
                *(finding.fact for finding in against),
                *(sentence for finding in against for sentence, _ in finding.additions),
            )
            because = " ".join(dict.fromkeys(sentences))
            status = answered(relevant)
            is_graded = any(finding.code == GRADE for finding in relevant)
            word = GRADES.get(status, status) if is_graded else status
            yield name, StoredAnswer(question=question, status=status, word=word, because=because)


def first_line(status: str, answers: Iterable[tuple[str, str]] = ()) -> str:
    """Return the first line of a verdict: its status, and the status of each answer."""
    parts = ", ".join(f"{name} {answer}" for name, answer in answers)
    return f"Verdict: {status}" + (f" ({parts})" if parts else "")


def text_of(findings: Sequence[Finding]) -> Iterator[str]:
    """Yield one line per finding that is not ok, then the number of passed checks."""
    against = [finding for finding in findings if finding.status != "ok"]
    for finding in against:
        reason = shorten(finding.reason, CHARACTERS)
        yield f"  {finding.status}, {finding.code}: {reason} {finding.action}".rstrip()
    yield f"  {len(findings) - len(against)} of {len(findings)} checks passed"


def table_of(findings: Sequence[Finding], size: int = SIZE) -> str:
    """Return findings as an HTML table of at most `size` bytes, failed ones first."""
    against = sorted(
        (finding for finding in findings if finding.status != "ok"),
        key=lambda finding: WORST_FIRST.index(finding.status),
    )
    rows, spent = [], 0
    for finding in against:
        cells = finding.status, finding.code, shorten(finding.reason, CHARACTERS), finding.action
        row = "".join(f"<td>{escape(shorten(cell, CHARACTERS))}</td>" for cell in cells)
        spent += len(row.encode()) + 10
        if spent > size:
            break
        rows.append(f"<tr>{row}</tr>")
    omitted = len(against) - len(rows)
    more = f" ({omitted} more not passed)" if omitted else ""
    passed = f"<p>{len(findings) - len(against)} of {len(findings)} checks passed{more}</p>"
    return (f"<table>{''.join(rows)}</table>" if rows else "") + passed
