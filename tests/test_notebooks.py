"""The notebooks are whole, and run from top to bottom in a fresh process."""

import re
from pathlib import Path

import pytest

jupytext = pytest.importorskip("jupytext")

FOLDER = Path(__file__).parent.parent / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("[0-9]*_*.py"))
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


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """One folder of records, runs and compiled code for all notebooks."""
    return tmp_path_factory.mktemp("notebooks")


# Minutes each: before a release. The others are the first hour of a user.
LONG = {
    "5_real_bolted_joints", "6_samplers_compared", "7_one_joint_every_law",
    "8_joints_in_populations", "9_two_modes_and_a_shaker",
}  # fmt: skip


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
