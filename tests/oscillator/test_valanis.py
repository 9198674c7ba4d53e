"""Valanis's and Dahl's laws: against SciPy, Bouc-Wen's law in the limit, and a closed loop."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy_motion import scipy_motion

import jbw
from jbw.oscillator.laws.valanis import Valanis

FS = 1024.0
TIME = np.arange(512) / FS
INPUT = 8.0 * np.sin(2 * np.pi * 17 * TIME) * np.sin(2 * np.pi * 3 * TIME)
E_0, LEFT, RATE, KAPPA = 600.0, 0.3, 900.0, 0.6


def slope(z, towards):
    part = towards * RATE * z
    return (E_0 - part) / (1 - KAPPA * part / E_0) - LEFT * E_0


@pytest.mark.slow
def test_the_motion_is_scipys():
    joint = jbw.Oscillator(118.0, 0.01, (Valanis(E_0, LEFT, RATE, KAPPA),))
    found = jbw.simulate(joint, INPUT, FS, substeps=4)
    stiffness, damping = 118.0**2 - E_0, 2 * 0.01 * 118.0
    y, v, z = scipy_motion(
        lambda y, v, z: z + LEFT * E_0 * y, stiffness, damping, INPUT, FS,
        rate=lambda v, z: slope(z, np.sign(v)) * v,
    )  # fmt: skip
    assert np.max(np.abs(z)) > 0.9 * (E_0 - LEFT * E_0) / (RATE * (1 - KAPPA * LEFT))
    # SciPy steps over the kinks at turning points, which costs it some 1e-7; jbw's step 1e-6.
    for one, other in ((found.y, y), (found.v, v), (found.z, z + LEFT * E_0 * y)):
        assert np.max(np.abs(one - other)) < 1e-5 * np.max(np.abs(other))


def test_the_loop_loses_the_area_of_scipys_branches():
    y_peak = 2e-3
    z, areas = 0.0, []
    options = dict(method="DOP853", rtol=1e-11, atol=1e-12, dense_output=True)
    for start, end in [(0, 1), (1, -1), (-1, 1), (1, -1), (-1, 1)]:
        towards = np.sign(end - start)
        span = start * y_peak, end * y_peak
        branch = solve_ivp(lambda y, z, s=towards: slope(z, s), span, [z], **options)
        at = np.linspace(*span, 20_001)
        areas.append(np.trapezoid(branch.sol(at)[0], at))
        z = branch.y[0, -1]
    found = Valanis(E_0, LEFT, RATE, KAPPA).loop(y_peak)
    # The generic loop's 128 trapezia on half a cycle.
    np.testing.assert_allclose(found.energy(y_peak), areas[-2] + areas[-1], rtol=1e-3)


def test_without_microslip_it_is_bouc_wens_law_and_dahls():
    bouc_wen = jbw.laws.BoucWenLaw(E_0, 0.0, RATE)
    dahl = Valanis.dahl(E_0, E_0 / RATE)
    one, other = (
        jbw.simulate(jbw.Oscillator(118.0, 0.01, (law,)), INPUT, FS, substeps=4)
        for law in (dahl, bouc_wen)
    )
    # Moves by Runge and Kutta's rule in eight steps against the exact map.
    assert np.max(np.abs(one.y - other.y)) < 1e-5 * np.max(np.abs(other.y))
