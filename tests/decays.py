"""Free decays made without jbw: DOP853 on the equations, a second mode, noise."""

from functools import cache

import numpy as np
from scipy.integrate import solve_ivp

from jbw.measurement.records import Record, Test

FS, BAND, SETTLE, DURATION = 512.0, (14.0, 26.0), 0.25, 9.0
OMEGA_N, ZETA, SOFTENING, OPENING, SHARE = 2 * np.pi * 20.3, 1.2e-3, 14.0, 5.0, 0.15
TRUTH = {
    "omega_n": OMEGA_N,
    "zeta": ZETA,
    "softening": SOFTENING,
    "opening": OPENING,
    "share": SHARE,
}
# Displacement [m] and velocity [m/s] after each impact: strong and weak, at every phase.
STATES = ((2.0e-3, 0.0), (-1.0e-3, 0.16), (0.3e-3, -0.2), (-1.1e-3, -0.05))


@cache
def free_velocity(
    y0: float, v0: float, duration: float = DURATION, shift: float = 0.0
) -> np.ndarray:
    """Return the velocity after an impact that leaves (y0, v0) and an unstrained joint."""
    omega_n = OMEGA_N * (1 + shift)
    alpha = SHARE * omega_n**2
    delta, gamma = SOFTENING / SHARE, OPENING / SHARE
    k = omega_n**2 - alpha

    def rate(_, state):
        y, v, z = state
        dz = alpha * v - gamma * abs(v) * z - delta * v * abs(z)
        return v, -2 * ZETA * omega_n * v - k * y - z, dz

    t = np.arange(round(duration * FS)) / FS
    found = solve_ivp(rate, (0, t[-1]), (y0, v0, alpha * y0), "DOP853", t, rtol=1e-9, atol=1e-12)
    return found.y[1]


def decay_test(
    states=STATES, noise: float = 2e-4, second: float = 0.3, shifts=None, seed: int = 1
) -> Test:
    """Return a test of decays: the joint's mode, a second one near 47 Hz, white noise [m/s]."""
    rng = np.random.default_rng(seed)
    shifts = np.zeros(len(states)) if shifts is None else shifts
    records = []
    for (y0, v0), shift in zip(states, shifts, strict=True):
        v = free_velocity(y0, v0, shift=shift)
        t = np.arange(len(v)) / FS
        other = second * OMEGA_N * np.hypot(y0, v0 / OMEGA_N) * np.exp(-1.5 * t)
        v = v + other * np.cos(2 * np.pi * 47.0 * t + rng.uniform(0, 6))
        v = v + noise * rng.standard_normal(len(v))
        records.append(Record(FS, {"velocity": v}, {"velocity": "m/s"}))
    return Test("decay", tuple(records), "impacts", band_hz=BAND, settle=SETTLE)
