"""The end of every identification: instrument errors, summary, opening sentences, result tree.

With `final = true` two identifications are combined: the posterior of the fit to all tests, and the
model's accuracy on the tests that an earlier fit held out.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from time import perf_counter
from typing import Any

import xarray as xr

from jbw.campaign.load import Campaign
from jbw.identification.assemble import Report, entered
from jbw.identification.instruments import as_recorded, instruments_sentence, sensors_of
from jbw.identification.procedure import Identification
from jbw.identification.selection import fitted_for_use
from jbw.inference.posterior.finding import ASKED, WORST_FIRST, Finding, Verdict, judge
from jbw.inference.posterior.summary import posterior_draws
from jbw.inference.samplers.chunked_run import Keep
from jbw.report.messages import stages as messages
from jbw.report.messages.instruments import BESIDE_MATRICES
from jbw.report.opening import opening
from jbw.results.run import HeldOutAnswer, RunSummary, StoredTest
from jbw.study.assembly_group import GROUP as ASSEMBLY
from jbw.study.assembly_group import assembly_group
from jbw.study.comparisons import Comparisons
from jbw.study.free_group import free_law_groups
from jbw.study.identifiability import as_group
from jbw.study.look import look_groups
from jbw.study.order import Order
from jbw.study.prepared import PreparedTests
from jbw.study.study import Study
from jbw.study.summary import record_of, steps_group, widened_by_instruments
from jbw.verification.predictive_basis import AS_RECORDED

Once = Callable[[Campaign, Keep], Study]


def finished_study(
    order: Order,
    prepared: PreparedTests,
    identification: Identification,
    comparisons: Comparisons,
    *,
    notes: Mapping[str, Any] | None = None,
) -> Study:
    """Return the result of an identification as `posterior.nc` and `summary.json` store it.

    `notes` are additional entries of the summary.
    """
    measured = prepared.measured
    sensors = sensors_of(measured.chosen)
    wide = widened_by_instruments(order.campaign, sensors, identification, order.seed)
    groups = measured_groups(order, prepared, comparisons.tree, wide)
    groups |= free_law_groups(comparisons.without_form)
    tree = xr.DataTree.from_dict(groups)
    summary = record_of(
        order, measured, identification, tree, compared=comparisons.routes, wide=wide,
        look=prepared.look.record, **(notes or {}),
    )  # fmt: skip
    groups["/procedure"] = steps_group(summary)
    more: dict[str, Any] = {"opening": opening(summary, tree)}
    if (known := comparisons.identifiability) is not None:
        groups["/identifiability"] = as_group(known)
        more["identifiability"] = known.stored()
    record = summary.replaced(**more, wall_time_s=round(perf_counter() - order.started, 2)).plain()
    return Study(xr.DataTree.from_dict(groups), record, order.campaign, identification)


def measured_groups(
    order: Order, prepared: PreparedTests, tree: xr.DataTree, wide: xr.Dataset | None
) -> dict[str, xr.Dataset]:
    """Return the groups of `posterior.nc` by path; add measured curves and instrument errors.

    `wide` is the main posterior with the stated instrument errors; None where none are stated.
    """
    groups: dict[str, xr.Dataset] = {str(path): group for path, group in tree.to_dict().items()}
    if wide is not None:
        recorded = posterior_draws(tree)
        widened = {n: wide[n].assign_attrs(x.attrs) for n, x in recorded.data_vars.items()}
        groups[f"/{AS_RECORDED}"] = as_recorded(recorded, wide)
        groups["/posterior"] = recorded.assign(widened)
    groups |= look_groups(prepared.look, entered(prepared.measured))
    if order.campaign.joints is not None:
        modes = tree["joints"].to_dataset()["frequency_hz"].values if "joints" in tree else ()
        groups[f"/{ASSEMBLY}"] = assembly_group(order.campaign.joints.model, tuple(modes))
    return groups


def about_instruments(order: Order, prepared: PreparedTests) -> str:
    """Return the sentence on the sensor and clock errors that the intervals include."""
    if order.campaign.joints is not None:
        return BESIDE_MATRICES
    sensors = sensors_of(prepared.measured.chosen)
    return instruments_sentence(order.campaign.instruments, sensors)


def for_use(once: Once, campaign: Campaign, keep: Keep, report: Report) -> Study:
    """Identify a campaign twice: first with some tests held out, then fitted to all tests.

    `once` makes one identification.

    The posterior is that of all tests. The tests that the first fit held out determine whether the
    model is adequate, which the second fit can no longer show.
    """
    settings = campaign.settings.model_copy(update={"final": False})
    held = once(replace(campaign, settings=settings), keep)
    if not held_out(held.result):
        report(messages.NONE_HELD_OUT)
        return held
    report(messages.FITTING_FOR_USE)
    every = replace(campaign, settings=fitted_for_use(campaign.tests, settings))
    return with_held_out(once(every, lambda name: keep(f"final_{name}")), held)


def held_out(summary: RunSummary) -> dict[str, StoredTest]:
    """Return the predictions of the held-out tests, by test name."""
    return {name: row for name, row in summary.predictions.items() if not row.fitted}


def with_held_out(final: Study, held: Study) -> Study:
    """Return the study fitted to all tests, with the earlier predictions of held-out tests."""
    first, last = held.result, final.result
    before = HeldOutAnswer(
        verdict=first.verdict.status, predictions=held_out(first), parameters=first.parameters
    )
    summary = last.replaced(
        verdict=adequate_as(held.verdict, final.verdict).stored(),
        held_out_answer=before,
        wall_time_s=round((first.wall_time_s or 0.0) + (last.wall_time_s or 0.0), 2),
    )
    return replace(final, record=summary.plain())


def adequate_as(held: Verdict, final: Verdict) -> Verdict:
    """Combine two verdicts: convergence of the final fit, and model adequacy of both fits.

    Findings of convergence and of identifiability are those of the final posterior. Of two findings
    on model adequacy the worse one counts; of equal ones, that on the held-out tests.
    """
    adequacy = {finding.code: finding for finding in held.findings if finding.code in ASKED["law"]}
    findings = [_worse(adequacy.pop(finding.code, None), finding) for finding in final.findings]
    return judge([*findings, *adequacy.values()])


def _worse(held: Finding | None, final: Finding) -> Finding:
    if held is None:
        return final
    return min(held, final, key=lambda finding: WORST_FIRST.index(finding.status))
