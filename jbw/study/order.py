"""The request for an identification: what `identify` was asked to do."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from jbw.campaign.load import Campaign, with_laws


@dataclass(frozen=True)
class Order:
    """The request for an identification: its campaign, seed, true parameters and command.

    Attributes:
        campaign: The campaign to identify.
        seed: Seed of all random numbers.
        truth: True parameters of a virtual joint, stored with the results.
        command: The typed command; that of this process when None.
        started: The `perf_counter()` at the beginning.
    """

    campaign: Campaign
    seed: int
    truth: Mapping[str, float] | None
    command: str | None
    started: float

    def under(self, laws: Sequence[str]) -> "Order":
        """Return the request with the given laws, unless its campaign already states laws."""
        return replace(self, campaign=with_laws(self.campaign, laws))
