"""A run's folder, written whole or not at all."""

import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import xarray as xr

from jbw.errors import RunError
from jbw.report.figures import Beside, Files, draw_figures, figure_of
from jbw.report.page import write_page
from jbw.report.prediction import prediction
from jbw.report.style import Panels
from jbw.run.integrity import MARK, sealed
from jbw.run.netcdf import write_tree
from jbw.verification.places import safe


def claim(folder: Path) -> Path:
    """Make a new or empty folder that a run may be written to, before any work is done."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise RunError(
            f"The output folder {folder} cannot be written: {error.strerror or error}.",
            remedy="Choose another with --out.",
        ) from error
    if any(folder.iterdir()):
        raise RunError(
            f"The output folder {folder} must be new or empty, but it holds "
            f"{sorted(path.name for path in folder.iterdir())[0]}.",
            why="Results of two runs must not be mixed.",
            remedy="Choose another with --out, or empty it.",
        )
    return folder


def save_result(folder: Path, tree: xr.DataTree, summary: Mapping[str, Any]) -> None:
    """Write posterior.nc, and summary.json last: where that stands, the result is whole."""
    try:
        with writing(folder, "posterior.nc", "summary.json") as part:
            marked = tree.copy()
            marked.attrs = {**tree.attrs, MARK: 1}
            write_tree(part / "posterior.nc", marked)
            plain = json.loads(json.dumps(summary, allow_nan=False))
            write_json(part / "summary.json", sealed(plain, part / "posterior.nc"))
    except OSError as error:
        raise RunError(
            f"The result cannot be written to {folder}: {error.strerror or error}.",
            remedy="Free some space, or make the folder writable; an interrupted run goes on with "
            f"jbw resume {folder}.",
        ) from error


def save_report(
    folder: Path,
    tree: xr.DataTree,
    summary: Mapping[str, Any],
    beside: Beside | None = None,
    formats: Sequence[str] = (),
) -> None:
    """Write report.html beside a result, which a failing report does not touch.

    The figures go to figures/ too, in every one of `formats`. A process `beside` this one draws
    some of them, from the result that is saved.
    """
    try:
        with writing(folder, *(["figures"] if formats else []), "report.html") as part:
            files = Files(part / "figures", formats) if formats else None
            process = None if beside is None else (beside, folder / "posterior.nc")
            drawn = draw_figures(tree, files, process)
            write_page(summary, tree, part / "report.html", drawn)
    except Exception as error:
        raise RunError(
            f"The report of {folder} failed: {type(error).__name__}: {error}",
            why="posterior.nc and summary.json are saved and whole.",
            remedy=f"Write the report again: jbw report {folder}.",
        ) from error


def save_predictions(
    folder: Path, found: Mapping[str, xr.Dataset], rows: Sequence[Mapping[str, Any]]
) -> None:
    """Write predictions.nc, predictions.json and figures/, a figure a test; whole as a result."""
    with writing(folder, "figures", "predictions.json", "predictions.nc") as part:
        tree = xr.DataTree.from_dict(
            {f"/{safe(test)}": comparison for test, comparison in found.items()}
        )
        write_tree(part / "predictions.nc", tree)
        (part / "figures").mkdir()
        for number, (test, comparison) in enumerate(found.items(), start=1):
            slug = re.sub(r"[^\w.-]+", "_", test)
            write_figure(
                part / "figures" / f"{number:02d}_{slug}.png", prediction(test, comparison)
            )
        write_json(part / "predictions.json", list(rows))


@contextmanager
def writing(folder: Path, *names: str) -> Iterator[Path]:
    """A hidden folder to write `names` into; in their order moved to their place when complete."""
    with tempfile.TemporaryDirectory(dir=folder, prefix=".part-") as name:
        yield Path(name)
        for output in names:
            part, target = Path(name, output), folder / output
            if target.is_dir():
                shutil.rmtree(target)
            elif part.is_file():
                with part.open("rb+") as stream:
                    os.fsync(stream.fileno())  # its content reaches the disk before its name does
            os.replace(part, target)


def write_json(path: Path, value: Any) -> None:
    """Plain values as JSON; a number that is not finite is an error."""
    text = json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def write_figure(path: Path, drawn: Panels) -> None:
    """A figure as PNG, there whole or not at all."""
    part = path.with_name(f".{path.name}.part")
    try:
        figure_of(drawn).savefig(part, dpi=130, facecolor="white", format=path.suffix[1:])
        os.replace(part, path)
    except OSError:
        part.unlink(missing_ok=True)
        raise
