"""The initial state of each mode of a free decay, estimated from the mode's envelope."""

import numpy as np
from jaxtyping import Complex

from jbw.measurement.envelopes import envelopes, filter_of
from jbw.measurement.records import Test
from jbw.quantities import derivative_order

LEAST = 4  # smallest number of independent values from which an initial state is estimated


def starts_of(test: Test) -> Complex[np.ndarray, " record"]:
    r"""Return each record's initial state $q(0) + j\,\dot q(0)/\omega$ [m] in one mode.

    The envelope's logarithm is extrapolated by a straight line to the first sample, which the
    filter does not reach.
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
