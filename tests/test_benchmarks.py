"""The benchmarks start, are named in their README, and see when the time loop is not hoisted.

What they measure depends on the machine and its load, so no time is tested; whether the loop is
hoisted stands in the compiled program.
"""

import importlib
import math
import runpy
import subprocess
import sys
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest
from tiers import represented_by

FOLDER = Path(__file__).parent.parent / "benchmarks"
SCRIPTS = sorted(p for p in FOLDER.glob("*.py") if "__main__" in p.read_text())
# The calibration takes no options but a number.
WITH_OPTIONS = SCRIPTS


@pytest.fixture(autouse=True)
def beside_the_scripts(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))


@pytest.mark.parametrize("script", WITH_OPTIONS, ids=lambda path: path.stem)
def test_help_states_the_question(script, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [str(script), "--help"])
    with pytest.raises(SystemExit) as stop:
        runpy.run_path(str(script), run_name="__main__")
    assert stop.value.code == 0
    text = capsys.readouterr().out
    assert "?" in text
    assert "--calls" in text
    assert "--json" in text


def test_readme_names_every_script():
    text = (FOLDER / "README.md").read_text()
    missing = [path.name for path in SCRIPTS if f"`{path.name}`" not in text]
    assert not missing


def test_table_is_markdown():
    timing = importlib.import_module("timing")
    table = timing.Table("", {"solver": "", "ms": ".2f"}, [("a", 1.0), ("b", "not installed")])
    assert timing.markdown(table).splitlines() == [
        "| solver | ms |", "| --- | --- |", "| a | 1.00 |", "| b | not installed |",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("measured", "at_most", "result"),
    [
        (0.5, True, "stretch reached"),
        (0.8, True, "reached"),
        (1.1, True, "not reached"),
        (1.1, False, "reached"),
        (0.9, False, "not reached"),
        (math.nan, True, "not reached"),
        (None, True, "not measured"),
    ],
)
def test_targets_are_judged(measured, at_most, result):
    timing = importlib.import_module("timing")
    stretch = 0.6 if at_most else 2.0
    table = timing.targets([timing.Target("", measured, 1.0, stretch, at_most)])
    assert table.rows[0][-1] == result


def test_broken_lines_are_found():
    growth = importlib.import_module("growth")
    sizes = [1, 2, 4, 8, 16, 32]
    straight = growth.log_line(sizes, [3.0 * n**1.5 for n in sizes])
    assert straight.slope == pytest.approx(1.5)
    assert straight.bend is None
    broken = growth.log_line(sizes, [max(8.0, n) for n in sizes])
    assert broken.bend == pytest.approx(8.0)
    assert broken.before == pytest.approx(0.0, abs=1e-12)
    assert broken.after == pytest.approx(1.0)


def test_c_loops_agree_with_the_golden_sweep():
    yardstick = importlib.import_module("yardstick")
    problem = importlib.import_module("problem")
    if yardstick.library() is None:
        pytest.skip("needs a C compiler")
    case, u = problem.golden_sweep()
    parameters = list(case["params"].values())
    # Order 2 at the kinks: 1e-6 at 4 steps.
    v = yardstick.rk4(parameters, u, case["fs"], 16)
    assert problem.relative_error(v[case["index"]], case["v"]) < 1e-6
    same = problem.np.repeat(problem.np.array(parameters)[:, None], yardstick.WIDTH, axis=1)
    lanes = yardstick.rk4_lanes(same, u, case["fs"], 4)
    one = yardstick.rk4(parameters, u, case["fs"], 4)
    assert problem.relative_error(lanes[:, -1], one) < 1e-12


@pytest.mark.parametrize(("inner", "left"), [(jnp.sin, 0), (jnp.linalg.cholesky, 1)])
def test_a_loop_with_a_custom_call_is_left(inner, left):
    """XLA takes a loop of arithmetic for a native call, and none that calls LAPACK."""
    hoisting = importlib.import_module("hoisting")

    def loops(x):
        alone = jax.lax.fori_loop(0, x.size, lambda _, x: jnp.cos(x), x)
        repeat = partial(jax.lax.fori_loop, 0, x.size, lambda _, x: inner(x))
        return alone, jax.lax.cond(x[0, 0] > 2.0, repeat, jnp.tanh, x)

    program = jax.jit(loops).lower(jnp.eye(2)).compile().as_text()
    assert hoisting.loops_left(program) == left
    assert hoisting.loops_left(program.replace(hoisting.NATIVE, "")) == 2


@pytest.mark.slow
@pytest.mark.parametrize(("options", "code"), represented_by(([], 0), (["--control"], 1)))
def test_time_loop_is_hoisted_and_the_control_is_not(options, code):
    command = [sys.executable, str(FOLDER / "hoisting.py"), "--calls", "1", *options]
    found = subprocess.run(command, capture_output=True, text=True)
    assert found.returncode == code, found.stdout + found.stderr
    assert ("NOT HOISTED" in found.stdout) == bool(code)
