"""From the campaign file to records; faults of paths and of data; the draft that loads back."""

import subprocess
import sys

import numpy as np
import pytest

from jbw.campaign.check import check_campaign
from jbw.campaign.draft import start_campaign, write_campaign
from jbw.campaign.load import load_campaign
from jbw.errors import ConfigError, DataError
from jbw.measurement.files.hdf5 import write_hdf5
from jbw.measurement.records import Record, belongs_to

FS = 1024.0
N = 4096
UNITS = {"input": "V", "velocity": "m/s"}
NAMES = {"input": "shaker", "velocity": "laser"}


def signals(seed=0):
    """White noise through a lightly damped resonance at 40 Hz, by its difference equation."""
    u = np.random.default_rng(seed).normal(size=N)
    v, radius, angle = np.zeros(N), 0.99, 2 * np.pi * 40 / FS
    for n in range(2, N):
        v[n] = 2 * radius * np.cos(angle) * v[n - 1] - radius**2 * v[n - 2] + 1e-3 * u[n]
    return {"input": u, "velocity": v}


def campaign_file(folder, kind="noise", extra="", files='"noise_*.h5"'):
    path = folder / "campaign.toml"
    path.write_text(
        f'[[test]]\nkind = "{kind}"\nfiles = {files}\n'
        'channels = { input = "shaker", velocity = "laser" }\n'
        f'units = {{ input = "V", velocity = "m/s" }}\n{extra}\n',
        encoding="utf-8",
    )
    return path


@pytest.fixture
def folder(tmp_path):
    for i in (1, 2, 10):
        record = Record(FS, signals(i), UNITS, f"noise_{i}")
        write_hdf5(tmp_path / f"noise_{i}.h5", record, names=NAMES)
    return tmp_path


def spoil(folder, channel, change):
    """Rewrite noise_2.h5 with one channel changed."""
    samples = signals(2)
    samples[channel] = change(samples[channel])
    write_hdf5(folder / "noise_2.h5", Record(FS, samples, UNITS), names=NAMES)


def refused(path, error=DataError, **kwargs):
    with pytest.raises(error) as caught:
        load_campaign(path, **kwargs)
    return caught.value


def test_repeats_come_in_natural_order(folder):
    campaign = load_campaign(campaign_file(folder, extra="level = 0.05"))
    (test,) = campaign.tests
    assert [record.name for record in test.records] == ["noise_1.h5", "noise_2.h5", "noise_10.h5"]
    np.testing.assert_array_equal(test.records[2].channels["velocity"], signals(10)["velocity"])
    assert (test.name, test.kind, test.level) == ("noise 0.05", "noise", 0.05)
    assert (campaign.gain, campaign.modal_mass, campaign.name) == (None, None, "campaign")


def test_equal_tests_get_numbered_names(folder):
    first = campaign_file(folder, files='"noise_1.h5"').read_text()
    path = campaign_file(folder, files='"noise_2.h5"')
    path.write_text(first + path.read_text())
    assert [test.name for test in load_campaign(path).tests] == ["noise", "noise (2)"]


@pytest.mark.parametrize("exclude", ["[1]", '["noise_2.h5"]', '["*_2*"]'])
def test_excluded_repeats_are_not_even_checked(folder, exclude):
    spoil(folder, "velocity", lambda v: v * np.nan)
    assert "noise_2.h5, channel `velocity`" in refused(campaign_file(folder)).what
    (test,) = load_campaign(campaign_file(folder, extra=f"exclude = {exclude}")).tests
    assert [record.name for record in test.records] == ["noise_1.h5", "noise_10.h5"]


def test_excluded_file_may_be_unreadable(folder):
    (folder / "noise_2.h5").write_bytes(b"junk")
    (test,) = load_campaign(campaign_file(folder, extra='exclude = "noise_2.h5"')).tests
    assert len(test.records) == 2


@pytest.mark.parametrize("exclude", ["[7]", '["nois_2.h5"]'])
def test_exclude_that_excludes_nothing(folder, exclude):
    error = refused(campaign_file(folder, extra=f"exclude = {exclude}"), ConfigError)
    assert "not one of its 3 repeats" in error.what


def test_nothing_left(folder):
    assert "no repeats left" in refused(campaign_file(folder, extra="exclude = [0, 1, 2]")).what


@pytest.mark.fault(53)
@pytest.mark.parametrize("files", ['"../x.h5"', '"../../etc/passwd"', '"/etc/*"', '"a/../../x"'])
def test_paths_stay_inside(folder, files):
    error = refused(campaign_file(folder, files=files), ConfigError)
    assert "points outside the campaign's folder" in error.what
    assert "--allow-outside" in error.remedy


@pytest.mark.fault(53)
def test_a_symbolic_link_out_needs_leave(folder, tmp_path_factory):
    outside = tmp_path_factory.mktemp("outside") / "noise_1.h5"
    (folder / "noise_1.h5").rename(outside)
    (folder / "noise_1.h5").symlink_to(outside)
    path = campaign_file(folder)
    assert "points outside" in refused(path, ConfigError).what
    assert len(load_campaign(path, allow_outside=True).tests[0].records) == 3


@pytest.mark.fault(53)
@pytest.mark.parametrize("files", ['"http://x.org/a.h5"', '"file:///etc/passwd"', '"s3://b/a.h5"'])
def test_urls_are_refused_even_with_leave(folder, files):
    error = refused(campaign_file(folder, files=files), ConfigError, allow_outside=True)
    assert "URL" in error.what
    assert "Download" in error.remedy


@pytest.mark.parametrize("files", ['"nois_1.h5"', '"nose_*.h5"'])
def test_missing_files_list_what_is_there(folder, files):
    error = refused(campaign_file(folder, files=files))
    assert "matches nothing" in error.what
    assert "Did you mean `noise_" in error.remedy


def test_missing_campaign_file(tmp_path):
    assert "jbw init" in refused(tmp_path / "none.toml", ConfigError).remedy


@pytest.mark.fault(21)
def test_tone_too_near_half_the_rate(folder):
    error = refused(campaign_file(folder, "tones", "tones = [200.0]"))
    assert "Tone 200 Hz must lie below" in error.what
    assert "Leave the tone out" in error.remedy


def test_band_above_half_the_rate(folder):
    error = refused(campaign_file(folder, extra="band = [5, 600]"))
    assert "`band` ends at 600 Hz" in error.what


def test_stepped_record_too_short(folder):
    extra = "tones = [3.0, 4.0, 5.0]\ndwell = 2.0"
    assert (
        "lasts 4 s, but the steps take 6 s" in refused(campaign_file(folder, "stepped", extra)).what
    )


def test_repeats_of_different_rates(folder):
    write_hdf5(folder / "noise_2.h5", Record(2048.0, signals(2), UNITS), names=NAMES)
    error = refused(campaign_file(folder))
    assert "2048 Hz and noise_1.h5 has 1024 Hz" in error.what


@pytest.mark.fault(15)
def test_repeats_may_differ_in_length(folder):
    short = {role: samples[:1000] for role, samples in signals(2).items()}
    write_hdf5(folder / "noise_2.h5", Record(FS, short, UNITS), names=NAMES)
    (test,) = load_campaign(campaign_file(folder)).tests
    assert [record.num_samples for record in test.records] == [N, 1000, N]


@pytest.mark.fault(4)
@pytest.mark.parametrize("factor", [2 * np.pi, 2.0])
def test_wrong_rate_shows_beside_the_band(folder, factor):
    for i in (1, 2, 10):
        record = Record(FS * factor, signals(i), UNITS)
        write_hdf5(folder / f"noise_{i}.h5", record, names=NAMES)
    path = campaign_file(folder, extra="band = [30.0, 50.0]")
    with pytest.warns(UserWarning, match=r"outside `band` = \[30, 50\] Hz") as caught:
        load_campaign(path)
    assert "Check `fs` and `band`" in str(caught[0].message)


def test_a_record_that_begins_in_motion_is_doubted(tmp_path):
    """Followed from rest it would be a misfit; what is cut off at the start is not compared."""
    whole = signals()
    rows = {"from_rest": slice(None), "in_motion": slice(1500, None)}
    for name, part in rows.items():
        record = Record(FS, {role: x[part] for role, x in whole.items()}, UNITS, name)
        write_hdf5(tmp_path / f"{name}.h5", record, names=NAMES)

    def said(name, extra=""):
        path = campaign_file(tmp_path, "sweep", extra, f'"{name}.h5"')
        faults = [fault for row in check_campaign(path).rows for fault in row.findings]
        return " ".join(str(fault) for fault in faults)

    assert "begins with" not in said("from_rest")
    assert "Set `settle`" in said("in_motion")
    assert "begins with" not in said("in_motion", "settle = 0.5\n")


@pytest.mark.fault(13)
def test_swapped_channels_are_doubted(folder):
    path = campaign_file(folder)
    swapped = path.read_text().replace('"shaker"', '"_"').replace('"laser"', '"shaker"')
    path.write_text(swapped.replace('"_"', '"laser"'))
    with pytest.raises(DataError, match="in the file"):  # the file's own units tell
        load_campaign(path)
    for i in (1, 2, 10):
        samples = signals(i)
        turned = {"input": samples["velocity"], "velocity": samples["input"]}
        write_hdf5(folder / f"noise_{i}.h5", Record(FS, turned, UNITS), names=NAMES)
    with pytest.warns(UserWarning, match="more peaked than the spectrum of the response"):
        load_campaign(campaign_file(folder))


def test_good_campaign_gives_no_warning(folder, recwarn):
    load_campaign(campaign_file(folder, extra="band = [30.0, 50.0]"))
    assert not recwarn.list


# --- check ---


def test_check_goes_on_after_a_fault(folder):
    spoil(folder, "velocity", lambda v: np.clip(v, -1, 0.5 * v.max()))
    (folder / "noise_1.h5").write_bytes(b"junk")
    found = check_campaign(campaign_file(folder))
    assert (found.status, found.exit_code) == ("error", 3)
    first, second = found.rows
    assert (first.role, first.repeats, first.fs, first.status) == ("input", 2, FS, "error")
    assert "noise_1.h5" in first.findings[0].what
    assert "noise_2.h5" in second.findings[0].what
    assert "clipped" in second.findings[0].what
    assert "exclude" in second.findings[0].remedy


def test_check_of_a_sound_campaign(folder):
    found = check_campaign(campaign_file(folder))
    assert (found.status, found.exit_code) == ("ok", 0)
    assert [row.status for row in found.rows] == ["ok", "ok"]


def test_check_tells_the_campaign_file_from_the_data(folder):
    assert check_campaign(campaign_file(folder, extra="exclude = [9]")).exit_code == 2


# --- init ---


def test_draft_of_described_records_loads_back(folder):
    draft = start_campaign(folder)
    assert draft.assumed == ()
    campaign = load_campaign(write_campaign(draft, folder))
    (test,) = campaign.tests
    assert (test.kind, len(test.records)) == ("noise", 3)
    assert set(test.records[0].channels) == {"input", "velocity"}


def test_draft_of_csv_files_loads_back_and_marks_its_guesses(tmp_path):
    folder = tmp_path / 'Träger "A" #1'
    folder.mkdir()
    t = np.arange(N) / FS
    table = np.column_stack([t, *signals().values()])
    for i in (1, 2):
        np.savetxt(
            folder / f"run {i}.csv", table, delimiter=";", header="t;drive [V]\n;laser", comments=""
        )
    np.savetxt(folder / "decay_1.csv", table, delimiter=",", header="t,drive,laser", comments="")
    draft = start_campaign(folder)
    assert "unit of velocity is assumed to be the SI unit, m/s" in " ".join(draft.assumed)
    assert "# CHECK" in draft.text
    assert load_campaign(write_campaign(draft, folder)).tests[0].kind == "decay"


def test_draft_never_overwrites(folder):
    path = campaign_file(folder)
    before = path.read_text()
    with pytest.raises(ConfigError, match="exists already"):
        write_campaign(start_campaign(folder), folder)
    assert path.read_text() == before


def test_names_from_files_cannot_write_toml(tmp_path):
    evil = 'x"\n[identify]\nseed = 1\n#'
    np.savez(tmp_path / "noise_1.npz", velocity=signals()["velocity"], **{evil: np.arange(9.0)})
    draft = start_campaign(tmp_path)
    assert "\n[identify]" not in draft.text


@pytest.mark.parametrize("name", ["", "notes.md"])
def test_folder_without_records(tmp_path, name):
    if name:
        (tmp_path / name).write_text("x")
    with pytest.raises(DataError, match="no measurement file") as caught:
        start_campaign(tmp_path)
    assert ".h5" in caught.value.remedy


def test_campaign_needs_no_jax():
    code = (
        "import sys, jbw.campaign.check, jbw.campaign.draft\n"
        "sys.exit(str([m for m in ('jax', 'arviz', 'matplotlib') if m in sys.modules] or ''))"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert ended.stderr.strip() == b""


@pytest.mark.parametrize(
    ("label", "name", "belongs"),
    [
        ("sweep", "sweep", True),
        ("sweep 3", "sweep", True),
        ("sweep (2)", "sweep", False),  # the second test of this name
        ("sweep (2) 3", "sweep", False),
        ("sweep (2) 3", "sweep (2)", True),
        ("sweeps", "sweep", False),
    ],
)
def test_a_second_test_of_a_name_is_no_record_of_the_first(label, name, belongs):
    assert belongs_to(label, name) == belongs
