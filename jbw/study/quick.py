"""The first answer of a campaign: its fit with the bands of the fit's covariance, in seconds."""

from time import perf_counter
from typing import Any

import jax
import xarray as xr

from jbw.identification.assemble import Measured
from jbw.identification.laplace import about_fit
from jbw.identification.prepare import Fitted
from jbw.identification.procedure import Identification
from jbw.observables import dataset
from jbw.report.messages.opening import by_the_fit
from jbw.report.opening import effect_sentence, fit_sentence, known_parameters
from jbw.study.collect import run_attrs
from jbw.study.finishing import about_instruments, finished_study, name_gain_unit, with_main
from jbw.study.identifiability import look
from jbw.study.order import Order, ReadCampaign
from jbw.study.study import Study
from jbw.study.summary import (
    step_record,
    verdict_record,
)
from jbw.verification.backbone import backbone_group
from jbw.verification.predictive_basis import NUM_DRAWS, basis_of


def first_answer(order: Order, read: ReadCampaign, identification: Identification) -> Study:
    """The study of a fit alone: parameters, frequency and damping against amplitude, with bands.

    It has the form of any other study, but no test is predicted in it.
    """
    main, fitted = identification.main, identification.fitted
    statements = (*read.left_out, *main.statements, about_instruments(order, read))
    return finished_study(
        order,
        read,
        with_main(identification, main.verdict, statements),
        fit_tree(read.measured, identification),
        identifiability=None if fitted is None else look(fitted, with_profiles=False),
        notes={"quick": fit_errors(identification)},
    )


def fit_tree(seen: Measured, found: Identification) -> xr.DataTree:
    """Draws about a fit, what predictions start from, and frequency and damping by amplitude."""
    step = found.main
    facts = xr.Dataset(attrs=step.posterior.attrs | run_attrs(seen.tests, found))
    groups = {f"/{name}": node.to_dataset() for name, node in step.posterior.children.items()}
    tree = xr.DataTree.from_dict({"/": facts, **groups})
    basis = basis_of(tree)
    curve = backbone_group(basis.thinned(NUM_DRAWS), basis.y_peak, basis.laws)
    if curve is None:
        return tree
    return xr.DataTree.from_dict({**tree.to_dict(), "/verification/backbone": curve})


def fit_errors(found: Identification) -> dict[str, float]:
    """Error of the fit by group of data, over the rms of the group."""
    if found.data is None:
        return {}
    residuals = dataset.left_by_label(found.main.fit.residual, found.data)
    errors = dataset.error_by_label(residuals, found.data)
    return {label: float(error) for label, error in errors.items()}


def fit_lines(seen: Measured, ready: Fitted, seed: int) -> list[str]:
    """What a fit says while the posterior is yet to be drawn: the lines of a first answer."""
    identification = about_fit(jax.random.key(seed), seen, ready, perf_counter())
    name_gain_unit(seen.tests, identification)
    tree = fit_tree(seen, identification)
    record: dict[str, Any] = {
        "main": "joint",
        "steps": {"joint": step_record(identification.main, {})},
        "verdict": verdict_record(identification.main.verdict),
        "quick": fit_errors(identification),
        "tests": [{"kind": test.kind} for test in seen.tests],
    }
    return [
        by_the_fit(known_parameters(record)),
        effect_sentence(record, tree),
        fit_sentence(record),
    ]
