"""The result of an identification, as it comes from `identify` or from a run's folder."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import xarray as xr

from jbw.campaign.loading import Campaign, load_campaign
from jbw.errors import ConfigError
from jbw.identification.procedure import Identification
from jbw.inference.finding import Finding, Verdict
from jbw.measurement.records import Test
from jbw.report.result import read_result
from jbw.study.basis import NUM_DRAWS, Request, basis_of
from jbw.study.predicting import chosen, predict
from jbw.study.storage import claim, save_run


@dataclass(frozen=True)
class Study:
    """Result of `identify`, or of a run that was saved.

    Attributes:
        tree: What `posterior.nc` holds: the main posterior in ArviZ's groups at the root, the
            other steps under `steps`, then `verification` and `validation`.
        record: What `summary.json` holds.
        campaign: What was identified; None where its file is no longer at hand.
        identification: Every step with its fit and verdict; None for a run that was saved.
    """

    tree: xr.DataTree
    record: dict[str, Any]
    campaign: Campaign | None = None
    identification: Identification | None = None

    @property
    def posterior(self) -> xr.DataTree:
        """The main posterior, in ArviZ's groups at the root."""
        return self.tree

    @property
    def verdict(self) -> Verdict:
        """The verdict on the main posterior."""
        told = self.record["verdict"]
        return Verdict(told["status"], tuple(_finding(one) for one in told["findings"]))

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
            ConfigError: If the campaign has no test of that name, or is not at hand.
            DataError: If the test's source is in another unit than the run's.
        """
        if isinstance(test, str):
            if self.campaign is None:
                raise ConfigError(
                    f"Argument `test` names {test!r}, but the run's campaign is not at hand.",
                    remedy="Pass the test itself, or load the study with `campaign=`.",
                )
            (test,) = chosen(self.campaign.tests, (test,), "Argument `test`")
        return predict(basis_of(self.tree), test, Request(num_draws, noise))

    def save(self, folder: str | Path) -> None:
        """Write posterior.nc, summary.json, figures and report.html into a new or empty folder."""
        save_run(claim(Path(folder)), self.tree, self.record)


def _finding(row: dict[str, Any]) -> Finding:
    """A finding as it is stored; JSON has no NaN."""
    number = float("nan") if row["number"] is None else float(row["number"])
    return Finding(row["code"], row["status"], row["reason"], number, row["action"])


def load_study(folder: str | Path, campaign: Campaign | None = None) -> Study:
    """The result of a run that was saved, by `jbw identify` or `Study.save`.

    Args:
        folder: The run's folder.
        campaign: What was identified; when None, it is read where the run says that its campaign
            file lies and that file is still there.

    Returns:
        The study, which predicts as it did on the day that it was made.

    Raises:
        DataError: The folder holds no finished run, or one that cannot be read.
    """
    record, tree = read_result(Path(folder))
    where = record.get("campaign_file")
    if campaign is None and where is not None and Path(where).is_file():
        campaign = load_campaign(where, allow_outside=True)  # the run was allowed to
    return Study(tree, record, campaign)
