"""The house: who may import whom, read from the syntax trees, and what an import may do."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import jbw

ROOT = Path(jbw.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))
LEAVES = {"oscillator", "measurement", "inference"}
ANYWHERE = {"errors", "units"}
# Room to the rooms it may see, beside itself and `errors` and `units`.
SEES = {
    "oscillator": set(),
    "measurement": set(),
    "inference": set(),
    "campaign": {"measurement"},
    "observables": LEAVES,
    "identification": LEAVES | {"observables"},
    "prediction": LEAVES | {"observables"},
    "verification": LEAVES | {"observables", "prediction"},
    "validation": LEAVES | {"observables", "prediction"},
    "rig": {"oscillator", "measurement"},
    "report": {"inference", "measurement"},
    "run": set(),
    "planning": LEAVES | {"campaign", "observables", "prediction"},
}
TOP = {"report", "rig", "run", "study", "cli"}


def room(path):
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def imports(path):
    """Modules that a file imports, and whether the import stands inside a function."""
    tree = ast.parse(path.read_text())
    inside = {
        id(node)
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef)
        for node in ast.walk(function)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, id(node) in inside
        elif isinstance(node, ast.ImportFrom):
            yield node.module or "", id(node) in inside
            if node.module == "jbw":
                for alias in node.names:
                    yield f"jbw.{alias.name}", id(node) in inside


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_a_room_sees_only_the_rooms_below_it(path):
    allowed = SEES.get(room(path))
    if allowed is None:
        pytest.skip("a top room, which may see all")
    seen = {name.split(".")[1] for name, _ in imports(path) if name.startswith("jbw.")}
    assert seen - ANYWHERE - {room(path)} <= allowed


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_nothing_below_imports_the_top(path):
    if room(path) in {*TOP, "__init__"}:
        pytest.skip("a top room")
    assert not {n.split(".")[1] for n, _ in imports(path) if n.startswith("jbw.")} & TOP


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_heavy_libraries_live_in_their_rooms(path):
    top = {name.split(".")[0] for name, inside in imports(path) if not inside}
    if room(path) in {"measurement", "campaign", "run", "errors", "units", "__init__"}:
        assert not top & {"jax", "numpyro", "diffrax", "optimistix", "equinox", "arviz"}
    if "numpyro" in top:
        assert room(path) == "inference"
    if "matplotlib" in top:
        assert room(path) == "report"
    if "diffrax" in top:
        assert room(path) == "oscillator"


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_no_pickle_eval_or_assert(path):
    tree = ast.parse(path.read_text())
    assert not any(isinstance(node, ast.Assert) for node in ast.walk(tree))
    calls = {
        node.func.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    }
    assert not calls & {"eval", "exec"}
    assert not {name for name, _ in imports(path)} & {"pickle", "yaml", "dill", "cloudpickle"}


def fresh(code):
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    return done.stdout + done.stderr


def test_importing_jbw_prints_nothing_and_loads_nothing_heavy():
    heavy = "{'jax', 'arviz', 'arviz_base', 'matplotlib', 'numpyro', 'scipy'}"
    assert fresh(f"import sys, jbw; print(sorted({heavy} & set(sys.modules)), end='')") == "[]"


def test_importing_every_public_name_leaves_the_precision_alone():
    code = (
        "import jbw\nfor name in jbw.__all__: getattr(jbw, name)\n"
        "import jax; print(jax.config.jax_enable_x64, end='')"
    )
    assert fresh(code).strip().endswith("False")
