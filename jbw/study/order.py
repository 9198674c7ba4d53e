"""The request for an identification."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from jbw.campaign.load import Campaign, with_laws


@dataclass(frozen=True)
class Order:
    """The request for an identification: campaign, seed, true parameters and command.

    Attributes:
        campaign: What is identified.
        seed: Of everything random.
        truth: True parameters of a virtual joint, written beside the results.
        command: What was typed; that of this process when None.
        started: The `perf_counter()` of the beginning.
    """

    campaign: Campaign
    seed: int
    truth: Mapping[str, float] | None
    command: str | None
    started: float

    def under(self, laws: Sequence[str]) -> "Order":
        """Return the order with the laws that are identified, where its campaign states none."""
        return replace(self, campaign=with_laws(self.campaign, laws))
