"""Many campaigns: what is finished is not run again, what is broken goes on, all are told."""

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import distributed
import numpy as np
import pytest
import xarray as xr

import jbw
from jbw.cli import run
from jbw.run.files import hash_of
from jbw.run.folder import HIDDEN, MANIFEST, begin
from jbw.run.manifest import Manifest, read_manifest
from jbw.study import many
from jbw.study.resumable import digest_of
from jbw.study.workers import dask_executor

sys.path.insert(0, str(Path(__file__).parent))
from damper_campaign import write_campaign

# Points drawn at once take the least time; the kill comes between campaigns and within them.
SETTINGS = """num_samples = 100
num_chains = 2
sampler = "importance"
model_error = "none"
offsets = "none"
"""


def finished(folder, campaign, data, **record):
    """A finished run made up, of a campaign with one file of data."""
    folder.mkdir(parents=True)
    xr.DataTree.from_dict({"/posterior": xr.Dataset()}).to_netcdf(
        folder / "posterior.nc", engine="h5netcdf"
    )
    summary = {
        "verdict": {"status": "usable"},
        "seed": 3,
        "inputs": {str(data): hash_of(data)},
        "campaign_file": str(campaign),
        "campaign_sha256": digest_of(campaign.read_text()),
        **record,
    }
    (folder / "summary.json").write_text(json.dumps(summary))


@pytest.fixture
def campaigns(tmp_path):
    """Two campaigns that nobody can read as such, of which the first is finished."""
    found = []
    for name in "ab":
        (tmp_path / name).mkdir()
        (tmp_path / name / "data.h5").write_bytes(name.encode())
        found.append(tmp_path / name / "campaign.toml")
        found[-1].write_text("[[nonsense]]\n")
    finished(tmp_path / "runs" / "a", found[0], tmp_path / "a" / "data.h5")
    return found


@pytest.fixture
def threads(monkeypatch):
    monkeypatch.setattr(many, "prepare_process", lambda: None)
    with ThreadPoolExecutor(2) as pool:
        yield pool


def test_one_that_fails_stops_no_other_and_finished_ones_are_not_run_again(
    campaigns, threads, tmp_path
):
    said = []
    first, second = jbw.identify_many(
        campaigns, tmp_path / "runs", executor=threads, report=said.append
    )
    assert (first.status, first.verdict, first.began, first.exit_code) == (
        "done", "usable", "finished", 0,
    )  # fmt: skip
    assert (second.status, second.exit_code) == ("failed", 2)
    assert "unknown table" in second.error
    assert "\n" not in second.error
    assert said[0] == "1 of 2: a was finished earlier, verdict usable"
    assert said[1].startswith("2 of 2, 1 of them failed: b failed: campaign.toml has")
    assert not (tmp_path / "runs" / "b").exists()


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        (lambda f: (f / "data.h5").write_bytes(b"other"), {}, "data.h5 changed since"),
        (lambda f: (f / "campaign.toml").write_text("# new\n"), {}, "campaign.toml changed since"),
        (lambda f: (f / "data.h5").unlink(), {}, "data.h5 cannot be read"),
        (lambda f: None, {"seed": 4}, "has the seed 3, not 4"),
    ],
)
def test_a_finished_run_of_something_else_is_not_taken_for_this(
    campaigns, threads, tmp_path, change, options, message
):
    change(tmp_path / "a")
    (found,) = jbw.identify_many(campaigns[:1], tmp_path / "runs", executor=threads, **options)
    assert found.status == "failed"
    assert message in found.error


def test_a_folder_of_another_campaign_is_left_alone(campaigns, threads, tmp_path):
    other = tmp_path / "elsewhere" / "a.toml"
    other.parent.mkdir()
    other.write_text("")
    (found,) = jbw.identify_many([other], tmp_path / "runs", executor=threads)
    assert found.status == "failed"
    assert f"contains a run of {campaigns[0]}, not of {other}" in found.error


def test_what_cannot_be_meant_is_refused_before_any_work(campaigns, threads, tmp_path):
    with pytest.raises(jbw.ConfigError, match="No campaign is given"):
        jbw.identify_many([], tmp_path)
    with pytest.raises(jbw.ConfigError, match="would both write to"):
        jbw.identify_many([campaigns[0], campaigns[0]], tmp_path)
    with pytest.raises(jbw.ConfigError, match="`executor` and `workers`"):
        jbw.identify_many(campaigns, tmp_path, executor=threads, workers=2)
    with pytest.raises(jbw.ConfigError, match="Campaign `x` has no file"):
        jbw.identify_many([jbw.Campaign("x", None, ())], tmp_path)


class Lost:
    """An executor whose worker is lost."""

    def submit(self, function, task):
        future = Future()
        future.set_exception(ConnectionError("no route to node 7"))
        return future


def test_a_lost_worker_is_a_failed_campaign(campaigns, tmp_path):
    (found,) = jbw.identify_many(campaigns[1:], tmp_path / "runs", executor=Lost())
    assert found.status == "failed"
    assert "worker of the run was lost: ConnectionError no route to node 7" in found.error
    assert "Identify the campaign again" in found.error


def test_the_command_tells_each_and_ends_as_the_first_that_failed(
    campaigns, monkeypatch, tmp_path, capsys
):
    monkeypatch.setattr(
        "jbw.study.many.in_processes",
        lambda function, tasks, workers: ((task, _done(function, task)) for task in tasks),
    )
    asked = ["identify", *map(str, campaigns), "--out", str(tmp_path / "runs"), "--workers", "3"]
    assert run([*asked, "--json"]) == 2
    found = json.loads(capsys.readouterr().out)
    assert [one["status"] for one in found["campaigns"]] == ["done", "failed"]
    assert run(asked) == 2
    assert "1 of 2 campaigns are identified" in capsys.readouterr().out


def _done(function, task):
    future = Future()
    future.set_result(function(task))
    return future


def test_workers_are_for_several_campaigns(campaigns, capsys):
    assert run(["identify", str(campaigns[0]), "--workers", "2"]) == 2
    assert "--workers is for several campaigns" in capsys.readouterr().err


@pytest.fixture
def units(tmp_path):
    """Writes short campaigns, each of its own amplitude and torque."""

    def written(number):
        files = []
        for i in range(number):
            folder = tmp_path / f"unit_{i}"
            folder.mkdir()
            files.append(write_campaign(folder, 5e-3 * (1 + 0.05 * i), settings=SETTINGS))
            files[-1].write_text(files[-1].read_text() + f"\n[assembly]\ntorque = {4.0 + i}\n")
        return files

    return written


@pytest.mark.release  # test_killed_jobs.py kills a command
@pytest.mark.fault(40)
@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_a_fleet_that_is_killed_goes_on_and_ends_as_the_undisturbed_one(
    tmp_path, monkeypatch, units
):
    """kill -9 of the whole, while the second of three campaigns is under way."""
    files = units(3)
    command = [
        sys.executable, "-c", "from jbw.cli import main; main()", "identify", *map(str, files),
        "--workers", "1", "--out", str(tmp_path / "killed"),
    ]  # fmt: skip
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    second = tmp_path / "killed" / "unit_1" / ".run" / "manifest.json"
    while process.poll() is None and not second.exists():
        time.sleep(0.05)
    time.sleep(2.0)
    assert process.poll() is None
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()  # ends when the worker's end of the pipe is closed as well
    first = (tmp_path / "killed" / "unit_0" / "summary.json").stat().st_mtime_ns

    # The rest in threads of this process, which compiles but once, and without figures.
    monkeypatch.setattr("jbw.report.figures.draw_figures", lambda *_: None)
    monkeypatch.setattr("jbw.report.page.write_page", lambda *of: of[2].write_text("page"))
    with ThreadPoolExecutor(1) as pool:
        undisturbed = jbw.identify_many(files, tmp_path / "whole", executor=pool)
        found = jbw.identify_many(files, tmp_path / "killed", executor=pool)
    assert [one.began for one in found] == ["finished", "resumed", "new"]
    assert {one.status for one in (*found, *undisturbed)} == {"done"}
    assert (tmp_path / "killed" / "unit_0" / "summary.json").stat().st_mtime_ns == first
    fleet = require_same_fleets(found, undisturbed)
    assert fleet["torque"].values.tolist() == [4.0, 5.0, 6.0]


def require_same_fleets(*several):
    """The one fleet that the runs of each of several calls make, to the last draw."""
    first, *others = [jbw.fleet_of([one.folder for one in each]) for each in several]
    for unit in first.coords["unit"].values:
        for fleet in (first, *others):
            fleet[unit].attrs.clear()  # where the run lies
        for fleet in others:
            np.testing.assert_array_equal(fleet[unit]["draws"], first[unit]["draws"])
    assert all(fleet.identical(first) for fleet in others)
    return first


@pytest.mark.slow
def test_first_answers_of_several_are_kept_and_go_on_to_their_posteriors(
    tmp_path, monkeypatch, units
):
    files, out = units(2), tmp_path / "out"
    monkeypatch.setattr("jbw.report.figures.draw_figures", lambda *_: None)
    monkeypatch.setattr("jbw.report.page.write_page", lambda *of: of[2].write_text("page"))
    with ThreadPoolExecutor(1) as pool:
        first = jbw.identify_many(files, out, executor=pool, quick=True)
        again = jbw.identify_many(files, out, executor=pool, quick=True)
        drawn = jbw.identify_many(files, out, executor=pool)
        anew = jbw.identify_many(files, tmp_path / "anew", executor=pool)
    assert [[one.began for one in all_] for all_ in (first, again, drawn)] == [
        ["new"] * 2, ["finished"] * 2, ["resumed"] * 2
    ]  # fmt: skip
    assert {one.exit_code for one in (*first, *again)} == {0}
    assert {one.verdict for one in drawn} <= {"ok", "usable", "failed"}
    for one, other in zip(drawn, anew, strict=True):  # as if the first answer had never been
        pair = [jbw.load_study(run.folder).tree["posterior"]["omega_n"] for run in (one, other)]
        np.testing.assert_array_equal(*pair)


def test_a_campaign_that_killed_two_processes_is_set_aside(campaigns, threads, tmp_path):
    path, folder = campaigns[1], tmp_path / "runs" / "b"
    killed = begin(folder, Manifest("jbw identify", str(path)))
    killed.note(replace(killed.manifest, num_killed=2))
    killed.close()
    (found,) = jbw.identify_many([path], tmp_path / "runs", executor=threads, quick=True)
    assert found.status == "failed"
    assert "2 processes that ran it were killed" in found.error
    assert f"jbw identify {path} --out {folder}-alone --quick" in found.error
    (lost,) = jbw.identify_many([path], tmp_path / "runs", executor=Lost())
    assert "is set aside" in lost.error


@pytest.mark.parametrize("number", [0, 1])
def test_a_run_that_ends_by_itself_counts_no_kill(tmp_path, number):
    """Neither an error nor an interruption is a kill; what is open within the block is."""
    held = begin(tmp_path / "run", Manifest("jbw identify", "a.toml", num_killed=number))
    stored = tmp_path / "run" / HIDDEN / MANIFEST
    with suppress(KeyboardInterrupt), held.surviving():
        assert read_manifest(stored).num_killed == number + 1
        raise KeyboardInterrupt
    assert read_manifest(stored).num_killed == 0
    held.close()


def test_outcomes_are_noted_once_and_shown(campaigns, threads, tmp_path, capsys):
    for _ in range(2):
        jbw.identify_many(
            campaigns, tmp_path / "runs", executor=threads, command="jbw identify a b"
        )
    lines = (tmp_path / "runs" / "outcomes.jsonl").read_text().split()
    assert sum('"done"' in line for line in lines) == 1
    assert run(["status", str(tmp_path / "runs")]) == 0
    told = capsys.readouterr().out
    assert "1 campaign is identified, 1 failed, 0 left." in told
    assert "unknown table" in told


def test_outcomes_that_cannot_be_written_stop_no_run(campaigns, threads, tmp_path):
    (tmp_path / "runs" / "outcomes.jsonl").mkdir(parents=True)
    said = []
    found = jbw.identify_many(campaigns, tmp_path / "runs", executor=threads, report=said.append)
    assert [one.status for one in found] == ["done", "failed"]
    assert sum("outcomes.jsonl cannot be written" in sentence for sentence in said) == 1


def test_what_is_kept_is_one_of_two(campaigns, capsys, tmp_path):
    with pytest.raises(jbw.ConfigError, match="`keep` must be one of report, posterior"):
        jbw.identify_many(campaigns, tmp_path / "runs", keep="everything")
    words = ["identify", *map(str, campaigns), "--keep", "posterior", "--figures", "svg"]
    assert run(words) == 2
    assert "--keep posterior leaves out" in capsys.readouterr().err


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Two processes of one thread each, as `dask scheduler` and `dask worker` start them."""
    place = {"dashboard_address": None, "local_directory": str(tmp_path_factory.mktemp("dask"))}
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, **place) as made:
        yield made


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nowhere"])
def test_a_scheduler_that_does_not_answer_is_named(campaigns, capsys, monkeypatch, address):
    monkeypatch.setattr("jbw.study.workers.ANSWER_S", 0.5)
    words = ["identify", *map(str, campaigns), "--scheduler", address]
    assert run(words) == 2
    told = capsys.readouterr().err
    assert f"No Dask scheduler answers at {address}" in told
    assert "dask scheduler --port 8786" in told
    assert run([*words, "--workers", "2"]) == 2
    assert "leave out --workers" in capsys.readouterr().err


@pytest.mark.slow
def test_a_killed_worker_of_dask_costs_no_campaign(tmp_path, monkeypatch, units, cluster):
    files = units(3)
    with distributed.Client(cluster) as client:
        pids = client.run(os.getpid)
    killed = []

    def ended(sentence):
        if not killed and "1 of 3" in sentence:
            killed.append(next(iter(pids.values())))
            os.kill(killed[0], signal.SIGKILL)

    with dask_executor(cluster.scheduler_address) as executor:
        found = jbw.identify_many(
            files, tmp_path / "there", executor=executor, report=ended, keep="posterior"
        )
    assert killed
    assert {one.status for one in found} == {"done"}
    assert not (tmp_path / "there" / "unit_0" / "report.html").exists()
    monkeypatch.setattr("jbw.report.figures.draw_figures", lambda *_: None)
    monkeypatch.setattr("jbw.report.page.write_page", lambda *of: of[2].write_text("page"))
    with ThreadPoolExecutor(1) as pool:
        here = jbw.identify_many(files, tmp_path / "here", executor=pool)
    require_same_fleets(found, here)
