"""A first reading of the joint from frequency and damping against amplitude, no model run."""

from dataclasses import dataclass

import numpy as np

from jbw.measurement.records import Test
from jbw.observables.decay import LETTER, readings


@dataclass(frozen=True)
class FirstReading:
    """Straight lines through frequency and damping against amplitude.

    Attributes:
        omega_n: Natural frequency at small amplitude [rad/s].
        zeta: Damping ratio at small amplitude [-].
        softening: alpha delta / omega_n^2 [1/m].
        opening: alpha gamma / omega_n^2 [1/m].
        y_peak: Largest displacement read [m].
        zeta_range: Least and largest damping read [-].
    """

    omega_n: float
    zeta: float
    softening: float
    opening: float
    y_peak: float
    zeta_range: tuple[float, float]


def first_reading(test: Test) -> FirstReading:
    r"""Read the joint at small amplitude from the decays of a test.

    $$\omega(Y) = \omega_n \left(1 - \frac{2}{3\pi} S Y\right), \qquad
      \zeta(Y) = \zeta + \frac{2}{3\pi} O\, Y$$

    with S and O the softening and the opening over omega_n^2.

    Args:
        test: The decays.

    Returns:
        The reading; softening and opening are not negative.

    Reference:
        Small-amplitude harmonics of the steady loop of Eq. (2).
    """
    found = readings(test)
    frequency = np.concatenate([one.frequency_hz for one in found])
    damping = np.concatenate([one.damping for one in found])
    order = list(LETTER).index(test.records[0].response)
    size = np.concatenate([one.amplitude for one in found])
    y = size / (2 * np.pi * frequency) ** order
    slope_f, f_0 = np.polyfit(y, frequency, 1)
    slope_z, zeta_0 = np.polyfit(y, damping, 1)
    least, most = float(damping.min()), float(damping.max())
    return FirstReading(
        omega_n=2 * np.pi * float(f_0),
        zeta=float(np.clip(zeta_0, 0.1 * abs(most), abs(most))),
        softening=max(0.0, -1.5 * np.pi * float(slope_f) / float(f_0)),
        opening=max(0.0, 1.5 * np.pi * float(slope_z)),
        y_peak=float(y.max()),
        zeta_range=(max(least, 0.05 * abs(most)), abs(most)),
    )
