"""Recorders' files drafted right: no wrong unit, no wrong rate, nine tenths without a question."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from corpus.dialects import ACCELERATION, DIALECTS, FORCE, FS, TRUTH, VELOCITY

from jbw.campaign.draft import start_campaign
from jbw.campaign.files import repeats_of
from jbw.campaign.schema import parse
from jbw.errors import DataError
from jbw.measurement.files.read import opened
from jbw.measurement.records import Record, si_of

LARGEST = 20_000  # bytes
OWN = Path(__file__).parent / "files"
EXPECTED = tomllib.loads((OWN / "expected.toml").read_text())
EXTRAS = {".uff": "pyuff", ".unv": "pyuff", ".tdms": "nptdms"}
each_dialect = pytest.mark.parametrize("name", DIALECTS)


def written(name, folder):
    """The file of a dialect."""
    found = DIALECTS[name]
    path = folder / found.file
    if path.suffix in EXTRAS:
        pytest.importorskip(EXTRAS[path.suffix])
    found.write(path)
    return path


def drafted(path):
    """The draft of a file's folder, its only test, and the record that the test means."""
    draft = start_campaign(path.parent)
    (test,) = parse(draft.text).tests
    (record,) = repeats_of(test, path.parent)
    assert isinstance(record, Record), record
    return draft, test, record


@each_dialect
def test_a_dialect_is_drafted_with_its_units_and_rate(tmp_path, name):
    path = written(name, tmp_path)
    expected = DIALECTS[name]
    assert path.stat().st_size <= LARGEST
    with opened(path) as contents:
        assert contents.recorder == expected.recorder
    if not expected.roles:
        draft = start_campaign(tmp_path)
        assert "test" not in tomllib.loads(draft.text)
        assert expected.asks
        return
    draft, test, record = drafted(path)
    asked = [line for line in draft.assumed if "band" not in line]
    assert bool(asked) == expected.asks, asked
    assert test.kind == expected.kind
    np.testing.assert_equal(record.fs, expected.fs)
    assert set(expected.roles) <= set(record.channels)
    truth = expected.truth or {role: TRUTH[role] for role in expected.roles}
    for role, samples in truth.items():
        assert len(record.channels[role]) == len(samples)
        inner = slice(40, -40) if expected.fs != FS and record.fs == record.fs else slice(None)
        tolerance = expected.rtol * np.abs(samples).max()
        np.testing.assert_allclose(
            record.channels[role][inner], samples[inner], rtol=0, atol=tolerance
        )


def test_nine_tenths_are_drafted_without_a_question():
    assert len(DIALECTS) >= 55
    asking = [name for name, each in DIALECTS.items() if each.asks]
    assert len(asking) <= 0.1 * len(DIALECTS), asking


@pytest.mark.parametrize("name", EXPECTED)
def test_a_file_of_a_newcomer_is_drafted_as_its_line_says(tmp_path, name):
    path = tmp_path / name
    path.write_bytes((OWN / name).read_bytes())
    assert path.stat().st_size <= LARGEST
    _, test, record = drafted(path)
    line = EXPECTED[name]
    assert (test.kind, record.fs) == (line["kind"], line["fs"])
    for role in line.keys() - {"kind", "fs"}:
        unit, largest = line[role]
        assert si_of(role, test.units[role]) == si_of(role, unit)
        np.testing.assert_allclose(np.abs(record.channels[role]).max(), largest, rtol=1e-12)


def test_every_file_of_a_newcomer_has_its_line():
    assert {path.name for path in OWN.iterdir()} - {"expected.toml"} == set(EXPECTED)


def test_the_provenance_says_what_labview_left_out(tmp_path):
    path = written("labview_packets_under_one_header", tmp_path)
    _, _, record = drafted(path)
    said = "2 packets under one header, read as one record without a pause"
    assert record.provenance["packets"] == said
    said = record.provenance["digits of Delta_X"]
    assert "a relative error of 5.1e-04" in said  # 0.5e-6 / 0.000977


@pytest.mark.parametrize(("old", "new"), [("Headings\tNo", "Headings\tYes"), ("\t192", "\t191")])
def test_samples_that_a_labview_header_does_not_declare_are_refused(tmp_path, old, new):
    path = written("labview_packets_under_one_header", tmp_path)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(DataError, match=r"declares 19\d samples, but has 384"), opened(path):
        pass


def test_a_file_of_rigol_starts_where_it_says(tmp_path):
    path = written("rigol", tmp_path)
    path.write_text(path.read_text().replace("mm/s,0.0,", "mm/s,-1.370000e-05,"))
    with opened(path) as contents:
        assert contents.series
        assert {item.start_s for item in contents.series.values()} == {-1.37e-5}


# --- against other readers ---


def test_xarray_writes_dates_that_are_read_the_same(tmp_path):
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    time = np.datetime64("2026-03-01", "ns") + np.arange(384) * np.timedelta64(1_000_000, "ns")
    force = ("time", FORCE, {"units": "N"})
    velocity = ("time", VELOCITY, {"units": "m s-1"})
    path = tmp_path / "sweep_1.nc"
    made = xarray.Dataset({"force": force, "velocity": velocity}, {"time": time})
    made.to_netcdf(path, engine="h5netcdf")
    _, _, record = drafted(path)
    assert record.fs == 1000.0
    np.testing.assert_array_equal(record.channels["velocity"], VELOCITY)


def test_pyuff_reads_the_same(tmp_path):
    pyuff = pytest.importorskip("pyuff")
    path = written("uff_named_by_identification", tmp_path)
    sets = pyuff.UFF(str(path)).read_sets()
    _, _, record = drafted(path)
    for found, role in zip(sets, ("force", "velocity"), strict=True):
        np.testing.assert_array_equal(record.channels[role], found["data"])
        np.testing.assert_allclose(1 / found["abscissa_inc"], record.fs, rtol=5e-6)


def test_nptdms_reads_the_same(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    path = written("tdms_with_unit_words", tmp_path)
    force, velocity = nptdms.TdmsFile.read(path)["Log"].channels()
    _, _, record = drafted(path)
    np.testing.assert_array_equal(record.channels["force"], force[:])
    np.testing.assert_array_equal(record.channels["velocity"], 0.0254 * velocity[:])
    assert record.fs == 1 / force.properties["wf_increment"]


def test_scipy_reads_the_same(tmp_path):
    path = written("pulse_flat", tmp_path)
    loaded = scipy.io.loadmat(path, squeeze_me=True)
    _, _, record = drafted(path)
    np.testing.assert_array_equal(record.channels["force"], loaded["Channel_1_Data"])
    assert record.fs == float(loaded["File_Header"]["SampleFrequency"].item())


def test_the_signals_are_what_they_are_said_to_be():
    assert FORCE.shape == VELOCITY.shape == ACCELERATION.shape
