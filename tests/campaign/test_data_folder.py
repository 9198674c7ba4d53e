"""$JBW_DATA in `files`: the folder of this machine's data, so that no path is in the campaign."""

import pytest

from jbw.campaign.files import found_files
from jbw.errors import ConfigError


def test_data_folder_is_that_of_the_environment(tmp_path, monkeypatch):
    (tmp_path / "data").mkdir()
    file = tmp_path / "data" / "run.npz"
    file.touch()
    monkeypatch.setenv("JBW_DATA", str(tmp_path / "data"))
    campaign = tmp_path / "campaign"
    campaign.mkdir()
    assert found_files(["$JBW_DATA/*.npz"], campaign, allow_outside=True) == [file]
    with pytest.raises(ConfigError, match="points outside"):
        found_files(["$JBW_DATA/*.npz"], campaign)


def test_unset_data_folder_is_said(tmp_path, monkeypatch):
    monkeypatch.delenv("JBW_DATA", raising=False)
    with pytest.raises(ConfigError, match="JBW_DATA"):
        found_files(["$JBW_DATA/*.npz"], tmp_path, allow_outside=True)
