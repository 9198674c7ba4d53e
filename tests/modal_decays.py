"""Free decays of two modes with one Bouc-Wen joint: DOP853 on the equations, without jbw."""

from functools import cache

import numpy as np
from scipy.integrate import solve_ivp

from jbw.campaign.settings import Structured
from jbw.measurement.records import Record, Test

FS, BAND, DURATION = 384.0, (12.0, 75.0), 4.0
HZ = (20.3, 53.7)
STATED = Structured(modes=HZ)
OMEGA, ZETA = 2 * np.pi * np.array(HZ), np.array([2.5e-3, 3.0e-3])
H, P = np.array([1.0, -0.8]), np.array([1.0, -1.3])
ALPHA, DELTA, GAMMA = 0.2 * OMEGA[0] ** 2, 340.0, 90.0
# True parameters by the names that a campaign gives them.
TRUTH = {
    "omega_n": OMEGA[0], "zeta": ZETA[0], "alpha": ALPHA, "delta": DELTA, "gamma": GAMMA,
    "omega_2": OMEGA[1], "zeta_2": ZETA[1], "shape_2": 0.8, "coupling_2": 1.3 * 0.8**2,
}  # fmt: skip
HELD = {"gain": 1.0, "gain_ratio_2": 1.0, "sign_2": -1.0}
# (q_1, q_1', q_2, q_2') after each impact [m, m/s]: either mode is louder, at several phases.
STARTS = (
    (2.0e-3, 0.0, 0.4e-3, 0.1), (-0.8e-3, 0.16, -0.7e-3, 0.0),
    (0.3e-3, -0.2, 0.2e-3, -0.25), (-0.5e-3, -0.05, 0.1e-3, 0.02),
)  # fmt: skip


@cache
def free_velocity(start, slips: bool = True, duration: float = DURATION) -> np.ndarray:
    """Return the velocity q_1' + q_2' after an impact that leaves an unstrained joint."""
    alpha = ALPHA if slips else 0.0

    def rate(_, state):
        q, v, z = state[0:4:2], state[1:4:2], state[4]
        x, dx = H @ q, H @ v
        dv = -2 * ZETA * OMEGA * v - OMEGA**2 * q - P * (z - alpha * x)
        dz = alpha * dx - GAMMA * abs(dx) * z - DELTA * dx * abs(z)
        return v[0], dv[0], v[1], dv[1], dz

    t = np.arange(round(duration * FS)) / FS
    q = np.array(start[0:4:2])
    found = solve_ivp(
        rate, (0, t[-1]), (*start, alpha * (H @ q)), "DOP853", t, rtol=1e-9, atol=1e-12
    )
    return found.y[1] + found.y[3]


def modal_decay_test(starts=STARTS, noise=2e-4, slips=True, settle=0.1, seed=1) -> Test:
    """Return a test of decays with both modes and white noise [m/s]."""
    rng = np.random.default_rng(seed)
    records = []
    for start in starts:
        v = free_velocity(start, slips)
        v = v + noise * rng.standard_normal(len(v))
        records.append(Record(FS, {"velocity": v}, {"velocity": "m/s"}))
    return Test("decay", tuple(records), "impacts", band_hz=BAND, settle=settle)
