"""`jbw check` on a folder with one fault of each kind: one line each, row by row."""

import json
import subprocess
import sys

import numpy as np
import pytest
from faulty_folder import FAULTS, write_folder
from faulty_records import FS, N, good, tone

from jbw.campaign.load import load_campaign
from jbw.campaign.schema import parse
from jbw.errors import ConfigError, DataError
from jbw.measurement.harmonics import harmonics
from jbw.measurement.records import Record


@pytest.fixture(scope="module")
def checked(tmp_path_factory):
    """What `jbw check --json` prints, in a process of its own, and its exit code."""
    path = write_folder(tmp_path_factory.mktemp("faults"))
    command = "import sys; from jbw.cli import main; main(['check', sys.argv[1], *sys.argv[2:]])"
    ended = [
        subprocess.run(
            [sys.executable, "-c", command, str(path), *more],
            capture_output=True, text=True, check=False, timeout=120,
        )
        for more in (["--json"], [])
    ]  # fmt: skip
    return json.loads(ended[0].stdout), ended[1].stdout, [one.returncode for one in ended]


@pytest.mark.fault(
    1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23,
    24, 46, 47, 48, 49, 50, 51, 54,
)  # fmt: skip
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: f"row {fault.row}")
def test_fault_is_found(checked, fault):
    rows = [row for row in checked[0]["channels"] if row["test"] == fault.row]
    findings = [finding for row in rows for finding in row["findings"]]
    worst = {finding["severity"] for finding in findings} or {"ok"}
    assert fault.status in worst, findings
    if fault.status != "error":
        assert "error" not in worst, findings
    if fault.status == "ok":
        assert not findings
        assert {row["fs"] for row in rows} == {FS}
        return
    told = [f for f in findings if fault.says in f["what"] and fault.remedy in f["remedy"]]
    assert told, findings
    if fault.role:
        assert [row["role"] for row in rows if told[0] in row["findings"]] == [fault.role]
    assert told[0]["what"].count("\n") == 0
    assert any(name in told[0]["what"] for name in ("noise", "a."))  # the file


def test_table_has_a_line_for_every_channel_and_the_remedies(checked):
    found, printed, codes = checked
    assert codes == [3, 3]
    assert found["status"] == "error"
    lines = printed.splitlines()
    for fault in FAULTS:
        assert any(f" {fault.row} " in line and f" {fault.status} " in line for line in lines)
    squeezed = " ".join(printed.split())
    for row in found["channels"]:
        for finding in row["findings"]:
            assert " ".join(finding["remedy"].split()) in squeezed


def test_one_fault_gives_one_line(checked):
    """No fault sets off a second alarm."""
    for fault in FAULTS:
        rows = [row for row in checked[0]["channels"] if row["test"] == fault.row]
        whats = {finding["what"] for row in rows for finding in row["findings"]}
        assert len(whats) == (fault.status != "ok"), (fault.row, whats)


# --- rows whose fault is the campaign file's, which is refused as a whole ---


def refused(text):
    with pytest.raises(ConfigError) as caught:
        parse(text)
    return str(caught.value)


BASE = '[[test]]\nkind = "noise"\nfiles = "{files}"\nchannels = {{ input = "u", velocity = "v" }}\n'


@pytest.mark.fault(10)
@pytest.mark.parametrize(
    ("unit", "nearest"), [("m/z", "m/s"), ("mm\\\\s", "mm/s"), ("mps", "m/s"), ("vV", "V")]
)
def test_row_10_unknown_unit(unit, nearest):
    role = "input" if nearest == "V" else "velocity"
    message = refused(BASE.format(files="a.h5") + f'units = {{ {role} = "{unit}" }}')
    assert f"Role `{role}`: Unit" in message
    assert f"`{nearest}`" in message or nearest in message.split("Known: ")[1]


@pytest.mark.fault(52)
@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("lvel = 1", "did you mean `level`"),
        ("level = '1'", "level: must be a number"),
        ("level = 1\nlevel = 2", "not valid TOML"),
        ("level: !!python/name:os.system", "not valid TOML"),
    ],
)
def test_row_52_campaign_file(line, says):
    assert says in refused(BASE.format(files="a.h5") + line)


@pytest.mark.fault(53)
@pytest.mark.parametrize("files", ["../../x.h5", "/etc/passwd", "http://x.org/a.h5", "~/a.h5"])
def test_row_53_paths_and_addresses(tmp_path, files):
    (tmp_path / "campaign.toml").write_text(BASE.format(files=files))
    with pytest.raises((ConfigError, DataError)) as caught:
        load_campaign(tmp_path / "campaign.toml")
    assert files in caught.value.what
    assert any(word in str(caught.value) for word in ("points outside", "URL", "matches nothing"))


# --- numbers behind rows that check as ok ---


def loaded(tmp_path, write):
    keys = write(tmp_path)
    (tmp_path / "campaign.toml").write_text(
        f'[[test]]\nkind = "{keys["kind"]}"\nfiles = "{keys["files"]}"\n'
        'channels = { input = "input", velocity = "velocity" }\n'
        'units = { input = "V", velocity = "m/s" }\nfs = 1024\n'
    )
    return load_campaign(tmp_path / "campaign.toml").tests[0].records


@pytest.mark.fault(15)
def test_row_15_repeats_keep_their_lengths(tmp_path):
    lengths = next(fault.write for fault in FAULTS if fault.row.startswith("15"))
    assert [record.num_samples for record in loaded(tmp_path, lengths)] == [N, N - 2000, N // 2]


@pytest.mark.fault(49)
def test_row_49_decimal_comma_is_read_and_said(tmp_path):
    comma = next(fault.write for fault in FAULTS if fault.row == "49: decimal comma")
    (record,) = loaded(tmp_path, comma)
    # Ten printed digits.
    np.testing.assert_allclose(record.channels["velocity"], good()["velocity"], rtol=1e-9)
    assert record.provenance["decimal mark"] == ","
    assert record.provenance["delimiter"] == "semicolon"


@pytest.mark.fault(20)
def test_row_20_tone_off_the_lines_is_read_exactly():
    found = harmonics(tone()["displacement"], FS, 2 * np.pi * 5.03, 3)
    np.testing.assert_allclose(np.abs(found.amplitudes[[0, 2]]), [1e-3, 1e-5], rtol=1e-9)
    # 16 s of 5.03 Hz are 80.48 periods; the distance to the nearest line is told.
    np.testing.assert_allclose(found.off_bin, 0.48, atol=1e-9)


@pytest.mark.fault(1)
def test_row_1_mask_of_a_curve_only(tmp_path):
    """`gaps = "mask"` is taken where the lines can be left out, and refused elsewhere."""
    message = refused(BASE.format(files="a.h5") + 'gaps = "mask"')
    assert "kind `noise` needs every sample" in message
    assert "exclude" in message
    freq = np.linspace(79.0, 81.0, 41)
    response = np.where(freq == freq[3], np.nan, 1.0)
    np.savez(tmp_path / "a.npz", f=freq, x=response, phi=np.linspace(-0.1, -3.0, 41), u=response)
    text = (
        '[[test]]\nkind = "frf"\nfiles = "a.npz"\nunits = { frequency = "Hz", force = "N", '
        'displacement = "mm", phase = "rad" }\n'
        'channels = { frequency = "f", force = "u", displacement = "x", phase = "phi" }\n'
    )
    (tmp_path / "campaign.toml").write_text(text)
    with pytest.raises(DataError, match="1 of 41"):
        load_campaign(tmp_path / "campaign.toml")
    (tmp_path / "campaign.toml").write_text(text + 'gaps = "mask"')
    with pytest.warns(UserWarning, match="1 of 41 samples are not finite; gaps"):
        (test,) = load_campaign(tmp_path / "campaign.toml").tests
    record = test.records[0]
    assert isinstance(record, Record)
    assert record.valid.sum() == 40
    assert not record.valid[3]
