"""Rates of printed times: right within their last digit, never moved, and refused where unknown."""

import numpy as np
import pytest
from tone_file import LASER, UNITS_V, refused

from jbw.errors import ConfigError, DataError
from jbw.measurement.files.clocks import (
    coarse_rate,
    sampling_frequency,
    stated_rate,
    time_unit,
)
from jbw.measurement.files.read import read

# Of National Instruments' and Polytec's dividers, of crystals, and of nobody.
RATES = (2441.40625, 51200 / 3, 51200 / 7, 51200 / 13, 12207.03125, 44100.0, 999.0, 30.303030303)
RNG = np.random.default_rng(52)


def printed(form, fs, seconds, begins=0.0):
    return np.array([float(form % (begins + n / fs)) for n in range(int(fs * seconds))])


def quantum(form, largest):
    """What a format leaves of a time: by its decimals, or by its significant digits."""
    digits = int(form[2:-1])
    if form.endswith("f"):
        return 10.0**-digits
    return 10.0 ** (np.floor(np.log10(largest)) + 1 - digits - (form[-1] == "e") * -1)


@pytest.mark.parametrize("fs", RATES)
@pytest.mark.parametrize("form", ["%.6f", "%.9f", "%.7g", "%.8g", "%.7e"])
@pytest.mark.parametrize("seconds", [2.0, 12.0])
def test_the_rate_is_right_within_the_last_digit(fs, form, seconds):
    time = printed(form, fs, seconds)
    lost = quantum(form, time[-1])
    if lost * fs > 0.4:  # no finer than the samples are apart
        pytest.skip("refused: see the test of coarse times")
    found, _ = sampling_frequency(time)
    # Half a digit at either end, and the thousandth of an interval that evenness is met to.
    assert abs(found / fs - 1) <= (lost + 1e-3 / fs) / time[-1]


def test_drawn_rates_are_even_in_the_digits_that_programs_print():
    for _ in range(60):
        fs, seconds = 10 ** RNG.uniform(1.5, 4.3), RNG.uniform(1.0, 6.0)
        begins = RNG.choice([0.0, RNG.uniform(0, 90)])
        time = printed("%.6f", fs, seconds, begins)
        found, _ = sampling_frequency(time)
        assert abs(found / fs - 1) * len(time) < 0.5


def test_a_round_rate_is_taken_where_every_digit_agrees():
    assert sampling_frequency(printed("%.6f", 1024.0, 8.0))[0] == 1024.0
    assert sampling_frequency(printed("%.9f", 51.2, 8.0))[0] == 51.2
    assert sampling_frequency(printed("%.9f", 1024.0003, 8.0))[0] != 1024.0


@pytest.mark.parametrize("lost", [40, 511, 900])
def test_a_lost_sample_is_never_the_digits(lost):
    for form, fs in (("%.4f", 1000.0 / 3), ("%.6f", 2441.40625), ("%.3f", 30.303030303)):
        time = np.delete(printed(form, fs, 1000 / fs), lost)
        with pytest.raises(DataError):
            sampling_frequency(time)


def test_jitter_beyond_the_digits_is_none_of_theirs():
    time = np.round((np.arange(4000) + 0.05 * RNG.standard_normal(4000)) / 512.0, 6)
    with pytest.raises(DataError, match="must be evenly spaced"):
        sampling_frequency(time)


@pytest.mark.parametrize(("form", "fs"), [("%.3f", 999.0), ("%.2e", 40000.0), ("%.4f", 44100.0)])
def test_times_of_too_few_digits_give_their_mean_rate_alone(tmp_path, form, fs):
    time = printed(form, fs, 0.05 if "e" in form else 2.0)
    digits = max(1, int(np.log10(time[-1] / quantum(form, time[-1]))))
    assert coarse_rate(time) == pytest.approx(fs, rel=10.0 ** (1 - digits))
    rows = "\n".join(f"{form % t},{v:.6f}" for t, v in zip(time, np.resize(LASER, len(time)),
                                                          strict=True))  # fmt: skip
    (tmp_path / "a.csv").write_text("time [s],laser\n" + rows + "\n")
    error = refused(tmp_path / "a.csv", {"time": "time", "velocity": "laser"}, UNITS_V)
    assert "too few digits" in error.what
    rate = float(error.remedy.rpartition("`fs = ")[2].strip("`."))
    (record,) = read(tmp_path / "a.csv", {"velocity": "laser"}, UNITS_V, fs=rate)
    assert record.fs == rate


def test_a_stated_rate_stays_but_for_printed_digits():
    for fs in (2441.40625, 12207.03125, 97656.25, 51200 / 7, 1023.54, 12207.03):
        assert stated_rate(fs) == fs
    # Six digits of an interval, as universal files print it; and round-off.
    for interval, fs in ((0.000976562, 1024.0), (1.95312e-05, 51200.0), (1e-5, 1e5)):
        assert stated_rate(1 / interval) == fs


def test_a_rate_that_tdms_states_is_never_moved(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        for i, fs in enumerate((2441.40625, 97656.25)):
            told = {"wf_increment": 1 / fs, "unit_string": "m/s"}
            writer.write_segment([nptdms.ChannelObject("Log", f"laser {i}", LASER, told)])
    for i, fs in enumerate((2441.40625, 97656.25)):
        (record,) = read(tmp_path / "a.tdms", {"velocity": f"Log.laser {i}"})
        assert record.fs == fs


@pytest.mark.parametrize(
    ("times", "unit"),
    [
        (np.arange(50), ""),
        (13845 + 10 * np.arange(50), "ms"),
        (1000 * np.arange(50), "us"),
        (1.7e9 + np.arange(50) / 512, "s"),
        (1.7e12 + 2 * np.arange(50), "ms"),
        (np.arange(50) / 0.512, "ms"),
        (np.arange(50) / 512, "s"),
    ],
)
def test_the_unit_of_times_is_the_one_of_a_recorder(times, unit):
    assert time_unit(np.asarray(times))[0] == unit


def test_whole_numbers_without_a_unit_are_asked_about(tmp_path):
    rows = "\n".join(f"{10 * i},{v:.6f}" for i, v in enumerate(LASER))
    (tmp_path / "a.csv").write_text("time,laser\n" + rows + "\n")
    roles = {"time": "time", "velocity": "laser"}
    error = refused(tmp_path / "a.csv", roles, UNITS_V, error=ConfigError)
    assert "whole numbers without a unit: 0, 10, 20, 30, ..." in error.what
    assert 'units = { time = "ms" }' in error.remedy
    for unit, fs in (("ms", 100.0), ("us", 1e5), ("s", 0.1)):
        (record,) = read(tmp_path / "a.csv", roles, {**UNITS_V, "time": unit})
        assert record.fs == fs
