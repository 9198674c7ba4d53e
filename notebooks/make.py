"""Run the notebooks and keep each with its outputs, as `.ipynb` beside its text, and a thumbnail.

    python notebooks/make.py 1 2        # or all of them, without numbers
    python notebooks/make.py --text     # runs none: takes over text that has changed

The `.py` is what is written by hand. The `.ipynb` holds the same cells with what they showed, and
the hash of the code that was run: where the code has changed since, it has to be run again, and
`tests/test_notebooks.py` says so. The pages of the documentation show the `.ipynb`.
"""

import hashlib
import io
import os
import re
import sys
from base64 import b64decode, b64encode
from itertools import count
from pathlib import Path
from typing import Any

import jupytext
import nbformat

FOLDER = Path(__file__).parent
THUMBNAILS = FOLDER.parent / "docs" / "notebooks" / "thumbnails"
WIDEST = 900  # of a kept figure [px]
PICTURES = "../docs/notebooks/thumbnails"  # as this folder sees them
HEAD = """# Notebooks

`python notebooks/make.py` generates the notebooks and this page. Each notebook opens here with its
outputs. To run one, type `pip install -e . jupyterlab && jupyter lab notebooks`. Notebook 5 needs
data that are published elsewhere. The campaign files of measured structures are in
[`campaigns`](campaigns). If you come from MATLAB, begin with [this table](from_matlab.md).
"""
THUMBNAIL = 360  # width [px]
ESCAPE = "\x1b"


def texts() -> list[Path]:
    """The notebooks as they are written, by number."""
    found = FOLDER.glob("[0-9]*_*.py")
    return sorted(found, key=lambda path: int(path.stem.partition("_")[0]))


def code_of(notebook: Any) -> str:
    """The hash of a notebook's code, in the order of its cells."""
    code = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    return hashlib.sha256("\0".join(code).encode()).hexdigest()


def figure_cells(notebook: Any) -> list[int]:
    """Places of the cells that end by drawing: their last line is a figure, or shows one."""
    drawn = re.compile(
        r"jbw\.plots\.(draw|laws|prediction)\(|\.figure$|plt\.(show|subplots)\(|^(identified|compared)\(",
        re.MULTILINE,
    )
    return [
        place
        for place, cell in enumerate(notebook.cells)
        if cell.cell_type == "code" and "def " not in cell.source and drawn.search(cell.source)
    ]


def run(path: Path) -> Any:
    """The notebook of a text, run from top to bottom, with its outputs as they are kept."""
    from nbclient import NotebookClient

    notebook = jupytext.read(path)
    os.environ.pop("MPLBACKEND", None)  # the kernel draws inline
    os.environ["NO_COLOR"] = "1"
    NotebookClient(notebook, timeout=1800, resources={"metadata": {"path": FOLDER}}).execute()
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs = [kept for output in cell.outputs if (kept := _kept(output))]
            cell.metadata.pop("execution", None)
    notebook.metadata["jbw"] = {"code": code_of(notebook)}
    return notebook


def _kept(output: Any) -> Any:
    """An output as it is kept: a figure, or what was printed."""
    if output.output_type == "stream":
        return output if output.name == "stdout" else None
    data = output.data
    if "image/png" in data:
        data = {"image/png": b64encode(smaller(b64decode(data["image/png"]), WIDEST)).decode()}
    elif "text/plain" in data:
        # Objects of Matplotlib that a line returns are no result.
        if re.match(r"[\[(<]*(<matplotlib|<Figure|Text\()", data["text/plain"]):
            return None
        data = {kind: data[kind] for kind in ("text/html", "text/plain") if kind in data}
    else:
        return None
    return nbformat.v4.new_output("display_data", data)


def joined(outputs: list[Any]) -> list[Any]:
    """Outputs in which what was printed in pieces is one."""
    found: list[Any] = []
    for output in outputs:
        if found and output.output_type == found[-1].output_type == "stream":
            found[-1].text += output.text
        else:
            found.append(output)
    return found


def smaller(png: bytes, width: int) -> bytes:
    """A picture of a width at most [px]."""
    from PIL import Image

    picture = Image.open(io.BytesIO(png)).convert("RGB")
    if picture.width > width:
        height = round(picture.height * width / picture.width)
        picture = picture.resize((width, height), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    picture.save(buffer, "png", optimize=True)
    return buffer.getvalue()


def pictures(notebook: Any) -> list[bytes]:
    """All figures that a notebook's cells showed, in their order."""
    return [
        b64decode(output.data["image/png"])
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if "image/png" in output.get("data", {})
    ]


def thumbnail(shown: list[bytes]) -> bytes:
    """A small picture: of those that are wide, the one with most to show, as its file's size."""
    from PIL import Image

    wide = [one for one in shown if (picture := Image.open(io.BytesIO(one))).width > picture.height]
    return smaller(max(wide or shown, key=len), THUMBNAIL)


def faults(notebook: Any) -> list[str]:
    """What must not be kept: an escape code, an error, a figure's cell without its picture."""
    found = []
    for place, cell in enumerate(notebook.cells):
        outputs = cell.get("outputs", [])
        if ESCAPE in str(outputs) or "\\x1b" in str(outputs) or "\\u001b" in str(outputs):
            found.append(f"cell {place} has an escape code")
        if any(output.output_type == "error" for output in outputs):
            found.append(f"cell {place} ended with an error")
    for place in figure_cells(notebook):
        if not any("image/png" in o.get("data", {}) for o in notebook.cells[place].outputs):
            found.append(f"cell {place} draws and shows no picture")
    return found


def with_text_of(kept: Any, text: Any) -> Any:
    """What was kept with the text cells as they are written now, where the code is the same."""
    if kept.metadata["jbw"]["code"] != code_of(text):
        raise SystemExit("The code has changed since: run the notebook again.")
    shown = iter([cell for cell in kept.cells if cell.cell_type == "code"])
    for cell in text.cells:
        if cell.cell_type == "code":
            cell.outputs = next(shown).outputs
    text.metadata["jbw"] = kept.metadata["jbw"]
    return text


def write(path: Path, notebook: Any) -> None:
    """Keep a notebook and its thumbnail, unless something is wrong with it."""
    wrong = faults(notebook)
    if wrong:
        raise SystemExit(f"{path.stem} is not kept: {'; '.join(wrong)}.")
    ran = count(1)
    for number, cell in enumerate(notebook.cells):
        cell["id"] = f"cell-{number}"  # the same at every making, so that changes can be read
        if cell.cell_type == "code":
            cell.outputs, cell.execution_count = joined(cell.outputs), next(ran)
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    notebook.metadata = {"jbw": notebook.metadata["jbw"], "kernelspec": kernel}
    notebook.nbformat, notebook.nbformat_minor = 4, 5
    nbformat.validate(notebook)
    nbformat.write(notebook, path.with_suffix(".ipynb"))
    THUMBNAILS.mkdir(exist_ok=True)
    (THUMBNAILS / f"{path.stem}.png").write_bytes(thumbnail(pictures(notebook)))


def gallery() -> str:
    """The page of the folder: every notebook with its picture, its title and its question."""
    rows = []
    for path in filter(lambda text: text.with_suffix(".ipynb").is_file(), texts()):
        text = jupytext.read(path).cells[0].source
        title = text.splitlines()[0].removeprefix("# ")
        asked = re.search(r"\*(.+?)\*", text, re.DOTALL)
        question = " ".join(asked[1].split()) if asked else ""
        link, picture = path.with_suffix(".ipynb").name, f"{PICTURES}/{path.stem}.png"
        rows.append(f"| [![{title}]({picture})]({link}) | **[{title}]({link})**<br>{question} |")
    return "\n".join([HEAD, "| | notebook |", "| --- | --- |", *rows]) + "\n"


def main(words: list[str]) -> None:
    """Make the notebooks of these numbers, all without any."""
    numbers = [word for word in words if word != "--text"]
    for path in texts():
        kept = "--text" not in words or path.with_suffix(".ipynb").is_file()
        if kept and (not numbers or path.stem.partition("_")[0] in numbers):
            made = (
                with_text_of(nbformat.read(path.with_suffix(".ipynb"), 4), jupytext.read(path))
                if "--text" in words
                else run(path)
            )
            write(path, made)
            print(path.stem, flush=True)
    (FOLDER / "README.md").write_text(gallery(), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
