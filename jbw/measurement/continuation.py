"""A record continued beyond its ends by linear prediction, so that filters find no edge."""

import numpy as np
from numpy.typing import NDArray
from scipy import signal

ORDER = 64  # poles: thirty tones or so
RECENT = 2048  # samples next to an end from which it is predicted


def continued(x: NDArray[np.float64], reach: int) -> NDArray[np.float64]:
    """Samples with `reach` predicted ones before and after, fading to the record's mean.

    Sums of steady or decaying tones continue as they were; what cannot be predicted fades out.

    Args:
        x: Samples, shape (..., time).
        reach: Samples to add at each end.

    Returns:
        Samples, shape (..., time + 2 reach).
    """
    mean = x.mean(axis=-1, keepdims=True)
    fade = np.cos(np.linspace(0, np.pi / 2, reach)) ** 2
    rows = (x - mean).reshape(-1, x.shape[-1])
    extended = [
        np.concatenate(
            [(fade * _predicted(row[::-1], reach))[::-1], row, fade * _predicted(row, reach)]
        )
        for row in rows
    ]
    return np.reshape(extended, (*x.shape[:-1], -1)) + mean


def _predicted(x: NDArray[np.float64], num_samples: int) -> NDArray[np.float64]:
    """What follows the samples when they go on as an autoregressive process."""
    order = min(ORDER, len(x) // 3)
    coefficients = burg(x[-RECENT:], order)
    state = signal.lfiltic([1.0], coefficients, x[: -order - 1 : -1])
    return signal.lfilter([1.0], coefficients, np.zeros(num_samples), zi=state)[0]


def burg(x: NDArray[np.float64], order: int) -> NDArray[np.float64]:
    """Coefficients (1, a_1, ..., a_p) of sum_i a_i x[n - i] = e[n] by Burg's method: stable.

    Args:
        x: Samples, shape (time,).
        order: Order p.

    Returns:
        The p + 1 coefficients.

    Reference:
        J. P. Burg, Maximum entropy spectral analysis, PhD thesis, Stanford (1975).
    """
    forward, backward = x[1:], x[:-1]
    a = np.ones(1)
    for _ in range(order):
        power = forward @ forward + backward @ backward
        k = -2 * (forward @ backward) / power if power > 0 else 0.0
        a = np.append(a, 0.0)
        a = a + k * a[::-1]
        forward, backward = (forward + k * backward)[1:], (backward + k * forward)[:-1]
    return a
