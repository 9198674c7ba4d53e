r"""The fit of a force loop by sliders, a dashpot and springs, without a law of the joint.

$$F(y, t) = \sum_i w_i f_i(y) + w \dot y + \sum_j c_j s_j(y) + c_0 + c_1 t, \qquad w_i, w \ge 0$$

A slider of half width d behind a gap g has the play p of half width g + d and the force
$f = \mathrm{sgn}(y - p)\,(|y - p| - g)_+$; here g = 0. Springs s are powers, and contacts behind a
gap on one side or both. Sound loops of every law of `benchmarks/outside` leave at most 0.6 % of
the rms of their force beyond noise.

Reference:
    Visintin (1994), Differential Models of Hysteresis; Lawson and Hanson (1974), Solving Least
    Squares Problems.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls

from jbw.measurement.channels import Reals

# number of sliders, and their smallest half width divided by the largest motion
NUM_SLIDERS, SHORTEST = 48, 0.01
POWERS = (1, 2, 3, 4, 5)  # powers of the displacement in the forces of springs
ONE_SIDED = (0.2, 0.4, 0.6, 0.8)  # gaps of one-sided contacts, divided by the largest motion
TWO_SIDED = (0.1, 0.3, 0.5, 0.7)
MOST_SAMPLES = 5000  # largest number of samples that are used; a longer loop is thinned

Columns = Float[np.ndarray, "sample column"]


class LoopBasis(NamedTuple):
    """Forces along a motion per unit strength: sliders and a dashpot; springs and a constant."""

    losses: Columns
    springs: Columns


class LoopFit(NamedTuple):
    """The residual of a force fitted by sliders, springs and extra columns, with coefficients."""

    residual: Reals
    beside: Reals

    @property
    def square(self) -> float:
        """The sum of squares of the residual."""
        return float(self.residual @ self.residual)


def slider_columns(y: Reals, half_widths: Reals, gaps: Reals | float = 0.0) -> Columns:
    """Return the forces of sliders of unit strength along a motion from rest, one column each."""
    reach = gaps + half_widths
    play, columns = np.zeros_like(reach), np.empty((len(y), len(reach)))
    for k, position in enumerate(y):
        play = np.clip(play, position - reach, position + reach)
        apart = position - play
        columns[k] = np.sign(apart) * np.maximum(np.abs(apart) - gaps, 0.0)
    return columns


def basis_of(y: Reals) -> LoopBasis:
    """Return the columns of unit forces along a motion, each scaled to about one."""
    largest = float(np.max(np.abs(y - y[0])))
    # A slider as wide as the motion would never slip and thus be a spring.
    half_widths = largest * np.geomspace(SHORTEST, 1.0, NUM_SLIDERS + 1)[:-1]
    sliders = slider_columns(y - y[0], half_widths) / largest
    u = y / max(float(np.max(np.abs(y))), largest)
    springs = [
        *(u**power for power in POWERS),
        *(np.maximum(side * u - gap, 0.0) for side in (1, -1) for gap in ONE_SIDED),
        *(np.sign(u) * np.maximum(np.abs(u) - gap, 0.0) for gap in TWO_SIDED),
        np.ones_like(u), np.linspace(0.0, 1.0, len(u)),
    ]  # fmt: skip
    rate = np.gradient(y) / np.max(np.abs(np.diff(y)))
    return LoopBasis(np.column_stack([sliders, rate]), np.stack(springs, axis=1))


def fit_loop(basis: LoopBasis, force: Reals, beside: Sequence[Reals] = ()) -> LoopFit:
    """Fit losses, springs and extra columns to a force by least squares.

    Springs and extra columns may have any sign: they are projected out before the strengths of the
    losses, none negative, are determined.
    """
    free = np.column_stack([basis.springs, *beside])
    orthonormal, upper = np.linalg.qr(free)
    both = np.column_stack([basis.losses, force])
    away = both - orthonormal @ (orthonormal.T @ both)
    # The triangular factor keeps the sums of squares, but has only as many rows as columns.
    triangle = np.linalg.qr(away, mode="r")
    strengths, _ = nnls(triangle[:, :-1], triangle[:, -1])
    residual = away[:, -1] - away[:, :-1] @ strengths
    of_free = force - basis.losses @ strengths
    values = np.linalg.lstsq(upper, orthonormal.T @ of_free)[0]
    return LoopFit(residual, values[basis.springs.shape[1] :])
