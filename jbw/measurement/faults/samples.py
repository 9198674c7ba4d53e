"""Recorder faults seen in samples: values held for several samples, and drop-outs.

The thresholds are calibrated on records of `benchmarks/outside`: none of 1,600 sound records of
four kinds is accused, and nine of ten drop-outs that exceed the noise are detected.
"""

import numpy as np

from jbw.measurement.channels import OF_NORMAL, Reals

# Smallest number of changes of the value. By chance, all of them lie at multiples of a number of
# samples in 2^-24 of the cases.
CHANGES = 24
ORDER = 8  # number of samples from which the next one is predicted
MANY = 2**16  # largest number of samples to which the prediction is fitted
FITS = 4  # number of fits of the prediction, each without the outliers of the previous fit
# Samples beyond this number of robust standard deviations are excluded from the prediction's fit.
OUTLYING = 5.0
FAR = 12.0  # A prediction error beyond this number of robust standard deviations is not noise.
INWARD = 0.45  # largest size of a sample in a drop-out, relative to its predicted value
STRETCHES = 32  # number of segments of a record, each with a separate standard deviation
# smallest number of drop-outs, and their smallest fraction among all outliers
FEWEST, MOST = 5, 0.6


def held_for(x: Reals) -> tuple[int, int]:
    """Return for how many samples each value is held, and the index of the first new value.

    The number is the greatest common divisor of the distances between changes; 1 if nothing is
    held.
    """
    changes = np.flatnonzero(np.diff(x)) + 1
    if len(changes) < CHANGES:
        return 1, 0
    each = int(np.gcd.reduce(np.diff(changes)))
    return each, int(changes[0]) % each


def drop_outs(x: Reals) -> list[int]:
    r"""Return the samples at which a signal drops almost to zero, against its linear prediction.

    $$x_k = \sum_i a_i x_{k-i} + e_k, \qquad |x_k| < 0.45\,|x_k - e_k|, \qquad
      e_k^2 > 12^2 \Bigl(s_k^2 + \tfrac{q^2}{12} \bigl(1 + \sum_i a_i^2\bigr)\Bigr)$$

    where s is the robust scale of e in the segment about k and q the smallest difference of two
    values. The second term is the variance that rounding to q adds; where most samples are rounded
    to zero, s is zero. Impacts push outward as often as inward: if at most 60 % of such samples
    fall inward, the list is empty.
    """
    if len(x) < 16 * ORDER or not np.ptp(x) > 0:
        return []
    unit = x / np.abs(x).max()
    rows = np.lib.stride_tricks.sliding_window_view(unit, ORDER + 1)
    some = rows[:: len(rows) // MANY + 1]
    kept, filtered = np.ones(len(some), bool), np.zeros(ORDER)
    for _ in range(FITS):
        past, now = some[kept, :-1], some[kept, -1]
        ridge = 1e-12 * np.trace(past.T @ past) * np.eye(ORDER)
        filtered = np.linalg.solve(past.T @ past + ridge, past.T @ now)
        error = some[:, -1] - some[:, :-1] @ filtered
        kept = np.abs(error) <= OUTLYING * _scales(error)
    error = rows[:, -1] - rows[:, :-1] @ filtered
    rounding = float(np.min(np.diff(np.unique(unit)))) ** 2 / 12 * (1 + filtered @ filtered)
    far = np.flatnonzero(np.abs(error) > FAR * np.sqrt(_scales(error) ** 2 + rounding))
    # Samples after a faulty sample do not count, because they are predicted from the faulty one.
    first = far[np.diff(far, prepend=-ORDER - 1) > ORDER]
    predicted = rows[first, -1] - error[first]
    inward = np.abs(rows[first, -1]) < INWARD * np.abs(predicted)
    found = (first[inward] + ORDER).tolist()
    return found if len(found) >= max(FEWEST, MOST * len(first)) else []


def _scales(error: Reals) -> Reals:
    """Return, for each sample, the robust standard deviation of the errors in its segment."""
    parts = np.array_split(np.abs(error), min(STRETCHES, max(len(error) // 64, 1)))
    return np.concatenate(
        [np.full(len(part), np.median(part) / OF_NORMAL + 1e-300) for part in parts]
    )
