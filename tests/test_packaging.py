"""Recipe and workflows say what `pyproject.toml` says: nothing else builds them here."""

import re
import tomllib
from pathlib import Path

import pytest

import jbw

yaml = pytest.importorskip("yaml")

ROOT = Path(jbw.__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
# Of what conda calls otherwise.
NAMES = {"matplotlib": "matplotlib-base"}


def read(path):
    return yaml.safe_load((ROOT / path).read_text(encoding="utf-8"))


def test_the_conda_recipe_needs_what_the_wheel_needs():
    recipe = read("packaging/conda/recipe.yaml")
    assert recipe["schema_version"] == 1
    assert recipe["context"]["version"] == PROJECT["version"] == jbw.__version__
    needed = {f"python {PROJECT['requires-python']}"}
    for one in PROJECT["dependencies"]:
        name, bound = re.fullmatch(r"([\w-]+)(.*)", one).groups()
        needed.add(f"{NAMES.get(name, name)} {bound}".strip())
    assert set(recipe["requirements"]["run"]) == needed
    points = [f"{name} = {home}" for name, home in PROJECT["scripts"].items()]
    assert recipe["build"]["python"]["entry_points"] == points
    assert recipe["about"]["license"] == PROJECT["license"]
    assert (ROOT / recipe["about"]["license_file"]).is_file()


def test_workflows_run_every_system_and_python():
    matrix = read(".github/workflows/tests.yml")["jobs"]["fast"]["strategy"]["matrix"]
    systems = {name.partition("-")[0] for name in matrix["os"]}
    assert systems == {"ubuntu", "windows", "macos"}
    least = PROJECT["requires-python"].removeprefix(">=")
    assert least in matrix["python"]
    assert (ROOT / ".python-version").read_text().strip() in matrix["python"]
    pins = [
        step["uses"]
        for job in read(".github/workflows/tests.yml")["jobs"].values()
        for step in job["steps"]
        if "uses" in step
    ]
    assert pins
    assert all("@" in pin for pin in pins)
