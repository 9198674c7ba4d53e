"""The Cramer-Rao bound of frequency and damping: the best accuracy that white noise permits."""

from dataclasses import replace

import numpy as np

from .records import Drawn
from .simulator import Array, Plant, free_decay, march, substeps_of

STEP = 1e-3  # relative change of the damping ratio for a derivative


def bound(drawn: Drawn) -> tuple[float, float]:
    """Return the least possible standard deviations of frequency [Hz] and damping ratio.

    The law is taken as known: unknown are omega_n, zeta, and the state at the start of a decay or
    the gain of a driven record. Noise is that of the record and of its converter, white.
    """
    order, size = drawn.order, np.max(np.abs(drawn.x))
    variance = (drawn.noise * size) ** 2
    if drawn.bits < 24:
        variance += (1.5 * size / 2 ** (drawn.bits - 1)) ** 2 / 12
    if variance == 0:
        return 0.0, 0.0
    plant, step = drawn.plant, STEP * drawn.zeta

    def slope(**by: float) -> Array:
        up, down = (
            replace(plant, **{name: getattr(plant, name) + sign * d for name, d in by.items()})
            for sign in (1, -1)
        )
        return (_motion(up, drawn)[order] - _motion(down, drawn)[order]) / (2 * step)

    motion = _motion(plant, drawn)
    nuisances = [motion[order]]
    if drawn.kind == "decay":
        # The initial state may be later and larger.
        nuisances.append(np.gradient(motion[order]))
    # The damping ratio refers to the plant's own frequency, which changes with omega_n.
    columns = np.stack([slope(omega_n=step), slope(zeta=step), *nuisances])
    scale = size / max(float(np.max(np.abs(motion[order]))), 1e-300)
    information = (columns * scale) @ (columns * scale).T / variance
    covariance = np.linalg.pinv(information, hermitian=True, rcond=1e-14)
    sd_omega, sd_zeta = np.sqrt(np.maximum(np.diag(covariance)[:2], 0.0))
    return float(sd_omega * drawn.hz), float(sd_zeta)


def _motion(plant: Plant, drawn: Drawn) -> Array:
    """Return displacement, velocity and acceleration as the record was made, but for its start."""
    count = len(drawn.x)
    if drawn.kind == "decay":
        return free_decay(plant, count, drawn.per_period, (drawn.top, 0.0))[:3]
    sub, n = substeps_of(drawn.per_period), np.arange(count)
    u = drawn.channels["force"] / (drawn.mass * drawn.length * (2 * np.pi * drawn.hz) ** 2)
    fine = np.interp(np.arange(2 * sub * (count - 1) + 1) / (2 * sub), n, u)
    return march(plant, fine, drawn.per_period / (2 * np.pi), sub)[:3]
