"""Proposals for long records, against records whose rest and frequency are known by making."""

import re

import numpy as np
import pytest

from jbw.measurement.records import Record, Test
from jbw.measurement.spans import long_records

FS = 4096.0


def a_test(kind="sweep", seconds=30.0, fs=FS, rest=(6.0, 12.0), hz=20.0):
    t = np.arange(round(seconds * fs)) / fs
    moving = (t >= rest[0]) & (t < seconds - rest[1])
    wave = np.where(moving, np.sin(2 * np.pi * hz * t), 0.0)
    units = {"input": "V", "velocity": "m/s"}
    return Test(kind, (Record(fs, {"input": wave, "velocity": wave}, units),), "long")


def said(test):
    return list(long_records(test.name, test.traits, test.records[0]))


def test_rest_at_the_ends_is_proposed_to_be_cut_with_what_it_saves():
    (told,) = said(a_test())
    low, high = map(float, re.search(r"span = \[([\d.]+), ([\d.]+)\]", told).groups())
    # To a tenth of a second, outwards.
    assert low == pytest.approx(6.0, abs=0.1)
    assert high == pytest.approx(18.0, abs=0.1)
    assert low <= 6.0
    assert high >= 18.0
    # 12 s of 30.
    assert "takes only 40 % of the time" in told


def test_a_rate_of_many_samples_a_cycle_is_proposed_to_be_lowered():
    (told,) = said(a_test(rest=(0.0, 0.0)))
    # 4096 / 20 samples a cycle; every third sample leaves 68 of them, every fourth 51.
    assert "205 samples per cycle" in told
    assert "every third sample (1365.33 Hz); a fit then takes 33 % of the time" in told
    assert "span" not in told


@pytest.mark.parametrize(
    "test",
    [
        a_test(seconds=10.0),  # 41,000 samples
        a_test(fs=2048.0, seconds=60.0, rest=(0.0, 0.0), hz=25.0),  # 82 samples a cycle, no rest
        a_test(kind="noise"),  # enters by its lines
    ],
)
def test_nothing_is_proposed_where_nothing_would_be_saved(test):
    assert said(test) == []
