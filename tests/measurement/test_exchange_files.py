"""Formats of other systems, written by their own libraries: UFF 58, TDMS, SEP-005, WAV in parts."""

import numpy as np
import pytest
import scipy.io.wavfile
from uff_files import write_uff

from jbw.campaign.check import check_campaign
from jbw.errors import ConfigError, DataError
from jbw.measurement.curves import displacement_of, response_curve
from jbw.measurement.files.read import read
from jbw.measurement.files.sep005 import from_sep005, to_sep005
from jbw.measurement.records import Record

FS = 1024.0
N = 3000
T = np.arange(N) / FS
DRIVE = np.sin(2 * np.pi * 5.1 * T + 1.0)
LASER = 0.3 * np.cos(2 * np.pi * 5.1 * T)
UNITS = {"input": "V", "velocity": "m/s"}
RECORD = Record(FS, {"input": DRIVE, "velocity": LASER}, UNITS, "sweep")


def refused(path, *args, error=DataError, **kwargs):
    with pytest.raises(error) as caught:
        read(path, *args, **kwargs)
    return caught.value


# --- UFF 58 ---


@pytest.mark.parametrize("binary", [False, True])
def test_uff_round_trip(tmp_path, binary):
    write_uff(tmp_path / "a.uff", RECORD, binary=binary)
    (record,) = read(tmp_path / "a.uff")
    # The interval 0.000976562 s of the file would be 1024.0005 Hz.
    assert record.fs == FS
    assert "snapped from 1024.000" in record.provenance["fs"]
    # Eleven decimals in ASCII; every bit in binary.
    tolerance = 0.0 if binary else 1e-11
    for role, samples in RECORD.channels.items():
        np.testing.assert_allclose(record.channels[role], samples, rtol=tolerance)
    assert record.units == UNITS
    assert list(tmp_path.iterdir()) == [tmp_path / "a.uff"]


@pytest.mark.fault(6)
@pytest.mark.parametrize("fs", [51200.0, 25600.0, 4096.0, 1000.0, 102400.0])
def test_uff_interval_means_the_round_rate(tmp_path, fs):
    write_uff(tmp_path / "a.uff", Record(fs, RECORD.channels, UNITS), binary=True)
    (record,) = read(tmp_path / "a.uff")
    assert record.fs == fs


@pytest.mark.fault(46)
@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("how", ["half", "junk", "empty"])
def test_damaged_uff_is_refused(tmp_path, binary, how):
    path = tmp_path / "a.uff"
    write_uff(path, RECORD, binary=binary)
    data = path.read_bytes()
    size = len(data)
    junk = np.random.default_rng(0).bytes(size)
    path.write_bytes({"half": data[: size * 2 // 3], "junk": junk, "empty": b""}[how])
    error = refused(path, {"velocity": "velocity"})
    assert "a.uff" in error.what
    assert "again" in error.remedy


def test_uff_frequency_response(tmp_path):
    """A measured FRF is complex, against frequency; its level makes a response curve of it."""
    pyuff = pytest.importorskip("pyuff")
    freq = np.linspace(70.0, 90.0, 201)
    omega, omega_n = 2 * np.pi * freq, 2 * np.pi * 80.0
    h = -(omega**2) / 1.9 / (omega_n**2 - omega**2 + 2j * 0.002 * omega_n * omega)
    fields = {
        "type": 58, "func_type": 4, "binary": 1, "id1": "acc", "rsp_node": 1, "rsp_dir": 1,
        "ref_node": 1, "ref_dir": 1, "abscissa_spacing": 1, "data": h, "x": freq,
        "orddenom_spec_data_type": 13,
    }  # fmt: skip
    pyuff.UFF(str(tmp_path / "a.uff")).write_sets(fields, mode="add")
    roles = {"frequency": "set[0].frequency", "acceleration": "acc.response"}
    (record,) = read(tmp_path / "a.uff", roles, {"acceleration": "m/s^2/N"})
    curve = response_curve(record)
    assert (curve.source_kind, record.units["force"]) == ("force", "N")
    np.testing.assert_array_equal(curve.source, 1.0)
    np.testing.assert_allclose(displacement_of(curve), h / (1j * omega) ** 2, rtol=1e-12)


# --- TDMS ---


@pytest.fixture
def tdms(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    path = tmp_path / "a.tdms"
    with nptdms.TdmsWriter(path) as writer:
        for part in np.array_split(np.arange(N), 3):  # three segments, as recorders write
            writer.write_segment(
                [
                    nptdms.ChannelObject(
                        "Log 1", name, samples[part], {"wf_increment": 1 / FS, "unit_string": unit}
                    )
                    for name, samples, unit in (("ai0.drive", DRIVE, "V"), ("laser", LASER, "m/s"))
                ]
            )
    return path


TDMS_ROLES = {"input": "Log 1.ai0.drive", "velocity": "Log 1/laser"}


def test_tdms_with_its_rate_and_units(tdms):
    (record,) = read(tdms, TDMS_ROLES)
    np.testing.assert_array_equal(record.channels["input"], DRIVE)
    np.testing.assert_array_equal(record.channels["velocity"], LASER)
    assert (record.fs, record.units) == (FS, UNITS)
    assert record.provenance["reader"] == "TDMS"
    (part,) = read(tdms, TDMS_ROLES, span=(0.5, 1.5))
    np.testing.assert_array_equal(part.channels["velocity"], LASER[512:1536])


def test_stale_index_beside_a_tdms_is_not_believed(tdms):
    nptdms = pytest.importorskip("nptdms")
    other = tdms.with_name("other.tdms")
    with nptdms.TdmsWriter(str(other), index_file=True) as writer:
        writer.write_segment([nptdms.ChannelObject("Log 1", "laser", LASER[:7])])
    other.with_name("other.tdms_index").rename(tdms.with_name("a.tdms_index"))
    (record,) = read(tdms, TDMS_ROLES)
    np.testing.assert_array_equal(record.channels["velocity"], LASER)


@pytest.mark.fault(46)
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("how", ["half", "end", "junk", "empty"])
def test_damaged_tdms_is_refused(tdms, how):
    data = tdms.read_bytes()
    junk = np.random.default_rng(0).bytes(len(data))
    cut = {"half": data[: len(data) // 2], "end": data[:-8], "junk": junk, "empty": b""}[how]
    tdms.write_bytes(cut)
    error = refused(tdms, TDMS_ROLES)
    assert "a.tdms" in error.what
    assert f"({len(cut)} bytes)" in error.what
    assert "again" in error.remedy


@pytest.mark.parametrize("kept", [1, 4, 27])
def test_a_tdms_cut_within_a_lead_in_is_refused(tdms, kept):
    data = tdms.read_bytes()
    last = data.rindex(b"TDSm")  # the third segment, a third of the samples
    tdms.write_bytes(data[: last + kept])
    assert f"segment at byte {last} ends within the lead-in" in refused(tdms, TDMS_ROLES).what


@pytest.mark.parametrize(("late", "delay"), [(250_000, -0.25), (-1_500, 0.0015)])
def test_channels_that_started_apart_are_refused_and_delay_cures(tmp_path, late, delay):
    nptdms = pytest.importorskip("nptdms")
    first = np.datetime64("2026-03-01T10:00:00.000000")
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        writer.write_segment(
            [
                nptdms.ChannelObject(
                    "Log", name, samples,
                    {"wf_increment": 1 / FS, "unit_string": unit,
                     "wf_start_time": first + np.timedelta64(later, "us"), "wf_start_offset": 0.0},
                )
                for name, samples, unit, later in (
                    ("force", DRIVE, "N", 0), ("velocity", LASER, "m/s", late),
                )
            ]
        )  # fmt: skip
    path = tmp_path / "campaign.toml"
    path.write_text(
        '[[test]]\nkind = "sweep"\nfiles = "a.tdms"\n'
        'channels = { force = "Log.force", velocity = "Log.velocity" }\n'
    )
    apart = [f for row in check_campaign(path).rows for f in row.findings if "started" in f.what]
    assert [f.severity for f in apart] == ["error"]
    assert f"`delay = {delay:g}`" in apart[0].remedy
    path.write_text(path.read_text() + f"delay = {delay:g}\n")
    found = [f.what for row in check_campaign(path).rows for f in row.findings]
    assert not [what for what in found if "started" in what]


# --- SEP-005 ---


def test_sep005_out_is_valid_and_comes_back():
    validator = pytest.importorskip("sdypy_sep005.sep005")
    series = to_sep005(RECORD, {"velocity": "laser"})
    validator.assert_sep005(series)
    record = from_sep005(series, {"input": "input", "velocity": "laser"})
    np.testing.assert_array_equal(record.channels["velocity"], LASER)
    assert (record.fs, record.units, record.provenance["reader"]) == (FS, UNITS, "SEP-005")
    assert len(record.provenance["sha256"]) == 64


def test_sep005_in_other_units_by_time_and_quantity():
    force = {"name": "F", "data": list(DRIVE), "time": T, "unit_str": "kN", "quantity": "f"}
    acceleration = {"name": "A", "data": LASER, "fs": FS, "unit_str": "m/s²", "quantity": "a"}
    record = from_sep005([force, acceleration])
    np.testing.assert_allclose(record.channels["force"], DRIVE * 1e3)
    assert record.units == {"force": "N", "acceleration": "m/s^2"}


@pytest.mark.parametrize(
    ("change", "says", "error"),
    [
        ({"unit_str": None}, "has no `unit_str`", DataError),
        ({"unit_str": "m/blink"}, "Unit `m/blink`", ConfigError),
        ({"fs": None}, "sampling frequency is missing", DataError),
        ({"data": LASER.reshape(2, -1)}, "one axis of numbers", DataError),
        ({"data": np.where(T == 1.0, np.nan, LASER)}, "Samples must be finite", DataError),
        ({"time": T[:-1]}, "have 2999 and 3000", DataError),
    ],
)
def test_bad_sep005_is_refused(change, says, error):
    one = {"name": "velocity", "data": LASER, "fs": FS, "unit_str": "m/s"} | change
    with pytest.raises(error) as caught:
        from_sep005([{key: value for key, value in one.items() if value is not None}])
    assert says in caught.value.what


def test_sep005_series_need_different_names():
    with pytest.raises(DataError, match="2 series have the name"):
        from_sep005(to_sep005(RECORD) + to_sep005(RECORD))


# --- WAV ---


@pytest.mark.parametrize(("at", "value"), [(24, 2048), (28, 1024), (32, 4), (34, 24)])
def test_a_wav_whose_header_contradicts_itself_is_refused(tmp_path, at, value):
    """Rate, bytes a second, bytes a sample and bits, each changed alone."""
    path = tmp_path / "a.wav"
    scipy.io.wavfile.write(
        path, 1024, np.round(LASER / 2 * 2**15 / np.abs(LASER).max()).astype(np.int16)
    )
    read(path, {"velocity": "channel[0]"}, {"velocity": "m/s"}, scale={"velocity": 1.0})
    data = bytearray(path.read_bytes())
    data[at : at + 2] = value.to_bytes(2, "little")
    path.write_bytes(bytes(data))
    assert "the header contradicts itself" in refused(path, {"velocity": "channel[0]"}).what


def test_part_of_a_wav(tmp_path):
    path = tmp_path / "a.wav"
    samples = np.stack([DRIVE, LASER], axis=1)
    scipy.io.wavfile.write(path, 1024, np.round(samples * 2**15 * 0.9).astype(np.int16))
    roles, units = {"velocity": "channel(2)"}, {"velocity": "m/s"}
    (record,) = read(path, roles, units, scale={"velocity": 2.0}, span=(1.0, 2.0))
    # Half a step of 16 bits.
    np.testing.assert_allclose(record.channels["velocity"], 1.8 * LASER[1024:2048], atol=2**-15)
    assert record.provenance["full scale"] == "int16"
