"""Damping of free decays converted to that of a steady motion, beside closed forms and SciPy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jbw.measurement.faults.examine import read_decays
from jbw.measurement.readings.statement import RecordTable, in_steady_motion
from jbw.measurement.records import Record, Test

FS, OMEGA, ZETA, Y = 2000.0, 2 * np.pi * 40.0, 0.004, 1e-4
K, C = OMEGA**2, 2 * ZETA * OMEGA
SOFTER = 0.15 * K / Y  # the stiffness falls by this, times the amplitude
HARDER = 0.4 * K / Y**2


def read(displacement):
    record = Record(FS, {"displacement": displacement}, {"displacement": "m"})
    return read_decays(Test("decay", (record,), "one", band_hz=(25.0, 55.0)))[0].table()


def masing_decay(duration):
    """A decay by Masing's rule, branch by branch, with the skeleton curve K x - SOFTER x^2."""

    def skeleton(x):
        return K * x - SOFTER * x**2

    t, reversal, values = 0.0, 1.2 * Y, []
    force, sign = skeleton(reversal), -1.0  # the branch falls from its tip
    while t < duration:

        def branch(_, s, tip=reversal, force=force, sign=sign):
            way = max(sign * (s[0] - tip), 0.0)
            return [s[1], -(force + sign * 2 * skeleton(way / 2)) - C * s[1]]

        def stops(_, s):
            return s[1]

        stops.terminal, stops.direction = True, -sign
        found = solve_ivp(
            branch, (t, t + 0.1), [reversal, sign * 1e-12], events=stops, rtol=1e-9, atol=1e-14,
            dense_output=True,
        )  # fmt: skip
        end = float(found.t_events[0][0])
        at = np.arange(np.ceil(t * FS), np.ceil(end * FS)) / FS
        values.append(found.sol(at)[0])
        turned = float(found.y_events[0][0][0])
        force += sign * 2 * skeleton(abs(turned - reversal) / 2)
        t, reversal, sign = end, turned, -sign
    return np.concatenate(values)


def test_a_joint_that_slips_has_the_damping_of_its_steady_loops():
    r"""The skeleton curve $k x - a x^2$ has $\omega^2 = k - a Y$ and loses $4/3\,a Y^3$ a cycle."""
    decay = read(masing_decay(3.0))
    steady = in_steady_motion(decay)
    inside = (decay.y < 0.9 * Y) & (decay.y > 0.1 * Y)
    y = decay.y[inside]
    square = K - SOFTER * y
    zeta = (C * np.sqrt(square) + 4 / (3 * np.pi) * SOFTER * y) / (2 * square)
    np.testing.assert_allclose(2 * np.pi * decay.hz[inside], np.sqrt(square), rtol=2e-3)
    # A decay differs from steady loops by the square of what it loses in a cycle, at most 15 %.
    np.testing.assert_allclose(steady.zeta[inside], zeta, rtol=0.02)
    assert np.max(decay.zeta[inside] / zeta) > 1.06


def test_a_spring_that_hardens_has_the_damping_of_its_dashpot():
    r"""Of $\ddot y + c \dot y + k y + b y^3 = 0$ to first order: $\zeta = c / (2 \omega)$."""
    t = np.arange(round(4 * FS)) / FS
    found = solve_ivp(
        lambda _, s: [s[1], -C * s[1] - K * s[0] - HARDER * s[0] ** 3],
        (0, t[-1]), [1.2 * Y, 0.0], t_eval=t, rtol=1e-10, atol=1e-15,
    )  # fmt: skip
    decay = read(found.y[0])
    steady = in_steady_motion(decay)
    inside = (decay.y < 0.9 * Y) & (decay.y > 0.1 * Y)
    omega = np.sqrt(K + 0.75 * HARDER * decay.y[inside] ** 2)
    # First-order averaging leaves out terms of (3/8 b Y^2 / k)^2 = 1.5 %.
    np.testing.assert_allclose(steady.zeta[inside], C / (2 * omega), rtol=0.015)
    assert np.min(decay.zeta[inside] / (C / (2 * omega))) < 0.97


def test_errors_contain_those_of_the_slope():
    """Against central differences of the converted damping by every frequency and damping."""
    y = np.geomspace(1e-6, 1e-5, 6)
    hz, zeta = 40 - 2e5 * y, 0.004 + 100 * y
    spread = 1e-4 * (np.eye(6) + 0.5), 1e-8 * (np.eye(6) + 0.3)
    table = RecordTable(y, hz, zeta, *spread)
    found = in_steady_motion(table)

    def slopes(name, step):
        columns = []
        for j in range(6):
            ahead, back = (
                in_steady_motion(table._replace(**{name: getattr(table, name) + s * np.eye(6)[j]}))
                for s in (step, -step)
            )
            columns.append((ahead.zeta - back.zeta) / (2 * step))
        return np.stack(columns, axis=1)

    by_hz, by_zeta = slopes("hz", 1e-4), slopes("zeta", 1e-7)
    expected = by_hz @ spread[0] @ by_hz.T + by_zeta @ spread[1] @ by_zeta.T
    # 2 (1e-4 / 40)^2 of the third derivative, and 1e-16 / 1e-7 of round-off
    np.testing.assert_allclose(found.zeta_covariance, expected, rtol=1e-6)
    np.testing.assert_array_equal(found.hz, hz)


def test_one_amplitude_has_no_slope():
    table = RecordTable(*(np.ones(1) for _ in range(3)), np.eye(1), np.eye(1))
    assert in_steady_motion(table) is table


def test_a_linear_mode_stays_as_it_is():
    y = np.array([1e-6, 2e-6, 4e-6])
    table = RecordTable(y, np.full(3, 40.0), np.full(3, 0.01), 1e-6 * np.eye(3), 1e-9 * np.eye(3))
    assert in_steady_motion(table).zeta == pytest.approx(table.zeta)
