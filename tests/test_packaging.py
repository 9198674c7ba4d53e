"""Recipe and workflows say what `pyproject.toml` says: nothing else builds them here."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import jbw

yaml = pytest.importorskip("yaml")

ROOT = Path(jbw.__file__).parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT, HATCH = PYPROJECT["project"], PYPROJECT["tool"]["hatch"]
# Of what conda calls otherwise.
NAMES = {"matplotlib": "matplotlib-base"}


def read(path):
    return yaml.safe_load((ROOT / path).read_text(encoding="utf-8"))


def test_the_version_is_one_and_the_same():
    assert "version" in PROJECT["dynamic"]
    assert f'__version__ = "{jbw.__version__}"' in (ROOT / HATCH["version"]["path"]).read_text()
    assert read("packaging/conda/recipe.yaml")["context"]["version"] == jbw.__version__
    assert read("CITATION.cff")["version"] == jbw.__version__


def test_a_package_s_page_links_to_the_repository():
    """What hatch-fancy-pypi-readme does to the README, by the patterns that it is given."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    here = re.findall(r"\]\((?!\w+:)([^)]+)\)", text)
    for one in HATCH["metadata"]["hooks"]["fancy-pypi-readme"]["substitutions"]:
        text = re.sub(one["pattern"], one["replacement"], text)
    there = re.findall(r"\]\(([^)]+)\)", text)
    address = PROJECT["urls"]["Repository"]
    assert {f"{address}/blob/main/{one}" for one in here} - set(there) == {
        f"{address}/blob/main/docs/result.png"
    }
    assert f"]({address}/raw/main/docs/result.png)" in text
    assert all(one.startswith("https://") for one in there)
    assert {one for one in PROJECT["urls"].values() if not one.startswith(address)} == {
        "https://doi.org/10.1016/j.ymssp.2020.107333"
    }


def test_pages_of_a_release_stand_beside_those_of_others(tmp_path):
    site, pages = tmp_path / "site", tmp_path / "pages"
    site.mkdir()
    pages.mkdir()
    publish = [sys.executable, str(ROOT / "packaging/versions_of_docs.py"), str(site), str(pages)]
    refused = subprocess.run([*publish, "1.9.0"], capture_output=True, text=True)
    assert refused.returncode == 1
    assert "must hold index.html" in refused.stderr
    for version in ("1.10.0", "1.9.0"):  # a later number, published before
        (site / "index.html").write_text(version)
        subprocess.run([*publish, version], check=True)
    page = (pages / "index.html").read_text()
    assert "url=1.10.0/index.html" in page
    assert re.findall(r'href="([\d.]+)/', page) == ["1.10.0", "1.9.0"]
    assert (pages / "1.9.0" / "index.html").read_text() == "1.9.0"


def test_it_says_how_it_is_cited():
    (place,) = [
        target
        for source, target in HATCH["build"]["targets"]["wheel"]["force-include"].items()
        if source == "CITATION.cff"
    ]
    assert place == "jbw/CITATION.cff"
    cited = yaml.safe_load(jbw.citation())
    assert cited == read("CITATION.cff")
    (paper,) = cited["references"]
    assert PROJECT["urls"]["Paper"] == f"https://doi.org/{paper['doi']}"


def test_the_conda_recipe_needs_what_the_wheel_needs():
    recipe = read("packaging/conda/recipe.yaml")
    assert recipe["schema_version"] == 1
    needed = {f"python {PROJECT['requires-python']}"}
    for one in PROJECT["dependencies"]:
        name, bound = re.fullmatch(r"([\w-]+)(.*)", one).groups()
        needed.add(f"{NAMES.get(name, name)} {bound}".strip())
    assert set(recipe["requirements"]["run"]) == needed
    backend = {one.replace(">=", " >=") for one in PYPROJECT["build-system"]["requires"]}
    assert backend <= set(recipe["requirements"]["host"])
    points = [f"{name} = {home}" for name, home in PROJECT["scripts"].items()]
    assert recipe["build"]["python"]["entry_points"] == points
    assert recipe["about"]["license"] == PROJECT["license"]
    assert (ROOT / recipe["about"]["license_file"]).is_file()


def test_rattler_build_reads_and_renders_the_recipe():
    """As `rattler-build build` begins; what it then fetches is conda's."""
    rattler = pytest.importorskip("rattler_build", reason="needs py-rattler-build, of extra `test`")
    recipe = rattler.Stage0Recipe.from_file(ROOT / "packaging" / "conda" / "recipe.yaml")
    (rendered,) = recipe.render(rattler.VariantConfig())
    found = rendered.recipe.to_dict()
    assert found["package"] == {"name": "jbw", "version": jbw.__version__}
    assert found["build"]["noarch"] == "python"
    assert len(found["requirements"]["run"]) == 1 + len(PROJECT["dependencies"])


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
