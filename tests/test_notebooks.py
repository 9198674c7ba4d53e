"""The notebooks are whole, kept with their outputs, and run from top to bottom by themselves."""

import ast
import importlib.util
import io
import re
from copy import deepcopy
from importlib import import_module
from pathlib import Path

import pytest
from tiers import not_run_yet

import jbw

jupytext = pytest.importorskip("jupytext")
nbformat = pytest.importorskip("nbformat")

FOLDER = Path(__file__).parent.parent / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("[0-9]*_*.py"))
FIRST = FOLDER / "1_linear_regime.py"
NUMBERS = sorted(int(path.stem.split("_")[0]) for path in NOTEBOOKS)
each = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def test_notebooks_are_numbered_without_gaps():
    assert NUMBERS == list(range(1, len(NOTEBOOKS) + 1))


@each
def test_notebook_is_text_with_a_title_and_no_outputs(path):
    notebook = jupytext.read(path)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    number = path.stem.split("_")[0]
    assert re.match(rf"# {number} \w", notebook.cells[0].source)
    assert not any(cell.outputs for cell in code)
    compile(path.read_text(encoding="utf-8"), path.name, "exec")
    # Every figure or table is followed by what to see in it.
    assert notebook.cells[-1].cell_type == "markdown"


def load_make():
    """The script that keeps the notebooks."""
    spec = importlib.util.spec_from_file_location("notebooks_make", FOLDER / "make.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


make = load_make()


def kept(path):
    return nbformat.read(path.with_suffix(".ipynb"), 4)


# Names of notebooks that were not run since their code changed.
WAITING: set[str] = set()
each_kept = pytest.mark.parametrize(
    "path",
    not_run_yet(
        NOTEBOOKS, WAITING, lambda path: f"python notebooks/make.py {path.stem.partition('_')[0]}"
    ),
)


@each_kept
def test_a_kept_notebook_has_the_cells_of_its_text_and_was_run_with_them(path):
    text, notebook = jupytext.read(path), kept(path)
    nbformat.validate(notebook)
    cells = [[(cell.cell_type, cell.source) for cell in one.cells] for one in (text, notebook)]
    remedy = f"python notebooks/make.py {path.stem.partition('_')[0]}"
    assert cells[0] == cells[1], f"Run it again, or with --text where only text changed: {remedy}"
    assert notebook.metadata["jbw"]["code"] == make.code_of(text), f"Run it again: {remedy}"


@each_kept
def test_a_kept_notebook_shows_what_its_cells_draw(path):
    from PIL import Image

    notebook = kept(path)
    assert make.faults(notebook) == []
    shown = make.pictures(notebook)
    assert len(shown) >= len(make.figure_cells(notebook)) >= 1
    for picture in shown:
        assert 200 < Image.open(io.BytesIO(picture)).width <= make.WIDEST
    assert (make.THUMBNAILS / f"{path.stem}.png").is_file()


def test_the_page_of_the_folder_shows_every_notebook():
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert text == make.gallery(), "Make it again: python notebooks/make.py --text"
    links = re.findall(r"\]\(([^)]+)\)", text)
    assert [link for link in links if not (FOLDER / link).exists()] == []
    kept_ones = {path.name for path in FOLDER.glob("*.ipynb")}
    assert len(kept_ones) == len(NOTEBOOKS) - len(WAITING)
    assert kept_ones <= set(links)


def test_kept_notebooks_are_of_moderate_size():
    # What a clone should take for pictures, and a repository's page still shows.
    assert sum(path.stat().st_size for path in FOLDER.glob("*.ipynb")) < 6e6


def test_what_must_not_be_kept_is_named(tmp_path):
    notebook = deepcopy(kept(FIRST))
    place = make.figure_cells(notebook)[0]
    notebook.cells[place].outputs = [
        nbformat.v4.new_output("stream", name="stdout", text="\x1b[1mlaw\x1b[0m")
    ]
    wrong = make.faults(notebook)
    assert wrong == [
        f"cell {place} has an escape code", f"cell {place} draws and shows no picture"
    ]  # fmt: skip
    with pytest.raises(SystemExit, match="escape code"):
        make.write(tmp_path / "1_linear_regime.py", notebook)
    assert list(tmp_path.iterdir()) == []


def test_text_is_taken_over_only_beside_the_code_that_was_run():
    text, notebook = jupytext.read(FIRST), kept(FIRST)
    text.cells[0].source += "\n\nMore."
    taken = make.with_text_of(notebook, text)
    assert taken.cells[0].source.endswith("More.")
    assert make.pictures(taken) == make.pictures(notebook)
    code = next(cell for cell in text.cells if cell.cell_type == "code")
    code.source += "\nprint(1)"
    with pytest.raises(SystemExit, match="run the notebook again"):
        make.with_text_of(notebook, text)


def public_names():
    """What a user may write: `jbw.NAME`, and of a room that is public as a whole its names."""
    rooms = {name: import_module(home) for name, home in jbw._ROOMS.items()}
    return {
        *jbw.__all__,
        *(f"{room}.{name}" for room, module in rooms.items()
          for name in getattr(module, "__all__", vars(module)) if name[0] != "_"),
    }  # fmt: skip


def private_uses(source):
    """Imports of modules that are not public, and names of jbw that are none."""
    known, tree = public_names(), ast.parse(source)
    rooms = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.startswith("jbw."))
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("jbw."):
            yield node.module
        elif isinstance(node, ast.ImportFrom) and node.module == "jbw":
            rooms |= {alias.name for alias in node.names} & set(jbw._ROOMS)
            yield from (alias.name for alias in node.names if alias.name not in known)
    for node in ast.walk(tree):
        match node:
            case ast.Attribute(ast.Name("jbw"), name) if name not in known:
                yield name
            case ast.Attribute(ast.Attribute(ast.Name("jbw"), room), name) if room in jbw._ROOMS:
                yield from {f"{room}.{name}"} - known
            case ast.Attribute(ast.Name(room), name) if room in rooms:
                yield from {f"{room}.{name}"} - known


@pytest.mark.parametrize(
    "path", [*NOTEBOOKS, FOLDER / "virtual_rig.py"], ids=lambda path: path.stem
)
def test_a_notebook_uses_public_names_alone(path):
    assert list(private_uses(path.read_text(encoding="utf-8"))) == []


def test_a_private_use_is_seen():
    source = """import jbw
from jbw import laws, rig
from jbw.report.laws import laws_figure
jbw.frf_of(1)
jbw.rig.nothing
laws.nothing(2)
rig.measure(jbw.laws.law_named("cubic"))
"""
    named = {"jbw.report.laws", "frf_of", "rig.nothing", "laws.nothing"}
    assert set(private_uses(source)) == named


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """One folder of records, runs and compiled code for all notebooks."""
    return tmp_path_factory.mktemp("notebooks")


# Before a release: minutes, or a campaign once more, as the tutorial and the demo have one.
LONG = {path.stem for path in NOTEBOOKS} - {"1_linear_regime"}


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(
            path,
            id=path.stem,
            marks=pytest.mark.release if path.stem in LONG else pytest.mark.slow,
        )
        for path in NOTEBOOKS
    ],
)
def test_notebook_runs(path, shared, monkeypatch):
    nbclient = pytest.importorskip("nbclient")
    monkeypatch.setenv("JBW_NOTEBOOKS", str(shared))
    monkeypatch.delenv("MPLBACKEND", raising=False)  # the kernel draws inline, without a display
    notebook = jupytext.read(path)
    nbclient.NotebookClient(
        notebook, timeout=900, resources={"metadata": {"path": FOLDER}}
    ).execute()
    assert not any(
        output.output_type == "error"
        for cell in notebook.cells
        for output in cell.get("outputs", [])
    )
