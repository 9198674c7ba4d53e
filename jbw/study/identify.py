"""`jbw.identify`: a campaign in, a posterior with its verdict, bands and report out."""

import logging
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np
import xarray as xr

from jbw.campaign.load import Campaign, force_per_unit
from jbw.identification.procedure import Identification, Report, run_procedure
from jbw.inference.posterior.verdict import judge
from jbw.inference.samplers.checkpointing import Keep, nowhere
from jbw.inference.space.box import require_float64
from jbw.measurement.records import INPUTS, Test
from jbw.quantities import gain_unit
from jbw.study.collect import collect
from jbw.study.identifiability import look_again
from jbw.study.identifiability_record import as_group
from jbw.study.study import Study, input_hashes
from jbw.study.summary import summarise_study
from jbw.verification.findings import prediction_findings

logger = logging.getLogger("jbw")


def identify(
    campaign: Campaign,
    *,
    seed: int | None = None,
    truth: Mapping[str, float] | None = None,
    report: Report = logger.info,
    keep: Keep = nowhere,
    command: str | None = None,
) -> Study:
    """Identify the joint from a campaign: the procedure, verification and validation.

    Args:
        campaign: From `jbw.load_campaign` or the virtual rig.
        seed: Seed of everything random; the campaign's, or 0, when None.
        truth: True parameters of a virtual joint, written beside the results; never used.
        report: Called with one sentence at every stage.
        keep: Where the chains of each posterior outlive the process.
        command: What was typed, for the summary; this process's when None.

    Returns:
        The study.

    Raises:
        ConfigError: A float32 session, or settings that do not fit the tests.
        DataError: Tests that do not allow the procedure.

    Reference:
        Fig. 2, the procedure.
    """
    require_float64()
    started = perf_counter()
    seed = campaign.settings.seed if seed is None else seed
    found = run_procedure(
        campaign.tests, campaign.settings, laws=campaign.laws,
        gain=force_per_unit(campaign), seed=seed, report=report, keep=keep,
    )  # fmt: skip
    with_gain_unit(campaign.tests, found)
    known = look_again(found, campaign.settings, report)
    tree = collect(campaign.tests, found, seed, truth, report, campaign.settings)
    main = found.main
    verdict = judge([*main.verdict.findings, *prediction_findings(tree)])
    found = replace(found, steps={**found.steps, main.name: replace(main, verdict=verdict)})
    record = summarise_study(
        campaign.name, found, tree,
        seed=seed, inputs=input_hashes(campaign), truth=truth,
        command=command or " ".join(["jbw", *sys.argv[1:]]), wall_s=perf_counter() - started,
    )  # fmt: skip
    tree["procedure"] = xr.DataTree(steps_group(record))
    if known is not None:
        tree["identifiability"] = xr.DataTree(as_group(known))
        record["identifiability"] = known.summary()
    return Study(tree, record, campaign, found)


def with_gain_unit(tests: Sequence[Test], found: Identification) -> None:
    """Write the unit of the gain, which the source's unit decides, into every posterior."""
    units = [record.units for test in tests for record in test.records]
    driven = [unit for each in units for role, unit in each.items() if role in INPUTS]
    for step in found.steps.values():
        if driven and "gain" in step.posterior["posterior"]:
            step.posterior["posterior"]["gain"].attrs["units"] = gain_unit(driven[0])


def steps_group(record: Mapping[str, Any]) -> xr.Dataset:
    """What the summary says of each step, for the flow diagram.

    Args:
        record: What `summary.json` holds.

    Returns:
        Over (step): `verdict`, the least effective draws `ess` [-] and the largest `r_hat` [-]; NaN
        where a step drew nothing. No durations: equal runs leave equal groups.
    """
    steps = record["steps"]
    rows = [
        (
            str((step.get("verdict") or {}).get("status", "")),
            _extreme(step, "ess_bulk", min),
            _extreme(step, "r_hat", max),
        )
        for step in steps.values()
    ]
    verdict, ess, r_hat = zip(*rows, strict=True)
    return xr.Dataset(
        {
            "verdict": ("step", np.asarray(verdict, object)),
            "ess": ("step", np.asarray(ess, float), {"units": "1"}),
            "r_hat": ("step", np.asarray(r_hat, float), {"units": "1"}),
        },
        {"step": np.asarray(list(steps), object)},
        {"main": str(record["main"])},
    )


def _extreme(step: Mapping[str, Any], what: str, choose: Callable[..., float]) -> float:
    """Return the worst number of a step's parameters, NaN where none was drawn."""
    values = [facts.get(what) for facts in (step.get("parameters") or {}).values()]
    known = [float(value) for value in values if value is not None]
    return choose(known) if known else float("nan")
