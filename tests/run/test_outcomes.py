"""The progress of many runs: what the last lines say, and what a kill has torn."""

import json
from datetime import UTC, datetime, timedelta

import pytest

from jbw.cli import run
from jbw.cli.status import sentences
from jbw.run.folder import begin
from jbw.run.manifest import Manifest
from jbw.run.outcomes import OUTCOMES, Call, RunOutcome, note, progress


def ended(name, status="done", **more):
    return RunOutcome(f"{name}.toml", f"runs/{name}", status, "ok" * (status == "done"), **more)


def test_nothing_is_known_of_a_folder_without_outcomes(tmp_path):
    assert progress(tmp_path) is None


def test_what_is_left_takes_as_long_as_what_has_ended(tmp_path):
    note(tmp_path, Call("jbw identify units", 6))
    for name in "ab":
        note(tmp_path, ended(name))
    # Four seconds from the call to the second outcome, so that the four others take eight.
    lines = [json.loads(line) for line in (tmp_path / OUTCOMES).read_text().splitlines()]
    start = datetime.now(UTC) - timedelta(seconds=10)
    for line, after in zip(lines, (0, 3, 4), strict=True):
        line["time"] = (start + timedelta(seconds=after)).isoformat()
    (tmp_path / OUTCOMES).write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    found = progress(tmp_path)
    assert found.num_left == 4
    assert found.left_s == pytest.approx(8.0)
    assert found.since_s == pytest.approx(6.0, abs=2.0)  # as long as this test takes, more
    said = sentences(found)
    assert said[0] == "2 campaigns are identified, 0 failed, 4 left."
    assert said[1] == "Verdicts: ok 2."
    assert "are left take about 8 s" in said[2]
    assert said[3].endswith("repeat it to continue: jbw identify units")


def test_a_torn_line_is_skipped_and_the_next_call_begins_a_new_one(tmp_path):
    note(tmp_path, Call("jbw identify units", 2))
    note(tmp_path, ended("a"))
    note(tmp_path, ended("b"))
    path = tmp_path / OUTCOMES
    path.write_text(path.read_text()[:-20])
    assert [one.campaign for one in progress(tmp_path).outcomes] == ["a.toml"]
    assert progress(tmp_path).num_left == 1
    note(tmp_path, Call("jbw identify units", 1))
    note(tmp_path, ended("b"))
    found = progress(tmp_path)
    assert [one.campaign for one in found.outcomes] == ["a.toml", "b.toml"]
    assert found.num_left == 0


def test_the_last_outcome_of_a_campaign_counts(tmp_path):
    note(tmp_path, Call("jbw identify units", 2))
    note(tmp_path, ended("a", "failed", error="no space"))
    note(tmp_path, ended("b"))
    assert [one.status for one in progress(tmp_path).outcomes] == ["failed", "done"]
    note(tmp_path, Call("jbw identify units", 1))  # "a" is run again, so it is left and not failed
    assert [one.campaign for one in progress(tmp_path).outcomes] == ["b.toml"]
    assert progress(tmp_path).num_left == 1
    assert progress(tmp_path).left_s is None
    note(tmp_path, ended("a"))
    assert {one.status for one in progress(tmp_path).outcomes} == {"done"}


def test_a_run_without_result_is_named(tmp_path):
    note(tmp_path, Call("jbw identify units", 1))
    begin(tmp_path / "unit_7", Manifest("jbw identify units", "unit_7.toml")).close()
    found = progress(tmp_path)
    assert found.begun == ("unit_7",)
    assert sentences(found)[-1] == "Begun, without a result yet: unit_7."


def test_the_status_of_a_single_run_names_what_continues_it(tmp_path, capsys):
    folder = tmp_path / "run"
    begin(folder, Manifest("jbw identify a.toml", "a.toml")).close()
    assert run(["status", str(folder)]) == 0
    assert f"jbw resume {folder}" in capsys.readouterr().out
    (folder / "summary.json").write_text("{}")
    run(["status", str(folder)])
    assert "has the result of its fit" in capsys.readouterr().out
    (folder / ".run" / "manifest.json").unlink()
    run(["status", str(folder)])
    assert "is finished" in capsys.readouterr().out
    assert run(["status", str(tmp_path)]) == 2
    assert "contains no runs" in capsys.readouterr().err
