"""Samples of one clock at the instants of another: sums of tones, known anywhere."""

import numpy as np
import pytest

from jbw.campaign.schema import parse
from jbw.errors import ConfigError
from jbw.measurement.records import Record
from jbw.measurement.resampled import REACH, interpolated, on_one_clock

FS, SIZE = 512.0, 1 << 14
TONES = ((3.0, 0.2), (18.8, 1.1), (230.0, 2.3))  # Hz, up to nine tenths of half the rate, and phase


def signal(time):
    return 0.5 + sum(np.cos(2 * np.pi * hz * time + phase) for hz, phase in TONES)


def test_a_band_limited_signal_is_known_between_its_samples():
    place = np.random.default_rng(0).uniform(REACH, SIZE - REACH, 40_000)
    found = interpolated(signal(np.arange(SIZE) / FS), place)
    # Kaiser's window of beta 10 leaves -100 dB of each tone.
    np.testing.assert_allclose(found, signal(place / FS), rtol=0, atol=3e-5)


@pytest.mark.parametrize("ppm", [80.0, -80.0, 500.0])
def test_a_response_of_another_clock_comes_onto_that_of_its_drive(ppm):
    time = np.arange(SIZE) / FS
    drive = np.sin(2 * np.pi * 10.0 * time)
    channels = {"force": drive, "velocity": signal(time / (1 + 1e-6 * ppm))}
    record = on_one_clock(Record(FS, channels, {}), ppm)
    kept = record.num_samples
    # A fast clock's last samples were taken before the drive's ended.
    assert kept == (SIZE if ppm < 0 else SIZE - int(np.ceil((SIZE - 1) * 1e-6 * ppm)))
    np.testing.assert_array_equal(record.channels["force"], drive[:kept])
    inner = slice(REACH, kept - REACH)
    expected = signal(time[inner])
    np.testing.assert_allclose(record.channels["velocity"][inner], expected, rtol=0, atol=3e-5)


DECAY = """[[test]]
kind = "{kind}"
files = "a.h5"
channels = {{ force = "u", velocity = "v" }}
units = {{ force = "N", velocity = "m/s" }}
clock_ppm = {ppm}
"""


@pytest.mark.parametrize(
    ("kind", "ppm", "said"),
    [("decay", 80.0, "of a driven test"), ("sweep", 5e4, "at most 10000 to either side")],
)
def test_a_clock_that_makes_no_sense_is_refused(kind, ppm, said):
    with pytest.raises(ConfigError, match=said):
        parse(DECAY.format(kind=kind, ppm=ppm))
