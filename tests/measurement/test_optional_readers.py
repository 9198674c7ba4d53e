"""Files as optional libraries write them, and suffixes that nobody reads."""

import numpy as np
import pytest

from jbw.campaign.draft import start_campaign
from jbw.errors import DataError
from jbw.measurement.files.read import READERS, read
from jbw.report.messages.reading import EXPORTS

FS = 25600 / 3
T = np.arange(4096) / FS
X = np.exp(-3.0 * T) * np.cos(2 * np.pi * 120.0 * T)


def test_mdf_keeps_units_rates_and_starts(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    path = tmp_path / "hammer_1.mf4"
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(X, T, name="acc [g]"),
                     asammdf.Signal(2 * X, T, name="force", unit="N")])  # fmt: skip
        file.append([asammdf.Signal(X[::2], 0.25 + T[::2], name="slow", unit="mm/s")])
        file.save(path)
    roles = {"acceleration": "group 0.acc [g]", "force": "group 0.force"}
    (record,) = read(path, roles)
    assert record.fs == pytest.approx(FS, rel=1e-12)
    np.testing.assert_allclose(record.channels["acceleration"], 9.80665 * X, rtol=1e-12)
    np.testing.assert_array_equal(record.channels["force"], 2 * X)
    (slow,) = read(path, {"velocity": "group 1.slow"})
    assert slow.fs == pytest.approx(FS / 2, rel=1e-12)
    assert slow.provenance["start of velocity"] == "0.25 s"


@pytest.mark.parametrize(("suffix", "form"), [(".mseed", "MSEED"), (".sac", "SAC")])
def test_traces_of_seismic_recorders_keep_their_rate(tmp_path, suffix, form):
    obspy = pytest.importorskip("obspy")
    told = {"sampling_rate": 200.0, "network": "XX", "station": "B1", "channel": "HNZ"}
    path = tmp_path / f"tap_1{suffix}"
    obspy.Trace(X.astype(np.float32), told).write(str(path), format=form)
    (record,) = read(path, {"acceleration": "XX.B1..HNZ"}, {"acceleration": "g"})
    # SAC keeps the interval in single precision.
    assert record.fs == pytest.approx(200.0, rel=1e-7)
    np.testing.assert_allclose(record.channels["acceleration"], 9.80665 * X, rtol=0, atol=1e-6)


def test_a_trace_in_pieces_is_refused(tmp_path):
    obspy = pytest.importorskip("obspy")
    told = {"sampling_rate": 200.0, "network": "XX", "station": "B1", "channel": "HNZ"}
    pieces = [obspy.Trace(X[:900], {**told, "starttime": obspy.UTCDateTime(9 * i)})
              for i in range(2)]  # fmt: skip
    path = tmp_path / "tap_1.mseed"
    obspy.Stream(pieces).write(str(path), format="MSEED")
    with pytest.raises(DataError, match="in 2 pieces"):
        read(path, {"acceleration": "XX.B1..HNZ"}, {"acceleration": "g"})


@pytest.mark.parametrize("suffix", sorted(EXPORTS))
def test_a_suffix_without_a_reader_has_the_export_that_helps(tmp_path, suffix):
    assert suffix not in READERS
    (tmp_path / f"run{suffix}").write_bytes(b"anything")
    with pytest.raises(DataError) as caught:
        read(tmp_path / f"run{suffix}", {"velocity": "laser"})
    assert caught.value.remedy == EXPORTS[suffix]
    with pytest.raises(DataError) as caught:
        start_campaign(tmp_path)
    assert EXPORTS[suffix] in caught.value.remedy


def test_a_universal_file_of_shapes_alone_is_named_for_what_it_holds(tmp_path):
    pytest.importorskip("pyuff")
    lines = ["    -1", "  2411", "         1         1         1        11", "    -1",
             "    -1", "    55", "NONE", "    -1"]  # fmt: skip
    (tmp_path / "shapes.unv").write_text("\n".join(lines) + "\n")
    with pytest.raises(DataError, match=r"no data set of type 58 .* of type 55, 2411") as caught:
        read(tmp_path / "shapes.unv", {"velocity": "set[0]"})
    assert "UFF 58" in caught.value.remedy


def test_files_of_models_and_of_netcdf_3_are_no_damage(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "model.h5", "w") as file:
        file["NASTRAN/RESULT/MODES"], file["INDEX/MODES"] = [1.0], [1.0]
    with pytest.raises(DataError, match="Nastran model"):
        read(tmp_path / "model.h5", {"velocity": "v"})
    scipy_io = pytest.importorskip("scipy.io")
    with scipy_io.netcdf_file(tmp_path / "run.nc", "w") as file:
        file.createDimension("time", 9)
        file.createVariable("velocity", "f8", ("time",))[:] = np.arange(9.0)
    with pytest.raises(DataError, match="is NetCDF 3") as caught:
        read(tmp_path / "run.nc", {"velocity": "velocity"})
    assert "nccopy" in caught.value.remedy
