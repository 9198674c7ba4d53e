"""Envelopes of free decays in a band: the band's filter, and what is read along them."""

from collections.abc import Sequence

import numpy as np

from jbw.errors import DataError
from jbw.measurement.checks.responses import bandless
from jbw.measurement.demodulation import (
    BandFilter,
    DecayReading,
    band_filter,
    demodulate,
    read_decay,
)
from jbw.measurement.records import Test


def filter_of(test: Test) -> BandFilter:
    """The filter of the band that a test must state."""
    if test.band_hz is None:
        (bandless_fault,) = bandless(test.records[0], test.settle)
        raise DataError(
            f"Test `{test.name}` needs `band`: the frequencies around the one mode of the joint.",
            why="A free decay shows every mode at once.",
            remedy=bandless_fault.remedy,
        )
    return band_filter(test.band_hz, test.records[0].fs)


def envelopes(test: Test) -> list[np.ndarray]:
    """Envelope of every record of a test, at the full sampling rate, after `settle`."""
    chosen = filter_of(test)
    return [
        demodulate(record.channels[record.response][round(test.settle * record.fs) :], chosen)[1]
        for record in test.records
    ]


def readings(test: Test) -> list[DecayReading]:
    """Frequency and damping along every record of a test."""
    chosen = filter_of(test)
    along_records = [
        read_decay(envelope[:: chosen.step], chosen.step_s, chosen.centre_hz)
        for envelope in envelopes(test)
    ]
    return some_readings(test.name, along_records)


def some_readings(name: str, found: list[DecayReading]) -> list[DecayReading]:
    """Readings of the records of a test, of which one at least must fall in the band."""
    if any(len(reading.amplitude) for reading in found):
        return found
    raise DataError(
        f"Test `{name}` must decay in its `band`, but no part of its records is the decay of one "
        "mode there.",
        why="Every piece grows, or is missed by half by an exponential with a slow change.",
        remedy="Correct `band`, or let `settle` begin after the blow.",
    )


def bands_of(modes_hz: Sequence[float], test: Test) -> list[tuple[float, float]]:
    """A band about every mode that no other reaches through its filter [Hz].

    Raises:
        DataError: A mode does not lie in the band of the test, which must state one.
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
