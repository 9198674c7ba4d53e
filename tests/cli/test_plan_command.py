"""`jbw plan`: the example, a table and JSON before a test, a run's folder, exit codes."""

import json
import subprocess
import sys

import pytest

import jbw.cli.progress
from jbw.cli import run

PLAN = """
[plan]
natural_hz = 18.8
delta = [270.0, 400.0]
noise = 50.0
noise_unit = "um/s"
gain = 15.0
joints = 2
[stepped]
levels = [0.02]
frequencies = [18.0, 18.4, 18.8, 19.2]
dwell = 30.0
settle = 20.0
"""


@pytest.fixture(autouse=True)
def _jax_as_it_is(monkeypatch):
    monkeypatch.setattr(jbw.cli.progress, "prepare_process", lambda: None)


@pytest.fixture
def plan_file(tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return path


@pytest.mark.parametrize("arguments", [["plan"], ["plan", "--example"]])
def test_without_a_file_the_example_is_printed(capsys, arguments):
    from jbw.planning import EXAMPLE

    assert run(arguments) == 0
    assert capsys.readouterr().out == EXAMPLE


def test_the_example_loads_no_jax():
    code = (
        "import sys\nfrom jbw.cli import run\nrun(['plan'])\n"
        "print('jax' in sys.modules, file=sys.stderr)"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ended.stderr.strip() == "False"


def test_a_table_goes_to_stdout_and_progress_to_stderr(capsys, plan_file):
    assert run(["plan", str(plan_file)]) == 0
    streams = capsys.readouterr()
    for part in ("input [V]", "peak [m]", "CV delta", "gain [nats]", "stepped 18-19.2 Hz", "noise"):
        assert part in streams.out
    assert "Recommended" in streams.out
    assert "1/1 stepped" in streams.err
    # What it costs is said before the first candidate is judged.
    lines = streams.err.splitlines()
    (cost,) = (i for i, line in enumerate(lines) if "1 candidate tests for 2 joints take" in line)
    assert cost < next(i for i, line in enumerate(lines) if "1/1 stepped" in line)


def test_json_holds_the_rows_and_the_combination(capsys, plan_file):
    assert run(["plan", str(plan_file), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["wish"]["wanted"] == ["alpha", "delta", "gamma"]
    assert answer["wish"]["max_input"] is None  # no limit: JSON has no infinity
    (only,) = answer["rows"]
    assert only["level"] == 0.02
    assert only["seconds"] == pytest.approx(120.0 * only["repeats"])
    assert answer["combination"]["tests"] == [
        {"test": only["test"], "level": 0.02, "repeats": only["repeats"]}
    ]
    assert set(only["cv"]["alpha"]) == {"median", "worst_decile"}


@pytest.mark.parametrize(
    ("make", "options", "code", "says"),
    [
        (lambda path: path / "none.toml", [], 2, "does not exist"),
        (lambda path: path, [], 3, "no summary.json"),
        (lambda path: path / "plan.toml", ["--limits", "x.toml"], 2, "run's folder"),
    ],
)
def test_what_cannot_be_planned_ends_with_a_sentence(
    capsys, tmp_path, plan_file, make, options, code, says
):
    assert run(["plan", str(make(tmp_path)), *options]) == code
    streams = capsys.readouterr()
    assert says in streams.err
    assert "Traceback" not in streams.err
