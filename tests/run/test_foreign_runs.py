"""Runs of other code, and folders that somebody else filled: nothing of them goes on unasked."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import jbw
from jbw.cli import run
from jbw.run.folder import OF_RIG, begin
from jbw.run.manifest import Manifest, with_inputs
from jbw.sources import sources_of

PACKAGE = Path(jbw.__file__).parent
CAMPAIGN = "[campaign]\nname = 'beam'\n"


def tree(folder):
    """Every file below a folder, with its content."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def resumed_by(root, folder):
    """Exit code and stderr of `jbw resume` by the package that lies in a folder."""
    ended = subprocess.run(
        [sys.executable, "-m", "jbw", "resume", str(folder)], capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": str(root)}, cwd=root, check=False,
    )  # fmt: skip
    return ended.returncode, ended.stderr


@pytest.mark.fault(43)
def test_other_code_of_the_same_version_does_not_go_on_with_a_run(tmp_path):
    """The other code is a copy of the package in which one comment differs."""
    shutil.copytree(
        PACKAGE, tmp_path / "other" / "jbw", ignore=shutil.ignore_patterns("__pycache__")
    )
    with (tmp_path / "other" / "jbw" / "inference" / "density.py").open("a") as file:
        file.write("# another commit\n")
    campaign = tmp_path / "beam.toml"
    campaign.write_text(CAMPAIGN)
    begin(tmp_path / "run", Manifest("jbw identify beam.toml", str(campaign))).close()
    code, said = resumed_by(tmp_path / "other", tmp_path / "run")
    assert code == 1, said
    was, is_ = sources_of("jbw"), said.partition("not ")[2].partition("(sources ")[2][:16]
    assert f"versions: jbw {jbw.__version__} (sources {was}), not {jbw.__version__}" in said
    assert is_ != was
    code, said = resumed_by(PACKAGE.parent, tmp_path / "run")
    assert "begun with other" not in said  # the campaign has no test, which is said instead
    assert code == 2, said


@pytest.mark.fault(53)
@pytest.mark.parametrize("place", ["../../elsewhere/campaign.toml", "/{}/campaign.toml", "a.toml"])
def test_a_stranger_s_manifest_writes_nowhere_else(tmp_path, capsys, place):
    place = place.format(tmp_path / "elsewhere")
    begin(tmp_path / "a" / "run", Manifest("jbw demo", place, seed=0, preset="everyday")).close()
    before = tree(tmp_path)
    assert run(["resume", str(tmp_path / "a" / "run")]) == 1
    assert f"must be that of its virtual rig, {OF_RIG}" in capsys.readouterr().err
    assert tree(tmp_path).keys() == before.keys()


@pytest.mark.fault(53)
@pytest.mark.parametrize("name", ["campaign", ".run/spent_s", ".run/joint.0.checkpoint"])
def test_a_link_out_of_a_run_s_folder_is_refused(tmp_path, capsys, name):
    begin(tmp_path / "run", Manifest("jbw demo", OF_RIG, seed=0, preset="everyday")).close()
    target = tmp_path / "mine"
    if name == "campaign":
        target.mkdir()
    else:
        target.write_text("mine")
    (tmp_path / "run" / name).unlink(missing_ok=True)
    (tmp_path / "run" / name).symlink_to(target)
    assert run(["resume", str(tmp_path / "run")]) == 1
    assert f"{Path(name).name} is a link to {target}" in capsys.readouterr().err
    assert list(target.iterdir()) == [] if target.is_dir() else target.read_text() == "mine"


@pytest.mark.fault(53)
def test_files_outside_are_allowed_by_the_command_and_not_by_the_manifest(tmp_path, capsys):
    (tmp_path / "campaign").mkdir()
    campaign, outside = tmp_path / "campaign" / "beam.toml", tmp_path / "private.h5"
    campaign.write_text(CAMPAIGN)
    outside.write_bytes(b"123")
    asked = Manifest("jbw identify beam.toml", str(campaign), allow_outside=True)
    noted = with_inputs(asked, campaign, {str(outside): "0"})
    begun = begin(tmp_path / "run", noted)
    begun.close()
    assert begun.to_resume == f"{tmp_path / 'run'} --allow-outside"
    assert run(["resume", str(tmp_path / "run")]) == 2
    said = capsys.readouterr().err
    assert f"The data file {outside} must be in the campaign's folder" in said
    assert "jbw resume DIR --allow-outside" in said
    assert run(["resume", str(tmp_path / "run"), "--allow-outside"]) == 3
    assert "private.h5 changed" in capsys.readouterr().err
