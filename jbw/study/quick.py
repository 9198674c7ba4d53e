"""The quick result of a campaign, in seconds: its fit, with bands from the fit's covariance."""

from typing import Any

import jax
import numpy as np
import xarray as xr

from jbw.errors import Attempts
from jbw.identification.accuracy import errors_and_colour, misfit_beyond_noise
from jbw.identification.assemble import Measured, Report
from jbw.identification.checks import step_of
from jbw.identification.discrepancy import as_dataset, discrepancy_of_misfit
from jbw.identification.laplace import about_fit, fit_alone
from jbw.identification.prepare import Fitted
from jbw.identification.procedure import Posteriors, identified
from jbw.inference.posterior.finding import judge
from jbw.report.messages import stages
from jbw.report.messages.opening import by_the_fit
from jbw.report.opening import effect_sentence, fit_sentence, known_parameters
from jbw.results.run import RunSummary, StoredTest
from jbw.study.collect import groups_in, run_attrs
from jbw.study.comparisons import Comparisons
from jbw.study.finishing import about_instruments, finished_study
from jbw.study.identifiability import look
from jbw.study.order import Order
from jbw.study.prepared import PreparedTests
from jbw.study.study import Study
from jbw.study.summary import step_record
from jbw.verification.backbone import backbone_group, curves, has_backbone
from jbw.verification.predictive_basis import NUM_DRAWS, basis_of


def first_answer(order: Order, prepared: PreparedTests, report: Report) -> Study:
    """Return the result of a fit without sampling, with Gaussian bands from the fit's covariance.

    The study has the form of any other, but predicts no test.
    """
    measured = prepared.measured
    posteriors = fit_alone(measured, seed=order.seed, report=report, start=prepared.start)
    tree = fit_tree(measured, posteriors)
    comparisons = Comparisons(tree, look(posteriors.joint.fitted, with_profiles=False))
    checks = posteriors.checks
    statements = *prepared.sentences, *checks.statements, about_instruments(order, prepared)
    identification = identified(measured, posteriors, judge(checks.findings), statements)
    notes = fit_notes(posteriors.joint.fitted)
    return finished_study(order, prepared, identification, comparisons, notes=notes)


def fit_tree(seen: Measured, posteriors: Posteriors) -> xr.DataTree:
    """Return the result tree of a fit without sampling: Gaussian draws and the backbone.

    Bands of the backbone and of predictions contain the error of the law if the residual shows one.
    """
    joint = posteriors.joint
    attrs = joint.tree.attrs | run_attrs(seen.tests, joint, posteriors.free.data, seen.rivals)
    parts = {**groups_in(joint.tree), **posteriors.checks.groups}
    groups = {"/": xr.Dataset(attrs=attrs), **{f"/{name}": part for name, part in parts.items()}}
    tree = xr.DataTree.from_dict(groups)
    basis = basis_of(tree)
    draws, y_peak, laws = basis.thinned(NUM_DRAWS), basis.y_peak, basis.laws
    if not has_backbone(draws, y_peak, laws):
        return tree
    _, damping, _ = curves(draws, np.array([0.5 * y_peak]), laws)
    error = misfit_beyond_noise(joint.fitted.fit, joint.fitted.data)
    missed = discrepancy_of_misfit(error, float(np.median(damping)), y_peak)
    added = {
        "/verification/backbone": backbone_group(draws, y_peak, laws, missed),
        "/discrepancy": as_dataset(missed),
    }
    return xr.DataTree.from_dict({**tree.to_dict(), **added})


def fit_notes(fitted: Fitted) -> dict[str, Any]:
    """Return the fit's relative error for each data group, and whether it exceeds noise."""
    errors, found = errors_and_colour(fitted.fit, fitted.data)
    return {
        "quick": {label: float(error) for label, error in errors.items()},
        "exceeds_noise": found is not None and found.status != "ok",
    }


def report_fit(seen: Measured, fitted: Fitted, seed: int, report: Report) -> None:
    """Report the result of the fit, before the posterior is drawn."""
    lines = Attempts(report).make(stages.ANSWER_OF_FIT, lambda: fit_lines(seen, fitted, seed), [])
    for line in (*lines, stages.DRAWING):
        report(line)


def fit_lines(seen: Measured, fitted: Fitted, seed: int) -> list[str]:
    """Return sentences on a fit: its parameters, the effect of the joint, and its errors."""
    posteriors = about_fit(jax.random.key(seed), seen, fitted)
    checks = posteriors.checks
    judged = judge(checks.findings)
    step = step_of(posteriors.joint, checks, judged, checks.statements)
    tree = fit_tree(seen, posteriors)
    summary = RunSummary(
        main="joint",
        steps={"joint": step_record(step, {}, stated=fitted.data.stated)},
        verdict=judged.stored(),
        tests=[StoredTest(kind=test.kind) for test in seen.chosen],
        **fit_notes(fitted),
    )
    return [
        by_the_fit(known_parameters(summary)),
        effect_sentence(summary, tree),
        fit_sentence(summary),
    ]
