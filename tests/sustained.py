r"""The periodic motion of a mode by scipy alone: shooting with negative damping that sustains it.

$$\ddot q_i + 2(\zeta_i\omega_i - \zeta\omega)\dot q_i + \omega_i^2 q_i
  + \sum_j H_{ji}(Z_j - \alpha_j x_j) = 0, \qquad
  \dot Z_j = \alpha_j v_j - \gamma_j|v_j|Z_j - \delta_j v_j|Z_j|, \qquad x_j = \sum_i H_{ji} q_i$$

The motion half a period after a state is its negative; omega and zeta are such that the mode's own
coordinate has a first harmonic a without a sine.
"""

from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import root

RTOL = 1e-10  # of the integration


class Sustained(NamedTuple):
    """A mode at an amplitude: each joint's loss per cycle over 4 pi E, and its share in the energy.

    E is twice the mean kinetic energy, which is the largest energy of harmonic motion.
    """

    omega: float
    zeta: float
    damping: np.ndarray
    energy: np.ndarray


class _Half(NamedTuple):
    """Half a period of motion: the deviation from a solution, and integrals over it."""

    missing: np.ndarray
    lost: np.ndarray
    stored: np.ndarray
    kinetic: float


def sustained(model, bolts, amplitudes, mode):
    """Return a mode of a reduced model with Bouc-Wen bolts, at rising amplitudes."""
    start, motions = None, []
    for a in amplitudes:
        start = _first(model, mode) if start is None else start

        def missing(x, a=a):
            return _half_period(model, bolts, a, mode, x).missing

        solved = root(missing, start, tol=1e-8, options={"eps": 1e-10, "factor": 1.0})
        if not np.max(np.abs(missing(solved.x))) < 1e-7:
            raise RuntimeError(solved.message)
        start, half = solved.x, _half_period(model, bolts, a, mode, solved.x)
        omega, zeta = start[-2] * model.omega[mode], start[-1]
        # E over half a period is the mean of sum q'^2, here the integral over pi / omega.
        energy = half.kinetic / (np.pi / omega)
        motions.append(
            Sustained(omega, zeta, 2 * half.lost / (4 * np.pi * energy), half.stored / half.kinetic)
        )
    return motions


def _first(model, mode):
    """Return the linear motion with fully stuck joints, from its largest displacement."""
    num, moved = len(model.omega), np.abs(model.H)
    z = moved[:, mode] / moved.max(axis=1)
    rates = [1.0, model.zeta[mode]]
    return np.concatenate([np.eye(num)[mode], np.zeros(num), z, rates])


def _half_period(model, bolts, a, mode, x):
    """Integrate half a period from scaled q/a, q'/(a w), Z/(alpha a H), w/w_mode and zeta."""
    num = len(model.omega)
    H, omega_n, zeta_n = model.H, np.asarray(model.omega), np.broadcast_to(model.zeta, num)
    alpha, delta, gamma = np.array(bolts).T
    omega, zeta = x[-2] * omega_n[mode], x[-1]
    unit = alpha * np.abs(H).max(axis=1) * a
    stiffness = np.array([joint.stiffness for joint in model.joints])
    begin = np.concatenate(
        [
            a * x[:num],
            a * omega_n[mode] * x[num : 2 * num],
            np.sign(H[:, mode]) * unit * x[2 * num : -2],
        ]
    )

    def slope(tau, state):
        q, v, z = state[:num], state[num : 2 * num], state[2 * num : 2 * num + len(alpha)]
        move, speed = H @ q, H @ v
        r = z - alpha * move
        push = -2 * (zeta_n * omega_n - zeta * omega) * v - omega_n**2 * q - r @ H
        rate = alpha * speed - gamma * np.abs(speed) * z - delta * speed * np.abs(z)
        wave = [q[mode] * np.cos(tau), q[mode] * np.sin(tau)]
        inside = (stiffness * move + r) * move
        return np.concatenate(
            [v / omega, push / omega, rate / omega, wave, r * speed / omega, inside / omega,
             [v @ v / omega]]
        )  # fmt: skip

    size = 2 * num + len(alpha)
    first = np.concatenate([begin, np.zeros(2 + 2 * len(alpha) + 1)])
    scale = np.concatenate([np.full(num, a), np.full(num, a * omega_n[mode]), unit])
    rest = np.concatenate([[a, a], *[unit**2 / alpha] * 2, [a**2 * omega_n[mode]]])
    end = solve_ivp(
        slope, (0.0, np.pi), first, method="DOP853", rtol=RTOL,
        atol=RTOL * np.concatenate([scale, rest]),
    ).y[:, -1]  # fmt: skip
    wave = end[size : size + 2] * 2 / np.pi / a - [1.0, 0.0]
    lost, stored = end[size + 2 : -1].reshape(2, -1)
    apart = (end[:size] + begin) / scale
    return _Half(np.concatenate([apart, wave]), lost, stored, end[-1])
