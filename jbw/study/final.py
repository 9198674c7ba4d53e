"""A joint fitted to all tests for use, and what it was worth on those that were held out before."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from jbw.campaign.load import Campaign
from jbw.identification.assemble import Report
from jbw.identification.selection import fitted_for_use
from jbw.inference.posterior.finding import ASKED, WORST_FIRST, Finding, Verdict, judge
from jbw.inference.samplers.chunked_run import Keep
from jbw.report.messages import stages as messages
from jbw.study.study import Study
from jbw.study.summary import verdict_record

Once = Callable[[Campaign, Keep], Study]
HELD_OUT = "held_out_answer"  # key of summary.json


def for_use(once: Once, campaign: Campaign, keep: Keep, report: Report) -> Study:
    """Identify with some tests held out, then with all, by `once`.

    The posterior is that of all tests. Whether the model is adequate is told by the tests that were
    held out, which the second fit no longer can.
    """
    settings = campaign.settings.model_copy(update={"final": False})
    held = once(replace(campaign, settings=settings), keep)
    if not held_out(held.record):
        report(messages.NONE_HELD_OUT)
        return held
    report(messages.FITTING_FOR_USE)
    every = replace(campaign, settings=fitted_for_use(campaign.tests, settings))
    return with_held_out(once(every, lambda name: keep(f"final_{name}")), held)


def held_out(record: Mapping[str, Any]) -> dict[str, Any]:
    """Predictions of tests that were not fitted, by test."""
    predictions = record.get("predictions") or {}
    return {name: row for name, row in predictions.items() if not row["fitted"]}


def with_held_out(final: Study, held: Study) -> Study:
    """The study of all tests, with the held-out answer of the study before."""
    verdict = adequate_as(held.verdict, final.verdict)
    before = {
        "verdict": held.record["verdict"]["status"],
        "predictions": held_out(held.record),
        "parameters": held.record["steps"][held.record["main"]]["parameters"],
    }
    wall_time = held.record["wall_time_s"] + final.record["wall_time_s"]
    record = final.record | {
        "verdict": verdict_record(verdict),
        HELD_OUT: before,
        "wall_time_s": round(wall_time, 2),
    }
    return replace(final, record=record)


def adequate_as(held: Verdict, final: Verdict) -> Verdict:
    """The verdict on a posterior whose model was found adequate, or not, on held-out tests.

    Findings of convergence and of identifiability are the final posterior's. Of each finding of
    model adequacy the worse one counts, and of equal ones that of the held-out answer.
    """
    adequacy = {finding.code: finding for finding in held.findings if finding.code in ASKED["law"]}
    findings = [_worse(adequacy.pop(finding.code, None), finding) for finding in final.findings]
    return judge([*findings, *adequacy.values()])


def _worse(held: Finding | None, final: Finding) -> Finding:
    if held is None:
        return final
    return min(held, final, key=lambda finding: WORST_FIRST.index(finding.status))
