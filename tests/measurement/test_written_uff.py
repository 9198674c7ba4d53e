"""Universal files as `jbw.write_uff` leaves them, read by pyuff alone and by `jbw.read`."""

import numpy as np
import pytest

import jbw
from jbw.errors import ConfigError, DataError

pyuff = pytest.importorskip("pyuff")

FS = 1024.0


def record(**changes):
    t = np.arange(1000) / FS
    channels = {"input": np.sin(2 * np.pi * 19 * t), "velocity": 3e-5 * np.cos(2 * np.pi * 19 * t)}
    return jbw.Record(FS, {**channels, **changes}, {"input": "V", "velocity": "m/s"}, "day 1")


def test_pyuff_reads_every_channel_with_its_unit(tmp_path):
    jbw.write_uff(tmp_path / "tone.uff", record())
    sets = pyuff.UFF(str(tmp_path / "tone.uff")).read_sets()
    assert [one["id1"].strip() for one in sets] == ["input", "velocity"]
    assert [one["ordinate_axis_units_lab"].strip() for one in sets] == ["V", "m/s"]
    for one, samples in zip(sets, record().channels.values(), strict=True):
        # Twelve digits of every number are written.
        np.testing.assert_allclose(one["data"], samples, rtol=1e-11)
        # Five digits of the interval are.
        assert one["abscissa_inc"] == pytest.approx(1 / FS, rel=1e-5)


def test_what_is_written_is_read_back(tmp_path):
    path = tmp_path / "tone.unv"
    jbw.write_uff(path, record())
    (found,) = jbw.read(path, {"input": "input", "velocity": "velocity"}, fs=FS)
    assert found.units == record().units
    for role, samples in record().channels.items():
        np.testing.assert_allclose(found.channels[role], samples, rtol=1e-11)
    assert [one.name for one in tmp_path.iterdir()] == ["tone.unv"]


def test_what_cannot_be_held_is_refused(tmp_path):
    broken = np.ones(1000)
    broken[3] = np.nan
    with pytest.raises(DataError, match=r"`velocity` must be finite, but 1 of its 1000"):
        jbw.write_uff(tmp_path / "a.uff", record(velocity=broken))
    with pytest.raises(ConfigError, match=r"must end in \.uff or \.unv"):
        jbw.write_uff(tmp_path / "a.txt", record())
    jbw.write_uff(tmp_path / "a.uff", record())
    with pytest.raises(ConfigError, match="exists"):
        jbw.write_uff(tmp_path / "a.uff", record())
    with pytest.raises(ConfigError, match="cannot be written"):
        jbw.write_uff(tmp_path / "nowhere" / "a.uff", record())
    curve = jbw.Record(float("nan"), {"frequency": np.arange(3.0)}, {"frequency": "Hz"})
    with pytest.raises(DataError, match="response curve"):
        jbw.write_uff(tmp_path / "b.uff", curve)
    assert [one.name for one in tmp_path.iterdir()] == ["a.uff"]


def test_sep005_goes_out_and_comes_back():
    series = jbw.to_sep005(record())
    assert [(one["name"], one["unit_str"], one["fs"]) for one in series] == [
        ("input", "V", FS),
        ("velocity", "m/s", FS),
    ]
    back = jbw.from_sep005(series)
    np.testing.assert_array_equal(back.channels["velocity"], record().channels["velocity"])
