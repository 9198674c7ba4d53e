"""Roots of many functions at once, each between two given ends."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]


def bracketed_root(
    function: Callable[[Values], Values], lower: Values, upper: Values, rounds: int = 60
) -> Values:
    """Return the root of each function between two ends of opposite sign, by Chandrupatla's rule.

    The rule uses inverse quadratic interpolation where it is safe, and halves the bracket
    elsewhere. It stops when every bracket is as narrow as a few units of round-off.

    Args:
        function: Function that is evaluated elementwise, at one point of every bracket.
        lower: Lower ends; NaN where there is no bracket.
        upper: Upper ends, of the same shape.
        rounds: Largest number of evaluations.

    Returns:
        The roots; NaN where an end is NaN or both ends have the same sign.

    Reference:
        T. R. Chandrupatla, Advances in Engineering Software 28 (1997) 145-149.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return _searched(function, lower, upper, rounds)


def _searched(
    function: Callable[[Values], Values], lower: Values, upper: Values, rounds: int
) -> Values:
    x1, x2 = np.array(lower, float), np.array(upper, float)
    f1, f2 = function(x1), function(x2)
    has_root = np.sign(f1) * np.sign(f2) <= 0
    step = np.full_like(x1, 0.5)
    for _ in range(rounds):
        x = x1 + step * (x2 - x1)
        f = function(x)
        same = np.sign(f) == np.sign(f1)
        x3, f3 = np.where(same, x1, x2), np.where(same, f1, f2)
        x2, f2 = np.where(same, x2, x1), np.where(same, f2, f1)
        x1, f1 = x, f
        best = np.where(np.abs(f1) < np.abs(f2), x1, x2)
        least = 0.5 * (4e-16 * np.abs(best) + 1e-300) / np.abs(x2 - x1)
        if np.all((least > 0.5) | (f1 == 0.0) | (f2 == 0.0) | ~has_root):
            break
        xi, phi = (x1 - x2) / (x3 - x2), (f1 - f2) / (f3 - f2)
        is_safe = (phi**2 < xi) & ((1.0 - phi) ** 2 < 1.0 - xi)
        quadratic = f1 / (f2 - f1) * f3 / (f2 - f3)
        quadratic += (x3 - x1) / (x2 - x1) * f1 / (f3 - f1) * f2 / (f3 - f2)
        step = np.clip(np.where(is_safe, quadratic, 0.5), least, 1.0 - least)
    return np.where(has_root, best, np.nan)
