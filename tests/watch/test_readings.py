"""Readings at a fixed amplitude, of decays made without jbw, and records that are refused."""

from dataclasses import replace

import numpy as np
import pytest
from decays import BAND, FS, OMEGA_N, SETTLE, free_velocity
from scipy.integrate import solve_ivp

import jbw
from jbw.measurement.records import Record, Test
from jbw.watch.readings import PER_AMPLITUDE, common_amplitude, names_of, reading

ZETA, F_HZ = 0.002, 20.3
UNITS = {"velocity": "m/s"}


def linear(size=1.0, noise=0.0, seed=0, seconds=9.0, zeta=ZETA, phase=0.3):
    """Velocity of a linear decay, which has one frequency and one damping at every amplitude."""
    t = np.arange(round(seconds * FS)) / FS
    omega = 2 * np.pi * F_HZ
    white = noise * np.random.default_rng(seed).standard_normal(len(t))
    return size * np.exp(-zeta * omega * t) * np.cos(omega * t + phase) + white


def record(velocity, name="hit"):
    return Record(FS, {"velocity": velocity}, UNITS, name)


def impacts(*velocities):
    records = tuple(record(v, f"hit {i}") for i, v in enumerate(velocities))
    return Test("decay", records, "impacts", band_hz=BAND, settle=SETTLE)


def test_a_linear_decay_reads_what_it_is():
    test = impacts(linear())
    decay_reading = reading(test.records[0], test, [0.3, 0.6])
    # The stated floor: 0.3 % of zeta, of the frequency and of the damping ratio.
    assert decay_reading.values[0] == pytest.approx(F_HZ, abs=1e-4)
    assert decay_reading.values[1] == pytest.approx(np.log(ZETA), abs=1e-4)
    assert decay_reading.values[2] == pytest.approx(0.0, abs=1e-4)
    assert decay_reading.values[3] == pytest.approx(np.log(ZETA), abs=1e-4)
    # Sidelobes of the mode itself, through a Hann window of a few of its periods.
    assert decay_reading.other_modes < 5e-3
    assert len(names_of([0.3, 0.6], "m/s")) == len(decay_reading.values) == 2 * PER_AMPLITUDE


def test_the_covariance_contains_the_scatter_of_repeats():
    test = impacts(linear())
    readings = [
        reading(record(linear(noise=6e-3, seed=i, phase=i)), test, [0.6, 0.3]) for i in range(40)
    ]
    values = np.stack([repeat.values for repeat in readings])
    mean_covariance = np.mean([repeat.covariance for repeat in readings], axis=0)
    variance, stated = values.var(axis=0, ddof=1), np.diag(mean_covariance)
    # The stated floor, 0.3 % of zeta, is up to ten times the noise's standard deviation.
    assert np.all(variance < stated)
    assert np.all(variance > stated / 10**2 * 0.5)  # of 40 draws, a variance is known to 22 %
    # The natural frequency, unbiased to four standard errors.
    natural = F_HZ * np.sqrt(1 + ZETA**2)
    assert np.abs(values.mean(axis=0)[0] - natural) < 4 * np.sqrt(variance[0] / 40)


def hysteretic(size):
    return free_velocity(0.0, size, 5.0)


def power_law(size, seconds=9.0):
    """A joint of Masing's kind by its envelope: frequency and damping go with a power of A.

    df/f = -0.02 A^0.6, zeta = 0.001 + 0.003 A^0.6, as Iwan's law makes them below macroslip.
    """
    omega = 2 * np.pi * F_HZ

    def rate(_, state):
        amplitude = np.exp(state[0])
        now = omega * (1 - 0.02 * amplitude**0.6)
        return [-(0.001 + 0.003 * amplitude**0.6) * now, now]

    t = np.arange(round(seconds * FS)) / FS
    log, phase = solve_ivp(
        rate, (0, t[-1]), (np.log(size), 0.0), "DOP853", t, rtol=1e-10, atol=1e-12
    ).y
    return np.exp(log) * np.cos(phase)


@pytest.mark.parametrize(
    ("joint", "sizes", "amplitude"),
    [(hysteretic, (0.15, 0.3), 0.09), (power_law, (0.5, 1.5), 0.2)],
)
def test_a_louder_hammer_reads_the_same(joint, sizes, amplitude):
    """Parameters of laws move by per cents with the hammer; a reading must not."""
    test = impacts(*(joint(size) for size in sizes))
    soft, loud = (reading(record, test, [amplitude]).values for record in test.records)
    # The basis differs that either record asks for: 1e-3 of the damping.
    assert loud[0] == pytest.approx(soft[0], rel=2e-5)
    assert loud[1] == pytest.approx(soft[1], abs=3e-3)


def test_a_power_law_reads_its_own_damping():
    test = impacts(power_law(1.5))
    values = reading(test.records[0], test, [0.2]).values
    # The stated floor of averaging is 5e-3 of the damping where this changes by its own half.
    zeta = 0.001 + 0.003 * 0.2**0.6
    assert values[1] == pytest.approx(np.log(zeta), abs=5e-3)
    assert values[0] == pytest.approx(F_HZ * (1 - 0.02 * 0.2**0.6), rel=3e-5)


def test_the_common_amplitude_lies_within_every_record():
    test = impacts(linear(1.0), linear(0.5), linear(2.0))
    amplitude = common_amplitude(test)
    assert len({reading(record, test, [amplitude]).values.shape for record in test.records}) == 1
    # The loudest ends at 2 exp(-zeta omega 9 s), give or take the filter's half length.
    end = 2.0 * np.exp(-ZETA * 2 * np.pi * F_HZ * 9.0)
    assert amplitude == pytest.approx(1.05 * np.sqrt(1.4) * end, rel=0.25)


def test_records_without_a_common_window_are_refused():
    with pytest.raises(jbw.DataError, match="have no common amplitude"):
        common_amplitude(impacts(linear(1.0, zeta=4e-4), linear(0.3)))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (
            lambda v: 0.2 * v,
            r"`hit` has frequency .* from 0.\d+ to 0.\d+ m/s, but not at 0.6 m/s",
        ),
        (lambda v: v[: len(v) // 16], "`hit` has frequency|must decay in its `band`"),
        (
            lambda v: v + 0.1 * np.cos(OMEGA_N * 2.5 * np.arange(len(v)) / FS),
            "other modes contribute",
        ),
    ],
)
def test_records_that_cannot_be_compared_are_refused(changed, message):
    test = impacts(linear())
    with pytest.raises(jbw.DataError, match=message):
        reading(record(changed(linear())), test, [0.6])


def test_other_channels_and_kinds_are_refused():
    test = impacts(linear())
    other = Record(FS, {"acceleration": linear()}, {"acceleration": "m/s^2"}, "hit")
    with pytest.raises(jbw.DataError, match="has no velocity"):
        reading(other, test, [0.6])
    with pytest.raises(jbw.DataError, match="kind `sweep`, which is no free decay"):
        reading(record(linear()), replace(test, kind="sweep"), [0.6])
