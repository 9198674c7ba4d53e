r"""Samples that do not follow from those before them, as those of any sum of modes do.

A sum of p decaying lines obeys a recursion of 2 p terms, whose weights all of a record tells,

$$x_n = \sum_{k=1}^{8} w_k\,x_{n-k} + e_n$$

so that where a block was cut out a few errors e stand far above those of noise around them.
"""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.optimize import minimize_scalar

from jbw.measurement.channels import Reals

FORERUNNERS, MOST_A_PERIOD = 8, 8  # samples that predict the next one, and those of a period
REACH = 2.0  # periods on either side, whose median error is that of noise and of nonlinearity
BREAK, BROKEN = 0.1, 12.0  # error over the rms of the motion there, and over the median error
LOUD_OVER = 5.0  # times that error: a motion below it is lost in noise
FITTED = 100_000  # samples at the most, of which the weights are
MATTERS = 0.03  # of the largest motion, around a sample at the least
SIDE = 2.0  # periods on either side of a break, over which the motion is one tone
SLOWEST, FASTEST, TRIED = 0.6, 1.6, 101  # of the strongest line: frequencies of that tone


def breaks_of(x: Reals, period: float) -> tuple[int, ...]:
    """Samples that theirs before them predict wrongly and no noise explains, the worst first.

    Args:
        x: A channel without its mean.
        period: Of its strongest line, in samples.
    """
    every = max(int(period / MOST_A_PERIOD), 1)
    if every > 1:  # of samples that are close noise is what differs
        x = x[: len(x) // every * every].reshape(-1, every).mean(axis=1)
        period /= every
    reach = int(np.ceil(REACH * period))
    if len(x) < 6 * reach:
        return ()
    past = np.lib.stride_tricks.sliding_window_view(x, FORERUNNERS + 1)
    # What lies around it tells how large a motion, and an error, is there.
    size = np.sqrt(uniform_filter1d(past[:, -1] ** 2, 2 * reach)) + np.finfo(float).tiny
    loud = size > MATTERS * size.max()
    rows = np.flatnonzero(loud)
    rows = rows[:: -(-len(rows) // FITTED)]
    scaled_past = past[rows] / size[rows, None]
    weights = np.linalg.lstsq(scaled_past[:, :-1], scaled_past[:, -1])[0]
    error = np.abs(np.correlate(x, np.append(-weights, 1.0), "valid"))
    around = median_filter(error, 4 * reach + 1, mode="nearest") / 0.6745
    loud &= size > LOUD_OVER * around
    loud[: 2 * reach] = loud[-2 * reach :] = False
    times_noise = error / np.maximum(around, 1e-300)
    broken = np.flatnonzero(loud & (error > BREAK * size) & (times_noise > BROKEN))
    worst_first = broken[np.argsort(-times_noise[broken], kind="stable")]
    return tuple(((worst_first + FORERUNNERS) * every).tolist())


def turn_at(x: Reals, at: int, period: float) -> tuple[float, float] | None:
    r"""Phase by which a tone jumps at a sample [rad], and the rms that the tone leaves, of its own.

    $$x_n = \operatorname{Re}\big[c_\pm\,e^{j \omega n}\big], \quad
      \arg \frac{c_+}{c_-} = \omega\,k$$

    where k samples were cut out between both sides. None where a side reaches beyond the record.
    """
    width, apart = int(np.ceil(SIDE * period)), max(int(period / MOST_A_PERIOD), 1)
    away = np.arange(apart, apart + width)
    n = np.concatenate([-away[::-1], away])
    if at + n[0] < 0 or at + n[-1] >= len(x):
        return None
    y, later = x[at + n], n > 0
    tried = 2 * np.pi / period * np.linspace(SLOWEST, FASTEST, TRIED)
    best = tried[np.argmin([_left_by(omega, n, later, y)[0] for omega in tried])]
    step = tried[1] - tried[0]
    nearest: Any = minimize_scalar(
        lambda omega: _left_by(omega, n, later, y)[0], bounds=(best - step, best + step),
        method="bounded",
    )  # fmt: skip
    squares, before, after = _left_by(float(nearest.x), n, later, y)
    share = squares / max(float(y @ y), 1e-300)
    return float(np.angle(after * np.conj(before))), float(np.sqrt(share))


def _left_by(
    omega: float, n: Float[np.ndarray, " at"], later: Bool[np.ndarray, " at"], y: Reals
) -> tuple[float, complex, complex]:
    """Squares that a tone on either side leaves, and its complex amplitudes there."""
    wave = np.stack([np.cos(omega * n), -np.sin(omega * n)], axis=-1)
    design = np.concatenate([wave * ~later[:, None], wave * later[:, None]], axis=-1)
    values = np.linalg.lstsq(design, y)[0]
    residual = y - design @ values
    return float(residual @ residual), complex(*values[:2]), complex(*values[2:])
