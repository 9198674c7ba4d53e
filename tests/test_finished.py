"""Runs that tests share are made once a state of the source, and never read half made."""

import finished
import pytest


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.setattr(finished, "KEPT", tmp_path)
    monkeypatch.setattr(finished, "state", lambda: "as it is")


def test_a_run_is_made_once(tmp_path):
    made = []

    def make(folder):
        made.append(folder)
        (folder / "result").write_text(str(len(made)))

    first, second = finished.finished("toy", make), finished.finished("toy", make)
    assert first == second == tmp_path / "as it is" / "toy"
    assert made == [first]


def test_a_run_that_broke_off_is_made_anew():
    def broken(folder):
        (folder / "half").touch()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        finished.finished("toy", broken)
    folder = finished.finished("toy", lambda folder: (folder / "result").touch())
    assert {path.name for path in folder.iterdir()} == {"result", "whole"}


def test_another_source_makes_another_run(monkeypatch):
    first = finished.finished("toy", lambda folder: None)
    monkeypatch.setattr(finished, "state", lambda: "after a change")
    assert finished.finished("toy", lambda folder: None) != first


def test_runs_of_long_ago_are_forgotten():
    folder = finished.finished("toy", lambda folder: None)
    finished.forget(3600.0)
    assert folder.exists()
    finished.forget(-1.0)
    assert not folder.exists()
