"""Force loops that slip far, whose secant is a fraction of the joint's stiffness at rest."""

import jax
import numpy as np
import pytest

from jbw.campaign.settings import Identify
from jbw.identification.assemble import assemble, measured
from jbw.identification.coordinates import box_of
from jbw.identification.first_fit import first_fit
from jbw.inference.space.box import bounds_by_name
from jbw.measurement.records import Record, Test
from jbw.observables.drives import told_by

STIFFNESS, ALPHA, DELTA, GAMMA = 4e5, 3.2e5, 400.0, 300.0  # N/m, N/m, 1/m, 1/m
NOISE = 2e-3  # of the largest force


def bouc_wen(y):
    """Z along straight lines, dZ/dy = alpha - (gamma s + delta sgn Z) Z, exactly up to Z = 0."""
    z, values = 0.0, [0.0]
    for step in np.diff(y):
        remaining = step
        while remaining:
            s = np.sign(remaining)
            c = GAMMA * s + DELTA * (np.sign(z) or s)
            # Z falls to zero after this displacement, where s Z < 0.
            zero = abs(np.log1p(-c * z / ALPHA) / c) if s * z < 0 else np.inf
            moved = s * min(abs(remaining), zero)
            limit = ALPHA / c
            z = 0.0 if zero <= abs(remaining) else limit + (z - limit) * np.exp(-c * moved)
            remaining -= moved
        values.append(z)
    return np.array(values)


def loop():
    """Two cycles each at 1, 2 and 3 mm, as a triangle; a load cell that drifts by 5 %."""
    t = np.arange(2400) / 20.0
    amplitude = np.repeat([1e-3, 2e-3, 3e-3], 800)
    y = amplitude * (1.0 - 4 * np.abs((t / 20.0 + 0.25) % 1 - 0.5))
    force = (STIFFNESS - ALPHA) * y + bouc_wen(y)
    largest = np.abs(force).max()
    noise = NOISE * largest * np.random.default_rng(0).standard_normal(len(t))
    channels = {"displacement": y, "restoring_force": force + noise + 0.05 * largest * t / t[-1]}
    record = Record(20.0, channels, {"displacement": "m", "restoring_force": "N"})
    return Test("loop", (record,), "protocol", load_cell="drift")


def test_bounds_hold_a_joint_that_slips_far():
    """Its stiffness at rest is 1.8 times the secant of its widest loop."""
    data = assemble(measured([loop()], Identify()))
    bounds = bounds_by_name(box_of(Identify(), data, told_by(data.parts)))
    truth = {"omega_n": STIFFNESS**0.5, "alpha": ALPHA, "delta": DELTA, "gamma": GAMMA}
    for name, value in truth.items():
        assert bounds[name][0] < value < bounds[name][1], name


@pytest.mark.slow
def test_a_first_answer_finds_a_joint_that_slips_far():
    data = assemble(measured([loop()], Identify()))
    _, best, _ = first_fit(jax.random.key(0), data, Identify())
    std = dict(zip(best.theta, np.sqrt(np.diag(best.covariance)), strict=True))
    for name, value in {"alpha": ALPHA, "delta": DELTA, "gamma": GAMMA}.items():
        assert std[name] < 0.01 * value
        # 4 standard deviations: of 3 parameters one in 5,000 campaigns would miss.
        assert abs(float(best.theta[name]) - value) < 4 * std[name], name
