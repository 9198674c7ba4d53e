"""What recorders state of rates, starts, units and samples, in files whose numbers are these."""

import h5py
import numpy as np
import pytest
import scipy.io

from jbw.errors import DataError
from jbw.measurement.files.read import opened
from jbw.measurement.recorders.recorder import rate_in, rate_of

NUM, FS, START = 64, 512.0, -0.125
X = np.sin(0.3 * np.arange(NUM))
TIMES = START + np.arange(NUM) / FS


@pytest.mark.parametrize(
    ("line", "fs"),
    [
        ("Sample rate: 51.2 kHz", 51200.0),
        ("Sampling frequency [Hz]: 2048", 2048.0),
        ("fs = 1,024 kHz", 1024.0),
        ("dt = 0.5 ms", 2000.0),
        ("Sampling interval (us): 20", 50000.0),
        ("Sampling interval;20 µs", 50000.0),
        ("Increment,0.004", 250.0),
        ("Sample count: 2048", None),
        ("Sample rate: 3 furlongs", None),
    ],
)
def test_rates_and_intervals_of_preambles(line, fs):
    assert rate_in(["# a preamble", line]) == (None if fs is None else pytest.approx(fs, rel=1e-12))


def test_an_increment_is_the_inverse_of_a_rate():
    assert rate_of(0.004) == 250.0
    assert [rate_of(x) for x in (0.0, -0.1, float("nan"), float("inf"))] == [None] * 4


def series_of(path):
    """The channels of a file by their paths."""
    with opened(path) as contents:
        return contents.series or {}


def matlab(folder, channels):
    path = folder / "a.mat"
    scipy.io.savemat(path, channels)
    return path


def of_testlab(count, start=START, axis="s"):
    axes = {"start_value": start, "increment": 1 / FS, "number_of_values": float(count)}
    return {
        "Signal_0": {
            "x_values": {**axes, "quantity": {"label": axis}},
            "y_values": {"values": X, "quantity": {"label": "m/s"}},
            "function_record": {"name": "laser"},
        }
    }


def of_pulse(count):
    head = {"SampleFrequency": "512", "NumberOfSamplesPerChannel": str(count)}
    header = {"SignalName": "laser", "Unit": "m/s"}
    return {"File_Header": head, "Channel_1_Data": X, "Channel_1_Header": header}


@pytest.mark.parametrize("made", [of_testlab, of_pulse])
@pytest.mark.parametrize("count", [NUM - 1, NUM + 1])
def test_a_file_that_declares_other_samples_than_it_holds_is_refused(tmp_path, made, count):
    assert len(series_of(matlab(tmp_path, made(NUM)))) == 1
    with pytest.raises(DataError, match=rf"declares {count}\b"):
        series_of(matlab(tmp_path, made(count)))


def test_testlab_starts_where_it_says_in_time_and_in_frequency(tmp_path):
    (laser,) = series_of(matlab(tmp_path, of_testlab(NUM))).values()
    assert (laser.fs, laser.start_s, laser.unit) == (FS, START, "m/s")
    found = series_of(matlab(tmp_path, of_testlab(NUM, start=20.0, axis="Hz")))
    hz = np.asarray(found["Signal_0.frequency"].array)
    np.testing.assert_allclose(hz, 20.0 + np.arange(NUM) / FS, rtol=1e-12)


def test_dewesoft_begins_with_its_first_time(tmp_path):
    path = matlab(tmp_path, {"Data1_laser": X, "Data1_time_laser": TIMES})
    (laser,) = series_of(path).values()
    assert (laser.fs, laser.start_s) == (FS, START)
    uneven = np.where(np.arange(NUM) % 7 == 3, TIMES + 0.3 / FS, TIMES)
    path = matlab(tmp_path, {"Data1_laser": X, "Data1_time_laser": uneven, "Sample_rate": FS})
    with opened(path) as contents:
        assert contents.fs == FS


def test_picoscope_begins_at_its_trigger(tmp_path):
    path = matlab(tmp_path, {"A": X, "Tinterval": 1 / FS, "Tstart": START})
    (channel,) = series_of(path).values()
    assert (channel.fs, channel.start_s) == (FS, START)


@pytest.mark.parametrize(("units", "expected"), [(["N", "m/s"], ["N", "m/s"]), (["N"], ["", ""])])
def test_texts_are_units_where_there_is_one_for_each_array(tmp_path, units, expected):
    named = {"units": np.array(units, object), "fs": "512 Hz"}
    path = matlab(tmp_path, {"cell": X, "laser": 2 * X, **named})
    with opened(path) as contents:
        assert [contents.root[name].unit for name in ("cell", "laser")] == expected


def test_attributes_of_an_array_come_before_what_stands_beside_it(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        data = file.create_dataset("data", data=np.stack([X, 2 * X]))
        data.attrs["channel_names"] = ["cell", "laser"]
        data.attrs["units"] = ["N", "m/s"]
        data.attrs["fs"] = FS
        file["fs"] = 7.0
    found = series_of(tmp_path / "a.h5")
    assert [(leaf.fs, leaf.unit) for leaf in found.values()] == [(FS, "N"), (FS, "m/s")]


def test_a_tdms_channel_of_times_is_none_beside_channels_of_a_rate(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    stated = {"wf_increment": 1 / FS, "wf_start_offset": 0.0, "unit_string": "m/s"}
    channels = [("Time", TIMES, {}), ("laser", X, stated)]
    with nptdms.TdmsWriter(str(tmp_path / "a.tdms")) as writer:
        writer.write_segment([nptdms.ChannelObject("Log", n, x, p) for n, x, p in channels])
    assert list(series_of(tmp_path / "a.tdms")) == ["Log.laser"]
