"""What commands may be given: campaign files, folders of one, records, folders of records."""

import json
from pathlib import Path

import numpy as np
import pytest

from jbw.campaign.load import load_campaign
from jbw.cli import run
from jbw.cli.given import campaigns_of
from jbw.errors import ConfigError, DataError

FS, HZ, ZETA = 1024.0, 40.0, 0.004


def taps(folder, *names):
    """Free decays in closed form."""
    folder.mkdir(exist_ok=True)
    t, omega = np.arange(4096) / FS, 2 * np.pi * HZ
    noise = np.random.default_rng(0)
    for i, name in enumerate(names):
        x = np.exp(-ZETA * omega * t) * np.cos(omega * t) / (1 + i)
        x += 1e-4 * noise.standard_normal(len(t))
        table = np.column_stack([t, x])
        head = "time (s),acceleration (m/s^2)"
        np.savetxt(folder / name, table, delimiter=",", header=head, comments="", fmt="%.8g")
    return [folder / name for name in names]


def given(*paths):
    said = []
    return campaigns_of(paths, said.append), said


def test_records_become_one_campaign_of_these_records(tmp_path):
    first, second, _ = taps(tmp_path, "tap_1.csv", "tap_2.csv", "tap_3.csv")
    (path,), said = given(first, second)
    assert path == tmp_path / "tap.toml"
    assert said[0].endswith(str(path))
    assert said[1].startswith("CHECK: ")
    (test,) = load_campaign(path).tests
    assert [record.name for record in test.records] == ["tap_1.csv", "tap_2.csv"]
    written = path.read_text()
    assert given(first, second)[0] == [path]  # drafted once
    assert path.read_text() == written


def test_a_pattern_stands_for_the_records_that_match_it(tmp_path):
    """Some shells hand a pattern on as it is."""
    taps(tmp_path, "tap_1.csv", "tap_2.csv", "hit_1.csv")
    (path,), _ = given(tmp_path / "tap_*.csv")
    (test,) = load_campaign(path).tests
    assert [record.name for record in test.records] == ["tap_1.csv", "tap_2.csv"]
    with pytest.raises(ConfigError, match="does not exist"):
        given(tmp_path / "blow_*.csv")


def test_one_record_has_a_campaign_of_its_own_name(tmp_path):
    first, *_ = taps(tmp_path, "tap_1.csv", "tap_2.csv")
    assert given(first)[0] == [tmp_path / "tap_1.toml"]


def test_a_modal_mass_goes_into_what_is_drafted_and_nowhere_else(tmp_path):
    first, *_ = taps(tmp_path, "tap_1.csv")
    (path,) = campaigns_of([first], print, 0.8)
    assert load_campaign(path).modal_mass == 0.8
    for again in (first, path, tmp_path):
        with pytest.raises(ConfigError, match="exists already") as refused:
            campaigns_of([again], print, 0.9)
        assert "modal_mass = 0.9" in refused.value.remedy
    with pytest.raises(ConfigError, match="above zero"):
        campaigns_of(taps(tmp_path, "other.csv"), print, -1.0)


def test_a_folder_of_folders_stands_for_their_campaigns(tmp_path):
    units = [tmp_path / "units" / name for name in ("b", "a")]
    for unit in units:
        unit.mkdir(parents=True)
        given(*taps(unit, "tap.csv"))
    (tmp_path / "units" / "notes").mkdir()
    assert given(tmp_path / "units")[0] == [unit / "tap.toml" for unit in reversed(units)]
    (units[0] / "tap.toml").unlink()  # a folder of records is drafted
    assert given(tmp_path / "units")[0] == [units[1] / "tap.toml", units[0] / "campaign.toml"]
    taps(tmp_path / "units", "tap.csv")  # a folder with records of its own is one campaign
    assert given(tmp_path / "units")[0] == [tmp_path / "units" / "campaign.toml"]


def test_init_drafts_every_folder_of_a_folder(tmp_path, capsys):
    for name in ("bracket_1_6Nm", "bracket_2_12Nm"):
        (tmp_path / name).mkdir()
        taps(tmp_path / name, "tap_1.csv", "tap_2.csv")
    assert run(["init", str(tmp_path)]) == 0
    paths = capsys.readouterr().out.split()
    assert paths == [str(tmp_path / f"bracket_{n}" / "campaign.toml") for n in ("1_6Nm", "2_12Nm")]
    assert [load_campaign(path).assembly.torque for path in paths] == [6.0, 12.0]
    assert run(["init", str(tmp_path), "--print", "--json"]) == 3  # both have a campaign now
    capsys.readouterr()
    for path in paths:
        Path(path).unlink()
    assert run(["init", str(tmp_path), "--json"]) == 0
    assert [draft["campaign"] for draft in json.loads(capsys.readouterr().out)] == paths
    assert run(["check", str(tmp_path)]) == 2
    assert f"Name the file in this folder: {paths[0]}" in capsys.readouterr().err


def test_a_folder_is_its_campaign_or_is_drafted(tmp_path):
    taps(tmp_path / "a", "tap_1.csv", "tap_2.csv")
    drafted = tmp_path / "a" / "campaign.toml"
    assert given(tmp_path / "a")[0] == [drafted]
    assert given(tmp_path / "a")[1] == []
    drafted.rename(tmp_path / "a" / "mine.toml")
    assert given(tmp_path / "a")[0] == [tmp_path / "a" / "mine.toml"]
    others = taps(tmp_path / "b", "blow.csv")
    campaigns, _ = given(tmp_path / "a", *others)
    assert campaigns == [tmp_path / "a" / "mine.toml", tmp_path / "b" / "blow.toml"]


def test_a_campaign_of_other_records_is_not_overwritten(tmp_path):
    first, second, third = taps(tmp_path, "tap_1.csv", "tap_2.csv", "tap_3.csv")
    given(first, second)
    kept = (tmp_path / "tap.toml").read_text()
    with pytest.raises(ConfigError, match="names other records"):
        given(second, third)
    (tmp_path / "tap.toml").write_text(f'{kept}\n[[test]]\nkind = "decay"\nfiles = "more.csv"\n')
    with pytest.raises(ConfigError, match="names other records"):
        given(first, second)
    (tmp_path / "tap.toml").write_text("not a campaign")
    with pytest.raises(ConfigError, match="names other records"):
        given(first, second)
    assert (tmp_path / "tap.toml").read_text() == "not a campaign" != kept


def test_what_is_no_record_is_refused_by_its_reason(tmp_path):
    here, there = taps(tmp_path / "a", "tap.csv") + taps(tmp_path / "b", "tap.csv")
    with pytest.raises(ConfigError, match="must lie in one folder"):
        given(here, there)
    with pytest.raises(ConfigError, match=r"Record .*none\.csv` does not exist"):
        given(tmp_path / "none.csv")
    (tmp_path / "c").mkdir()
    with pytest.raises(ConfigError, match="must be a file, but it is a folder"):
        given(tmp_path / "c")
    (tmp_path / "c" / "notes.docx").write_text("tap")
    with pytest.raises(DataError, match="no measurement file"):
        given(tmp_path / "c" / "notes.docx")
    assert not list(tmp_path.rglob("*.toml"))


def test_a_look_at_records_reads_their_frequency(tmp_path, capsys):
    assert run(["look", *map(str, taps(tmp_path, "tap_1.csv", "tap_2.csv"))]) == 0
    out, err = capsys.readouterr()
    assert f"{HZ:.2f}" in out
    assert "CHECK: " in err
    assert f"Next: jbw identify {tmp_path / 'tap.toml'}" in err


def test_a_look_takes_one_campaign(tmp_path, capsys):
    taps(tmp_path / "a", "tap.csv")
    taps(tmp_path / "b", "tap.csv")
    assert run(["look", str(tmp_path / "a"), str(tmp_path / "b")]) == 2
    assert "one campaign at a time" in capsys.readouterr().err
