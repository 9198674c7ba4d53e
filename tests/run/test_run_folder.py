"""The folder of a run under way: begun once, by one process, and gone on with unchanged."""

import errno
import json
import os
import subprocess
import sys
from dataclasses import replace

import filelock
import pytest

from jbw.errors import ConfigError, DataError, RunError
from jbw.run import folder as folders
from jbw.run.files import hash_of, require_room, write_whole
from jbw.run.folder import HIDDEN, begin, reopen
from jbw.run.manifest import Manifest, require_unchanged, with_inputs

ASKED = Manifest("jbw identify beam.toml", "/data/beam.toml", seed=3)


def test_a_run_begins_goes_on_and_finishes(tmp_path):
    run = begin(tmp_path / "new" / "run", ASKED)
    run.note(replace(run.manifest, text="[campaign]"))
    run.close()
    reopened = reopen(run.folder)
    assert reopened is not None
    assert reopened.manifest == replace(ASKED, text="[campaign]")
    (run.folder / "summary.json").write_text("{}")
    reopened.finish()
    reopened.close()
    assert reopen(run.folder) is None
    assert [path.name for path in run.folder.iterdir()] == ["summary.json"]


def test_sittings_of_one_run_add_their_time(tmp_path, monkeypatch):
    clock = iter([100.0, 107.5, 1000.0, 1000.25])  # begun, left, gone on with, left
    monkeypatch.setattr(folders, "perf_counter", lambda: next(clock))
    run = begin(tmp_path / "run", ASKED)
    assert run.spent == 0.0
    run.close()
    reopened = reopen(tmp_path / "run")
    assert reopened is not None
    assert reopened.spent == 7.5
    reopened.close()
    assert reopened.spent == 7.75


def test_a_folder_that_holds_something_is_refused_and_not_touched(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(RunError, match=r"notes\.txt") as caught:
        begin(tmp_path, ASKED)
    assert "--out" in caught.value.remedy
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_an_interrupted_run_is_not_begun_again(tmp_path):
    begin(tmp_path, ASKED).close()
    with pytest.raises(RunError, match="interrupted") as caught:
        begin(tmp_path, ASKED)
    assert f"jbw resume {tmp_path}" in caught.value.remedy


def test_a_folder_without_a_run_is_not_gone_on_with(tmp_path):
    with pytest.raises(RunError, match="no run that could be continued") as caught:
        reopen(tmp_path)
    assert "jbw identify" in caught.value.remedy


@pytest.mark.fault(42)
def test_a_file_in_the_folders_place_is_said(tmp_path):
    (tmp_path / "run").write_text("")
    for where in (tmp_path / "run", tmp_path / "run" / "below"):
        with pytest.raises(RunError, match="cannot be written: Not a directory") as caught:
            begin(where, ASKED)
        assert "--out" in caught.value.remedy


@pytest.mark.fault(42)
def test_a_full_disk_is_said_before_the_work(tmp_path, monkeypatch):
    with pytest.raises(RunError, match="MB left"):
        require_room(tmp_path, room=10**18)
    monkeypatch.setattr(
        folders, "require_room", lambda folder, _: require_room(folder, room=10**18)
    )
    with pytest.raises(RunError, match="MB left"):
        begin(tmp_path / "run", ASKED)
    assert not list(tmp_path.iterdir())


@pytest.mark.fault(45)
def test_a_second_process_is_refused_and_a_dead_ones_lock_taken_over(tmp_path):
    holds = (
        "import sys, pathlib\nfrom jbw.run.folder import begin\nfrom jbw.run.manifest import *\n"
        f"run = begin(pathlib.Path({str(tmp_path)!r}), Manifest('jbw', 'x.toml'))\n"
        "print('held', flush=True); sys.stdin.read()"
    )
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", holds], **pipes) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        for attempt in (lambda: begin(tmp_path, ASKED), lambda: reopen(tmp_path)):
            with pytest.raises(RunError, match=f"process {process.pid}") as caught:
                attempt()
            assert str(tmp_path) in caught.value.what
            assert "another folder" in caught.value.remedy
        process.kill()
    run = reopen(tmp_path)
    assert run is not None
    run.close()


def test_a_folder_that_knows_no_locks_is_written_all_the_same(tmp_path, monkeypatch):
    def without(error):
        def acquire(lock, *args, **kwargs):
            raise OSError(error, "No locks available")

        monkeypatch.setattr(filelock.FileLock, "acquire", acquire)

    without(errno.ENOLCK)
    run = begin(tmp_path / "network", ASKED)
    run.close()
    without(errno.EACCES)
    with pytest.raises(RunError, match="cannot be written"):
        begin(tmp_path / "shut", ASKED)


@pytest.mark.fault(44)
def test_a_changed_manifest_is_refused(tmp_path):
    begin(tmp_path, ASKED).close()
    path = tmp_path / HIDDEN / "manifest.json"
    content = json.loads(path.read_text())
    for text in (json.dumps({**content, "seed": 4}), path.read_text()[:-20], "", "[]"):
        path.write_text(text)
        with pytest.raises(RunError, match="damaged"):
            reopen(tmp_path)


@pytest.fixture
def read(tmp_path):
    """A campaign file with its data, and the manifest of a run that read both."""
    (tmp_path / "beam.toml").write_text("[campaign]\nname = 'beam'\n")
    (tmp_path / "sweep.h5").write_bytes(b"123")
    inputs = {str(tmp_path / "sweep.h5"): hash_of(tmp_path / "sweep.h5")}
    manifest = replace(ASKED, text=(tmp_path / "beam.toml").read_text())
    return with_inputs(manifest, tmp_path / "beam.toml", inputs), tmp_path / "beam.toml"


def test_what_is_unchanged_goes_on(read):
    require_unchanged(*read)
    manifest, campaign = read
    ((name, digest),) = manifest.inputs.items()
    assert name == "sweep.h5"  # relative to the campaign's folder, which may be moved
    assert with_inputs(manifest, campaign, {str(campaign.parent / "sweep.h5"): digest}) == manifest


@pytest.mark.fault(43)
def test_a_changed_campaign_is_refused_with_its_line(read):
    manifest, campaign = read
    campaign.write_text("[campaign]\nname = 'bar'\n")
    with pytest.raises(ConfigError, match="line 2 was \"name = 'beam'\"") as caught:
        require_unchanged(manifest, campaign)
    assert str(campaign) in caught.value.what
    assert "Restore the file" in caught.value.remedy
    campaign.unlink()
    with pytest.raises(ConfigError, match="cannot be read any more"):
        require_unchanged(manifest, campaign)


@pytest.mark.fault(43)
def test_changed_data_are_refused_with_their_file(read):
    manifest, campaign = read
    data = campaign.parent / "sweep.h5"
    data.write_bytes(b"124")
    with pytest.raises(DataError, match=r"sweep\.h5 changed") as caught:
        require_unchanged(manifest, campaign)
    assert "Restore the file" in caught.value.remedy
    data.unlink()
    with pytest.raises(DataError, match=r"sweep\.h5 cannot be read: No such file"):
        require_unchanged(manifest, campaign)
    for digests, says in (
        ({str(data): manifest.inputs["sweep.h5"], "/new.h5": "1"}, "new.h5 was added"),
        ({}, "sweep.h5 is no longer among"),
        ({str(data): "1"}, "sweep.h5 changed"),
    ):
        with pytest.raises(DataError, match=says):
            with_inputs(manifest, campaign, digests)


@pytest.mark.fault(43)
def test_other_versions_are_refused_by_name(read):
    manifest, campaign = read
    older = replace(manifest, versions={**manifest.versions, "jax": "0.1.2"})
    with pytest.raises(RunError, match=r"with other package versions: jax 0\.1\.2, not ") as caught:
        require_unchanged(older, campaign)
    assert "Install the versions" in caught.value.remedy


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no such files on this system")
def test_a_device_or_a_folder_in_a_file_s_place_is_refused_and_stays(tmp_path):
    """A file written beside it and renamed would take the place of /dev/full."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for name, kind in (("pipe", "device"), ("folder", "folder")):
        with pytest.raises(RunError, match=f"must be a file or a new name, but is a {kind}"):
            write_whole(tmp_path / name, b"report")
    assert (tmp_path / "pipe").is_fifo()
    assert (tmp_path / "folder").is_dir()
    assert len(list(tmp_path.iterdir())) == 2
