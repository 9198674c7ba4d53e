"""What a finished run's folder says of its campaign, its prior and Step 3."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jbw.campaign.loading import Campaign
from jbw.errors import ConfigError
from jbw.identification.posteriors import Known
from jbw.report.result import node, read_result
from jbw.study.identify import input_hashes


def campaign_of(folder: Path, stated: Path | None = None) -> Path:
    """The campaign file of a run's folder.

    Args:
        folder: The run's folder.
        stated: What the user says it is.

    Raises:
        ConfigError: If neither the user nor the folder says which it is.
    """
    summary, _ = read_result(folder)
    within = sorted(folder.glob("*/campaign.toml"))
    candidates = [stated, summary.get("campaign_file"), *within]
    for found in candidates:
        if found is not None and (folder / found).is_file():
            return folder / found
        if found is not None and Path(found).is_file():
            return Path(found)
    raise ConfigError(
        f"The run in {folder} does not say where its campaign file is.",
        why="The likelihood has to be built again from the records.",
        remedy="Give it with --campaign, or compare on the campaign: jbw compare CAMPAIGN.toml.",
    )


def known_of(folder: Path) -> tuple[dict[str, Any], Known]:
    """The summary of a run, and what its posterior knows of priors and of Step 3.

    Args:
        folder: The run's folder.
    """
    summary, tree = read_result(folder)
    bounds, means = {}, {}
    if summary["main"] == "joint" and "posterior" in tree.children:
        for name, values in tree["posterior"].data_vars.items():
            if "lower" in values.attrs:
                bounds[str(name)] = float(values.attrs["lower"]), float(values.attrs["upper"])
    third_order = node(tree, "steps/third_order_nuts/posterior")
    if third_order is not None:
        means = {str(name): float(values.mean()) for name, values in third_order.data_vars.items()}
    return summary, Known(bounds, means)


def require_same_inputs(campaign: Campaign, summary: Mapping[str, Any]) -> None:
    """Refuse a campaign whose records are not those of the run.

    Args:
        campaign: The campaign.
        summary: The run's summary; empty when there is no run.

    Raises:
        ConfigError: If a record differs.
    """
    now, then = set(input_hashes(campaign).values()), set(summary.get("inputs", {}).values())
    if then and now != then:
        raise ConfigError(
            f"The campaign {campaign.name} has other records than the run: {len(now - then)} of "
            f"its {len(now)} files are new or were changed.",
            remedy="Give the run's campaign with --campaign, or compare on the campaign alone.",
        )
