"""`jbw.identify`: a campaign in, a posterior with its verdict, bands and report out."""

import logging
import sys
from collections.abc import Mapping
from time import perf_counter

import xarray as xr

from jbw.campaign.loading import Campaign, force_per_unit
from jbw.identification.procedure import Report, run_procedure
from jbw.inference.keeping import Keep, nowhere
from jbw.inference.precision import require_float64
from jbw.study.collecting import collect
from jbw.study.identifiability import look_again
from jbw.study.identifiability_record import as_group
from jbw.study.judging import judged
from jbw.study.steps import steps_group
from jbw.study.study import Study
from jbw.study.summary import summarise_study

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
    seed = int(campaign.settings.get("seed", 0)) if seed is None else seed
    found = run_procedure(
        campaign.tests, campaign.settings,
        gain=force_per_unit(campaign), seed=seed, report=report, keep=keep,
    )  # fmt: skip
    known = look_again(found, campaign.settings, report)
    tree = collect(campaign.tests, found, seed, truth, report, campaign.settings)
    found = judged(found, tree)
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


def input_hashes(campaign: Campaign) -> dict[str, str]:
    """File to hash, of everything that was read.

    Args:
        campaign: The campaign.
    """
    records = [record for test in campaign.tests for record in test.records]
    known = [r.provenance for r in records if "sha256" in r.provenance]
    return {one.get("path", ""): one["sha256"] for one in known}
