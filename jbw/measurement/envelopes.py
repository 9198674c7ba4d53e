"""Envelopes of free decays in a band, and the filter for a test's band."""

from collections.abc import Sequence

import numpy as np

from jbw.errors import DataError
from jbw.measurement.demodulation import BandFilter, band_filter, demodulate
from jbw.measurement.faults.responses import bandless
from jbw.measurement.records import Test


def filter_of(test: Test) -> BandFilter:
    """Return the filter of a test's band; raise a DataError if the test states no band."""
    if test.band_hz is None:
        (bandless_fault,) = bandless(test.records[0], test.settle)
        raise DataError(
            f"Test `{test.name}` needs `band`: the frequencies around the one mode of the joint.",
            why="A free decay shows every mode at once.",
            remedy=bandless_fault.remedy,
        )
    return band_filter(test.band_hz, test.records[0].fs)


def envelopes(test: Test) -> list[np.ndarray]:
    """Return the envelope of each record of a test after `settle`, at the full sampling rate."""
    chosen = filter_of(test)
    return [
        demodulate(record.channels[record.response][round(test.settle * record.fs) :], chosen)[1]
        for record in test.records
    ]


def bands_of(modes_hz: Sequence[float], test: Test) -> list[tuple[float, float]]:
    """Return a band [Hz] about each mode that is narrow enough to exclude the other modes.

    Raises:
        DataError: A mode does not lie in the band of the test, or the test states no band.
    """
    low, high = filter_of(test).band_hz
    bands = []
    for hz in modes_hz:
        if not low < hz < high:
            raise DataError(
                f"Test `{test.name}` must have all modes of [structure] in its `band`, {low:g} to "
                f"{high:g} Hz, but {hz:g} Hz is outside.",
                why="The modes of a free decay ring at once, and all move the joint.",
                remedy="Widen `band`, or leave the mode out of `modes`.",
            )
        room = [abs(hz - other) / 2 for other in modes_hz if other != hz]
        half = min(*room, hz - low, high - hz)
        bands.append((hz - half, hz + half))
    return bands
