"""Modes that ring at once, read one by one: in which band, and from what start."""

import numpy as np
from jaxtyping import Complex

from jbw.errors import DataError
from jbw.measurement.records import Test
from jbw.observables.decay_envelopes import envelopes, filter_of
from jbw.observables.modes import Modes
from jbw.quantities import derivative_order

LEAST = 4  # independent values that a mode's start is read from


def bands_of(modes: Modes, test: Test) -> list[tuple[float, float]]:
    """A band about every mode that no other reaches through its filter [Hz].

    Raises:
        DataError: A mode does not lie in the band of the test, which must state one.
    """
    low, high = filter_of(test).band_hz
    bands = []
    for hz in modes.hz:
        if not low < hz < high:
            raise DataError(
                f"Test `{test.name}` must have all modes of [structure] in its `band`, {low:g} to "
                f"{high:g} Hz, but {hz:g} Hz is outside.",
                why="The modes of a free decay ring at once, and all move the joint.",
                remedy="Widen `band`, or leave the mode out of `modes`.",
            )
        room = [abs(hz - other) / 2 for other in modes.hz if other != hz]
        half = min(*room, hz - low, high - hz)
        bands.append((hz - half, hz + half))
    return bands


def starts_of(test: Test) -> Complex[np.ndarray, " record"]:
    r"""What one mode begins every record with, $q(0) + j\,\dot q(0)/\omega$, by its envelope [m].

    Its logarithm is continued by a straight line to the first sample, which the filter does not
    reach.
    """
    chosen, starts = filter_of(test), []
    order, nominal = derivative_order(test.records[0].response), np.pi * sum(test.band_hz or ())
    for row in envelopes(test):
        few = row[: LEAST * chosen.step]
        log = np.log(np.abs(few)) + 1j * np.unwrap(np.angle(few))
        t = (chosen.half + np.arange(len(few))) / chosen.fs
        slope, level = np.polyfit(t, log, 1)
        rate = slope + 2j * np.pi * chosen.centre_hz
        q = np.exp(level) / rate**order
        starts.append(q.real + 1j * (rate * q).real / nominal)
    return np.array(starts)
