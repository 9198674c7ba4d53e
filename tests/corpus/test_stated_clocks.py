"""Clocks and units that a file states or belies: named, and cured by the line to paste."""

import re
import tomllib

import numpy as np
import pytest
import scipy.io
from corpus.dialects import FORCE, FS, VELOCITY, N, T, rows, text

from jbw.campaign.draft import start_campaign
from jbw.campaign.files import repeats_of
from jbw.campaign.schema import parse
from jbw.errors import ConfigError, DataError, JbwError
from jbw.measurement.files.read import read
from jbw.measurement.records import Record
from jbw.measurement.resampled import REACH, at_rate, from_uneven, proposed_rate

PUT = re.compile(r"put under \[\[test\]\][^`]*`([^`]+)`", re.IGNORECASE)
TEST = """[campaign]
name = "clock"
modal_mass = 1.0
[[test]]
kind = "sweep"
files = "sweep_1.csv"
channels = {{ time = "time", force = "force", velocity = "velocity" }}
units = {{ time = "s", force = "{unit}", velocity = "m/s" }}
{line}
"""


def record_of(folder, line="", unit="N"):
    """The record that a campaign with a line more means, or the error."""
    (test,) = parse(TEST.format(unit=unit, line=line)).tests
    (found,) = repeats_of(test, folder)
    return found


def pasted(error):
    """The line that a refusal tells to put into the campaign."""
    assert isinstance(error, JbwError)
    (line,) = PUT.findall(error.remedy)
    return line


def tones(t):
    return np.cos(2 * np.pi * 18.0 * t) + 0.4 * np.cos(2 * np.pi * 61.0 * t + 0.3)


def jittered(share, size=4000, fs=400.0):
    t = np.cumsum((1 + share * np.random.default_rng(0).standard_normal(size)) / fs)
    return t - t[0]


def paused(size=4100, fs=615.0):
    steps = np.full(size, 1 / fs)
    steps[614::615] = 0.020
    return np.concatenate([[0.0], np.cumsum(steps)[:-1]])


def written(folder, t, header="time [s],force [N],velocity [m/s]"):
    text(folder / "sweep_1.csv", header, *rows((t, 3 * tones(t), tones(t)), form="{:.9g}"))


@pytest.mark.parametrize("share", [0.0, 0.03, 0.2])
def test_a_clock_that_jitters_is_met_in_the_band_that_it_leaves(share):
    t = jittered(share)
    y, said = from_uneven(tones(t), t, 400.0)
    even = tones(np.arange(len(y)) / 400.0)
    inner = slice(REACH, -REACH)
    # Kaiser's window of beta 10 leaves 3e-5; the ends are met by fewer samples.
    np.testing.assert_allclose(y[inner], even[inner], rtol=0, atol=1e-4)
    np.testing.assert_allclose(y, even, rtol=0, atol=2e-2)
    assert "held-out samples are interpolated with" in said


def test_a_clock_that_pauses_is_met_below_one_over_the_pause():
    t = paused()
    slow = np.cos(2 * np.pi * 12.0 * t)
    y, said = from_uneven(slow, t, 615.0)
    inner = slice(REACH, -REACH)
    even = np.cos(2 * np.pi * 12.0 * np.arange(len(y)) / 615.0)
    np.testing.assert_allclose(y[inner], even[inner], rtol=0, atol=1e-3)
    assert "below 22.5 Hz" in said


def test_what_a_pause_swallows_is_refused():
    t = paused()
    fast = np.cos(2 * np.pi * 90.0 * t)  # several periods pass within 20 ms
    with pytest.raises(DataError, match="differs from the omitted samples by"):
        from_uneven(fast, t, 615.0)


def test_a_lower_rate_keeps_its_band_and_says_what_it_loses():
    t = np.arange(8192) / 1024.0
    x = np.cos(2 * np.pi * 18.0 * t) + 0.5 * np.cos(2 * np.pi * 400.0 * t)
    y, said = at_rate(x, 1024.0, 512.0)
    even = np.cos(2 * np.pi * 18.0 * np.arange(len(y)) / 512.0)
    np.testing.assert_allclose(y[99:-99], even[99:-99], rtol=0, atol=3e-5)
    # 0.5 / sqrt(2) of an rms of sqrt(1.25 / 2): sqrt(0.2).
    assert "is removed (45 % of the rms)" in said


@pytest.mark.parametrize("size", [2, 20, 63])
def test_too_few_samples_are_refused(size):
    with pytest.raises(DataError, match="too few"):
        at_rate(np.ones(size), 100.0, 50.0)


@pytest.mark.parametrize("t", [jittered(0.03), paused()], ids=["jitter", "pauses"])
def test_a_pasted_rate_cures(tmp_path, t):
    written(tmp_path, t)
    error = record_of(tmp_path)
    cured = record_of(tmp_path, pasted(error))
    assert isinstance(cured, Record)
    assert cured.fs == proposed_rate(t)
    assert "held-out" in cured.provenance["resampled velocity"]


def test_a_rate_beyond_what_was_measured(tmp_path):
    for t in (jittered(0.03), np.arange(4000) / 400.0):
        written(tmp_path, t)
        error = record_of(tmp_path, "resample = 4000.0")
        assert "at most" in error.what
        assert isinstance(record_of(tmp_path, pasted(error)), Record)


def test_a_band_beyond_half_of_the_rate_is_refused():
    with pytest.raises(ConfigError, match="at least twice the end of band"):
        parse(TEST.format(unit="N", line="resample = 100.0\nband = [10.0, 60.0]"))
    with pytest.raises(ConfigError, match="resample: applies only to records in time"):
        parse('[[test]]\nkind = "frf"\nfiles = "a.csv"\nresample = 9.0\n'
              'channels = { frequency = "f", velocity = "v", phase = "p" }\n'
              'units = { frequency = "Hz", velocity = "m/s/N", phase = "rad" }')  # fmt: skip


def test_a_pasted_word_on_units_cures(tmp_path):
    text(tmp_path / "sweep_1.csv", "time [s],force [N],velocity [m/s]", *rows((T, FORCE, VELOCITY)))
    error = record_of(tmp_path, unit="kN")
    assert "the unit `kN` in the campaign but `N` in the file" in error.what
    cured = record_of(tmp_path, pasted(error), unit="kN")
    assert isinstance(cured, Record)
    np.testing.assert_allclose(cured.channels["force"], 1e3 * FORCE, rtol=1e-5)
    assert "as the campaign states, not `N` as the file states" in cured.provenance["unit of force"]


# --- what a file says against itself ---


def test_a_rate_above_the_table_that_its_times_belie_is_refused(tmp_path):
    text(tmp_path / "a.csv", "Sample rate: 2048 Hz", "time [s];force [N];velocity [m/s]",
         *rows((T, FORCE, VELOCITY), ";"))  # fmt: skip
    with pytest.raises(DataError, match="sampling frequencies must agree"):
        read(tmp_path / "a.csv", {"time": "time", "velocity": "velocity"})


def test_a_unit_that_belies_the_label_is_not_drafted(tmp_path):
    text(tmp_path / "tap_1.csv", "time [s],velocity [N]", *rows((T, FORCE)))
    assert "test" not in tomllib.loads(start_campaign(tmp_path).text)


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        (["LabVIEW Measurement", "time\tforce", "0.0\t1.0", "0.1\t2.0"], "two headers"),
        (["Record Length,9,,0.0,1.0,", "Sample Interval,0.5,,0.001,2.0,", ",,,0.002,1.0,",
          ",,,0.003,2.0,"], "must agree"),
    ],
)  # fmt: skip
def test_a_recorder_s_name_over_another_layout_is_refused(tmp_path, lines, says):
    text(tmp_path / "a.csv", *lines)
    with pytest.raises(DataError, match=says):
        read(tmp_path / "a.csv", {"time": "time", "acceleration": "CH1"}, {"acceleration": "g"})


def test_counts_that_a_header_declares_must_be_there(tmp_path):
    head = {"SampleFrequency": "1024", "NumberOfSamplesPerChannel": str(N + 1)}
    channel = {"SignalName": "vel", "Unit": "m/s"}
    scipy.io.savemat(tmp_path / "a.mat", {"File_Header": head, "Channel_1_Data": VELOCITY,
                                          "Channel_1_Header": channel})  # fmt: skip
    with pytest.raises(DataError, match=f"contains {N} samples, but the file declares {N + 1}"):
        read(tmp_path / "a.mat", {"velocity": "Channel_1_Data"})


def test_torsion_beside_a_force_is_refused(tmp_path):
    text(tmp_path / "a.csv", "time [s],angle [rad],torque [N m],force [N]",
         *rows((T, VELOCITY, FORCE, FORCE)))  # fmt: skip
    roles = {"time": "time", "displacement": "angle"}
    (record,) = read(tmp_path / "a.csv", {**roles, "restoring_force": "torque"})
    assert record.units == {"displacement": "rad", "restoring_force": "N m"}
    with pytest.raises(ConfigError, match="torsional or translational"):
        read(tmp_path / "a.csv", {**roles, "restoring_force": "force"})


def test_decibels_are_of_amplitudes_alone(tmp_path):
    text(tmp_path / "a.csv", "time [s],velocity [dB re 1e-9 m/s]", *rows((T, VELOCITY)))
    with pytest.raises(DataError, match="only the real amplitudes"):
        read(tmp_path / "a.csv", {"time": "time", "velocity": "velocity"})
    assert FS == 1024.0
