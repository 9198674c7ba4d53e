"""The table of CPU seconds names tests that exist, and the meter counts them as it says."""

import json
from pathlib import Path

import durations
import pytest
from durations import measured, merged, split, without_the_gone

pytest_plugins = ["pytester"]

ROOT = Path(__file__).parents[1]


def test_every_measured_test_exists(request):
    """A test under another name would run in the fast tier, however long it takes."""
    if any("::" in argument for argument in request.config.args):
        pytest.skip("files are collected in part")
    collected = request.config.pluginmanager.get_plugin("meter").collected
    whole = {split(nodeid)[0] for nodeid in collected}
    for path, rows in measured().items():
        assert (ROOT / path).exists(), path
        if path in whole:
            stale = {name for name in rows if f"{path}::{name}" not in collected}
            assert not stale, f"{path}: `pytest --measure {path}` forgets {stale}"


def test_what_is_measured_takes_the_place_of_what_was():
    table = {"a.py": {"test_b": 3.0, "test_c": 4.0}, "d.py": {"test_e": 1.0}}
    seconds = {"a.py::test_b": 1.26, "a.py::test_f[0::1]": 2.04, "d.py::test_e": 0.3}
    found = merged(table, seconds, whole={"a.py"})
    assert found == {"a.py": {"test_b": 1.3, "test_f[0::1]": 2.0}}
    found = merged(table, seconds, whole=set())
    assert found == {"a.py": {"test_b": 1.3, "test_c": 4.0, "test_f[0::1]": 2.0}}


def test_what_is_no_more_is_forgotten_whatever_part_of_its_file_ran():
    table = {"a.py": {"test_b": 3.0, "test_gone": 4.0}, "d.py": {"test_e": 1.0}}
    found = without_the_gone(table, {"a.py::test_b", "a.py::test_c"})
    assert found == {"a.py": {"test_b": 3.0}, "d.py": {"test_e": 1.0}}


TWO = """
import subprocess, sys, time
import pytest

def work(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass

@pytest.fixture(scope="module")
def inner():
    work(0.4)

@pytest.fixture(scope="module")
def shared(request):
    work(0.1)
    request.getfixturevalue("inner")

@pytest.fixture(scope="session")
def once():
    work(0.4)

@pytest.fixture
def own():
    work(0.1)

def test_long(once, shared, inner, own):
    work(0.1)
    code = "import time\\nwhile time.process_time() < 0.3: pass"
    subprocess.run([sys.executable, "-c", code], check=True)

def test_quick(shared, inner):
    pass
"""


def test_shared_fixtures_are_shared_out_and_those_of_a_session_are_free(pytester, monkeypatch):
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # which import far more than it needs
    pytester.makepyfile(test_two=TWO, durations=Path(durations.__file__).read_text("utf-8"))
    outcome = pytester.runpytest_subprocess("-p", "durations", "--measure")
    outcome.assert_outcomes(passed=2)
    found = json.loads((pytester.path / "durations.json").read_text())["test_two.py"]
    # 0.1 + 0.1 + 0.3 + (0.1 + 0.4) / 2, and 0.25: below what is written. Setting up takes the rest.
    assert set(found) == {"test_long"}
    assert 0.7 <= found["test_long"] <= 1.0


MARKED = """
import pytest

@pytest.mark.slow
def test_quick():
    pass
"""


def test_a_marked_test_stays_in_the_table_and_counts_for_what_it_takes(pytester, monkeypatch):
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    pytester.makepyfile(test_marked=MARKED, durations=Path(durations.__file__).read_text("utf-8"))
    pytester.makeini("[pytest]\nmarkers = slow")
    outcome = pytester.runpytest_subprocess("-p", "durations", "--measure", "-m", "slow")
    outcome.assert_outcomes(passed=1)
    outcome.stdout.fnmatch_lines(["*= 0 CPU seconds, *"])
    found = json.loads((pytester.path / "durations.json").read_text())
    assert found == {"test_marked.py": {"test_quick": durations.LONG + 0.1}}
