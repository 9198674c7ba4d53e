"""What an identification was asked for, and the campaign as it was read."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from jbw.campaign.load import Campaign
from jbw.identification.assemble import Measured
from jbw.study.look import Look


@dataclass(frozen=True)
class Order:
    """What an identification was asked for.

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


class ReadCampaign(NamedTuple):
    """A campaign as it was read: what each step takes, a look without a model, what is left out."""

    measured: Measured
    look: Look
    left_out: tuple[str, ...]
