"""`jbw.identify`: a campaign in, a posterior with its verdict, bands and report out."""

import logging
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import xarray as xr

from jbw.campaign.loading import Campaign, force_per_unit
from jbw.identification.procedure import Identification, Report, run_procedure
from jbw.inference.keeping import Keep, nowhere
from jbw.inference.precision import require_float64
from jbw.inference.verdict import Verdict
from jbw.measurement.records import Test
from jbw.study.basis import NUM_DRAWS, Request, basis_of
from jbw.study.collecting import collect
from jbw.study.identifiability import look_again
from jbw.study.identifiability_record import as_group
from jbw.study.judging import judged
from jbw.study.predicting import chosen, predict
from jbw.study.steps import steps_group
from jbw.study.storage import claim, save_run
from jbw.study.summary import summarise_study

logger = logging.getLogger("jbw")


@dataclass(frozen=True)
class Study:
    """Result of `identify`.

    Attributes:
        campaign: What was identified.
        identification: Every step with its fit, posterior and verdict.
        tree: What `posterior.nc` holds: the main posterior in ArviZ's groups at the root, the
            other steps under `steps`, then `verification` and `validation`.
        record: What `summary.json` holds.
    """

    campaign: Campaign
    identification: Identification
    tree: xr.DataTree
    record: dict[str, Any]

    @property
    def posterior(self) -> xr.DataTree:
        """The main posterior, in ArviZ's groups."""
        return self.identification.main.posterior

    @property
    def verdict(self) -> Verdict:
        """The verdict on the main posterior."""
        return self.identification.main.verdict

    def summary(self) -> dict[str, Any]:
        """Every step and parameter in numbers, and in words what is identified."""
        return self.record

    def predict(
        self, test: str | Test, num_draws: int = NUM_DRAWS, *, noise: bool = True
    ) -> xr.Dataset:
        """Bands of the main posterior on any test, beside what was measured.

        Args:
            test: Name of a test of the campaign, or a test of any kind, seen or not.
            num_draws: Draws carried through the model; fewer through long records.
            noise: Whether the bands include the noise, where it is known.

        Returns:
            As `jbw.study.predicting.predict`.

        Raises:
            ConfigError: If the campaign has no test of that name.
            DataError: If the test's source is in another unit than the run's.
        """
        if isinstance(test, str):
            (test,) = chosen(self.campaign.tests, (test,), "Argument `test`")
        return predict(basis_of(self.tree), test, Request(num_draws, noise))

    def save(self, folder: str | Path) -> None:
        """Write posterior.nc, summary.json, figures and report.html into a new or empty folder."""
        save_run(claim(Path(folder)), self.tree, self.record)


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
    return Study(campaign, found, tree, record)


def input_hashes(campaign: Campaign) -> dict[str, str]:
    """File to hash, of everything that was read.

    Args:
        campaign: The campaign.
    """
    records = [record for test in campaign.tests for record in test.records]
    known = [r.provenance for r in records if "sha256" in r.provenance]
    return {one.get("path", ""): one["sha256"] for one in known}
