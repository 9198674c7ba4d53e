"""Run the notebooks and keep what they show, for the pages of the documentation.

    python docs/run_notebooks.py 1 2        # or all of them, without numbers

`notebooks/outputs` then holds an entry for every cell, named by all code up to it: a page shows the
notebook as it stands, and an output only as long as nothing before it has changed.
"""

import hashlib
import io
import json
import os
import sys
from base64 import b64decode
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jupytext

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"
OUTPUTS = Path(__file__).parent / "notebooks" / "outputs"
COLOURS = 64  # of a stored figure, which has some ten


def cells_of(path: Path) -> Iterator[tuple[str, Any]]:
    """Every cell of a notebook, each with the name of its output."""
    digest = hashlib.sha256()
    for cell in jupytext.read(path).cells:
        if cell.cell_type == "code":
            digest.update(cell.source.encode())
        yield digest.hexdigest()[:16], cell


def run(path: Path) -> None:
    """Run a notebook, and keep the text and the figures of each cell."""
    from nbclient import NotebookClient

    notebook = jupytext.read(path)
    os.environ.pop("MPLBACKEND", None)  # the kernel draws inline
    NotebookClient(notebook, timeout=1800, resources={"metadata": {"path": NOTEBOOKS}}).execute()
    kept = {
        name: [*filter(None, (_kept(name, i, one) for i, one in enumerate(cell.outputs)))]
        for (name, _), cell in zip(cells_of(path), notebook.cells, strict=True)
        if cell.cell_type == "code"
    }
    target = OUTPUTS / f"{path.stem}.json"
    text = json.dumps({name: found for name, found in kept.items() if found}, indent=1)
    target.write_text(text + "\n", encoding="utf-8")


def _kept(name: str, number: int, output: Any) -> dict[str, str] | None:
    """One output: a figure as a file of few colours, or what was printed."""
    from PIL import Image

    data = output.get("data", {})
    if "image/png" in data:
        picture = Image.open(io.BytesIO(b64decode(data["image/png"]))).convert("RGB")
        file = f"{name}_{number}.png"
        picture.quantize(COLOURS).save(OUTPUTS / file, optimize=True)
        return {"image": file}
    if output.output_type == "stream" and output.name == "stdout":
        return {"text": output.text}
    return {"text": data["text/plain"]} if "text/plain" in data else None


def main(numbers: list[str]) -> None:
    """Run the notebooks of these numbers, all without any."""
    OUTPUTS.mkdir(parents=True, exist_ok=True)
    for path in sorted(NOTEBOOKS.glob("[0-9]*_*.py")):
        if not numbers or path.stem.split("_")[0] in numbers:
            run(path)
            print(path.stem)
    known = {
        one["image"]
        for path in OUTPUTS.glob("*.json")
        for found in json.loads(path.read_text(encoding="utf-8")).values()
        for one in found
        if "image" in one
    }
    for path in OUTPUTS.glob("*.png"):
        if path.name not in known:
            path.unlink()


if __name__ == "__main__":
    main(sys.argv[1:])
