"""The first answer of a campaign: its fit with the bands of the fit's covariance, in seconds."""

from collections.abc import Mapping, Sequence
from time import perf_counter
from typing import Any

import jax
import xarray as xr

from jbw.campaign.load import Campaign
from jbw.identification.assemble import Measured, entered
from jbw.identification.instruments import instruments_sentence, sensors_of
from jbw.identification.laplace import about_fit
from jbw.identification.prepare import Fitted
from jbw.identification.procedure import Identification
from jbw.observables import dataset
from jbw.report.opening import effect_sentence, fit_sentence, known_parameters, opening
from jbw.study.collect import run_attrs
from jbw.study.identifiability import as_group, look
from jbw.study.look import Look, look_groups
from jbw.study.study import Study
from jbw.study.summary import (
    fitted_and_held_out,
    record_of,
    step_record,
    steps_group,
    verdict_record,
    widened_by_instruments,
)
from jbw.verification.backbone import backbone_group
from jbw.verification.predictive_basis import NUM_DRAWS, basis_of


def first_answer(
    campaign: Campaign,
    seen: Measured,
    looked: Look,
    found: Identification,
    *,
    left_out: Sequence[str],
    truth: Mapping[str, float] | None,
    seed: int,
    command: str | None,
    started: float,
) -> Study:
    """The study of a fit alone: parameters, frequency and damping against amplitude, with bands.

    It has the form of any other study, but no test is predicted in it.
    """
    tree = fit_tree(seen, found)
    sensors = sensors_of(seen.chosen)
    record = record_of(
        campaign, found, tree, verdict=found.main.verdict, truth=truth, compared={}, seed=seed,
        command=command, started=started, tests=fitted_and_held_out(seen),
        wide=widened_by_instruments(campaign, sensors, found, seed),
    )  # fmt: skip
    record["steps"]["joint"]["statements"] = [
        *left_out, *found.main.statements, instruments_sentence(campaign.instruments, sensors)
    ]  # fmt: skip
    record |= {"quick": fit_errors(found), "look": looked.record}
    record["opening"] = list(opening(record, tree))
    tree = xr.DataTree.from_dict({**tree.to_dict(), **look_groups(looked, entered(seen))})
    tree["procedure"] = xr.DataTree(steps_group(record))
    if found.fitted is not None:
        known = look(found.fitted, with_profiles=False)
        tree["identifiability"] = xr.DataTree(as_group(known))
        record["identifiability"] = known.summary()
    record["wall_time_s"] = round(perf_counter() - started, 2)
    return Study(tree, record, campaign, found)


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
    left = dataset.left_by_label(found.main.fit.residual, found.data)
    errors = dataset.error_by_label(left, found.data)
    return {label: float(error) for label, error in errors.items()}


def fit_lines(seen: Measured, ready: Fitted, seed: int) -> list[str]:
    """What a fit says while the posterior is yet to be drawn: the lines of a first answer."""
    found = about_fit(jax.random.key(seed), seen, ready, perf_counter())
    tree = fit_tree(seen, found)
    record: dict[str, Any] = {
        "main": "joint",
        "steps": {"joint": step_record(found.main, {})},
        "verdict": verdict_record(found.main.verdict),
        "quick": fit_errors(found),
    }
    known = "; ".join(known_parameters(record)) or "nothing"
    return [
        f"By the fit alone, not assessed: {known}",
        effect_sentence(record, tree),
        fit_sentence(record),
    ]
