"""Width of a resonance at half its power, read off a receptance."""

import numpy as np
from numpy.typing import NDArray


def half_power_bandwidth(freq: NDArray[np.float64], h: NDArray[np.complex128]) -> float:
    """Width of the highest peak at half its power [Hz]; infinite when it does not fall so low.

    Args:
        freq: Frequencies [Hz].
        h: Receptance.

    Returns:
        Width between the two crossings, linear between lines [Hz].
    """
    power = np.abs(h) ** 2
    top = int(np.argmax(power))
    below = power < power[top] / 2
    left, right = np.flatnonzero(below[:top]), np.flatnonzero(below[top:])
    if not (left.size and right.size):
        return np.inf

    def crossing(inside: int, outside: int) -> float:
        part = (power[inside] - power[top] / 2) / (power[inside] - power[outside])
        return freq[inside] + part * (freq[outside] - freq[inside])

    i, j = int(left[-1]), top + int(right[0])
    return float(crossing(j - 1, j) - crossing(i + 1, i))
