"""Periodic records: their steady periods, one by one or in a row."""

from dataclasses import replace

import numpy as np

from jbw.errors import DataError
from jbw.measurement.records import Record, Test


def periods(test: Test) -> Test | None:
    """The steady periods of a multisine as repeats; None where its period is not known.

    `settle` seconds are left out at the start, rounded up to whole periods.

    Args:
        test: Test with the number of periods of its records.

    Raises:
        DataError: A record that cannot be divided into so many periods.
    """
    if test.periods < 2:
        return None
    records = []
    for record in test.records:
        size, skipped = _layout(record, test)
        records += [_cut(record, i * size, size) for i in range(skipped, test.periods)]
    return replace(test, records=tuple(records))


def steady(test: Test) -> tuple[Test, int] | None:
    """Every record without its transient periods, and the samples of a period; None as above."""
    if test.periods < 2:
        return None
    records, size = [], 0
    for record in test.records:
        size, skipped = _layout(record, test)
        records.append(_cut(record, skipped * size, (test.periods - skipped) * size))
    return replace(test, records=tuple(records)), size


def _layout(record: Record, test: Test) -> tuple[int, int]:
    """Samples of a period, and periods to skip."""
    size, rest = divmod(record.num_samples, test.periods)
    if rest:
        raise DataError(
            f"Record `{record.name}` must hold {test.periods} whole periods, but its "
            f"{record.num_samples} samples cannot be divided so.",
            remedy="Correct `periods`, or cut the record with `span`.",
        )
    # A settle of whole periods may come out a hair longer than them.
    skipped = int(np.ceil(test.settle * record.fs / size - 1e-6))
    if skipped >= test.periods:
        raise DataError(
            f"Key `settle` must leave a whole period of record `{record.name}`, but "
            f"{test.settle:g} s reach into the last of its {test.periods} periods of "
            f"{size / record.fs:.4g} s.",
            remedy="Shorten `settle`, or measure more periods.",
        )
    return size, skipped


def _cut(record: Record, start: int, size: int) -> Record:
    channels = {role: x[start : start + size] for role, x in record.channels.items()}
    return replace(record, channels=channels)
