"""The displacement in Bouc-Wen's law in closed form, by mpmath, to check free exponents."""

import mpmath as mp


def way(c, w, nu):
    """Return the displacement after which the spring is stretched by w, for dw/dy = 1 - c w^nu."""
    if nu == 1:
        return -mp.log(1 - c * w) / c
    if nu == 2:
        root = mp.sqrt(abs(c))
        return (mp.atanh if c > 0 else mp.atan)(root * w) / root
    root = mp.sqrt(w)  # for the exponent 1/2, by r = sqrt(w)
    return -2 * (root / c + mp.log(1 - c * root) / c**2)
