"""Whether the levels that tests state go as their records do: a larger level, a larger motion."""

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from jbw.campaign.tables import TestSpec
from jbw.measurement.checks import Fault, doubt
from jbw.measurement.records import INPUTS, Record

APART = 1.5  # between two levels, and between two records: less is how a rig holds a level


class Level(NamedTuple):
    """The level of a test, and what its first record holds."""

    test: str
    alike: tuple[str, ...]  # kind and channels, among which levels are compared
    role: str  # of the source
    level: float
    source_rms: float
    response_rms: float


def level_of(record: Record, test: TestSpec) -> list[Level]:
    """The level of a driven test, where it states one."""
    driven = any(role in record.channels for role in INPUTS)
    if not (test.level > 0 and driven) or not record.num_samples:
        return []
    source, response = (
        float(np.sqrt(np.nanmean(np.square(record.channels[role]))))
        for role in (record.source, record.response)
    )
    setup = (test.kind, record.source, record.response, test.driven_by, test.point)
    return [Level(test.name, setup, record.source, test.level, source, response)]


def against_levels(levels: Sequence[Level]) -> Iterator[tuple[str, Fault]]:
    """Tests of a larger level than another's, but of a smaller drive and a smaller response."""
    for first, second in combinations(levels, 2):
        low, high = sorted((first, second), key=lambda level: level.level)
        apart = high.level > APART * low.level and low.alike == high.alike
        turned = low.source_rms > APART * high.source_rms
        if apart and turned and low.response_rms > high.response_rms:
            yield (
                high.test,
                doubt(
                    high.role,
                    f"The `level` of test `{high.test}` is {high.level / low.level:.3g} times that "
                    f"of `{low.test}`, but its drive is {low.source_rms / high.source_rms:.3g} "
                    "times as small, and its response smaller.",
                    "The levels, or the files, of the two tests are exchanged.",
                    "State the level that each test was measured at.",
                ),
            )
