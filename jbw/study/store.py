"""Writing of results into a run's folder; each file is written completely or not at all."""

import json
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from jbw.errors import RunError
from jbw.parts import ENDING, KeptParts, Parts, digest_of
from jbw.report.messages import loads as messages
from jbw.report.messages.run import REPEAT, going_on
from jbw.results.loads import LoadNumber
from jbw.results.run import RunSummary
from jbw.run.files import put_whole, require_room
from jbw.run.folder import lock
from jbw.run.integrity import MARK, sealed
from jbw.run.manifest import versions
from jbw.run.netcdf import write_tree
from jbw.verification.places import safe

if TYPE_CHECKING:  # Matplotlib is loaded when something is drawn.
    from jbw.report.figures import Beside
    from jbw.report.style import Panels

PART = ".part"  # prefix of folders whose files are not yet results
JOB, ASKED, LOCK = f"{PART}s", "asked.json", "lock"  # files of an unfinished job
Write = Callable[[Path], Any]


@dataclass(frozen=True)
class Job:
    """A long computation in an output folder, with the request that started the computation."""

    folder: Path
    asked: str

    def parts(self, inputs: Mapping[str, str], report: Callable[[str], Any]) -> Parts:
        """Return the store of partial results; remove results of other inputs or another version.

        Args:
            inputs: Digests of all input files, by file.
            report: A function that is called with a sentence if parts of an earlier attempt exist.
        """
        mark = digest_of(json.dumps([self.asked, inputs, versions()], sort_keys=True))
        for path in (self.folder / JOB).glob(f"*{ENDING}"):
            if not path.name.startswith(mark):
                path.unlink()
        if self.num_kept:
            report(going_on(self.num_kept))
        return KeptParts(self.folder / JOB, mark)

    @property
    def num_kept(self) -> int:
        """The number of stored partial results of the computation."""
        return len(list((self.folder / JOB).glob(f"*{ENDING}")))


def claim(folder: Path, asked: str = "") -> Path:
    """Claim a new or empty output folder with enough disk space, before any computation.

    Half-written files of a killed process do not count; `writing` removes them. The parts of a
    killed job do not count either if the same is `asked` for.

    Raises:
        RunError: The folder cannot be written, is not empty, or its disk is full.
    """
    require_room(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise RunError(
            f"The output folder {folder} cannot be written: {error.strerror or error}.",
            remedy="Choose another output folder with --out.",
        ) from error
    names = sorted(path.name for path in folder.iterdir() if not path.name.startswith(PART))
    if names and not (asked and _asked_in(folder) == asked):
        raise RunError(
            f"The output folder {folder} must be new or empty, but it contains {names[0]}.",
            why="Results of two runs must not be mixed.",
            remedy="Choose another output folder with --out, or empty the folder.",
        )
    return folder


def _asked_in(folder: Path) -> str:
    """Return the stored request of an unfinished computation in a folder, or else an empty text."""
    try:
        return (folder / JOB / ASKED).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return ""


@contextmanager
def claimed(folder: Path, /, **asked: Any) -> Iterator[Job]:
    """Claim a folder for a long computation, and keep partial results there until it ends.

    If the job fails before a part is finished and before anything is written, its folder is
    removed.

    Args:
        folder: The output folder.
        asked: Plain values that state the request. The parts of an earlier job with the same
            request are used again.

    Raises:
        RunError: As for `claim`; or another process works in the folder.
    """
    job = Job(claim(folder, told := json.dumps(asked, sort_keys=True, default=str)), told)
    (folder / JOB).mkdir(exist_ok=True)
    held = lock(folder / JOB / LOCK, folder)
    try:
        put_whole(folder / JOB / ASKED, told.encode())
        yield job
    except BaseException:
        held.release()
        if not job.num_kept:
            shutil.rmtree(folder / JOB, ignore_errors=True)
            if not any(folder.iterdir()):
                folder.rmdir()
        raise
    held.release()
    shutil.rmtree(folder / JOB, ignore_errors=True)


def save_result(folder: Path, tree: xr.DataTree, summary: Mapping[str, Any]) -> None:
    """Write posterior.nc, then summary.json, whose presence shows that the result is complete."""
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
            remedy=f"Free some space, or make the folder writable; jbw resume {folder} "
            "continues an interrupted run.",
        ) from error


def save_report(
    folder: Path,
    tree: xr.DataTree,
    summary: RunSummary,
    beside: "Beside | None" = None,
    formats: Sequence[str] = (),
) -> None:
    """Write report.html into a result's folder; if this fails, the result stays as it is.

    The figures are also saved in figures/ in each of `formats`. A second process, `beside`, draws
    some of them from the saved result.
    """
    from jbw.report.figures import Files, draw_figures
    from jbw.report.load_section import load_section
    from jbw.report.page import write_page

    try:
        with writing(folder, *(["figures"] if formats else []), "report.html") as part:
            files = Files(part / "figures", formats) if formats else None
            process = None if beside is None else (beside, folder / "posterior.nc")
            drawn = draw_figures(tree, files, process)
            write_page(summary, tree, part / "report.html", drawn, load_section(folder))
    except Exception as error:
        raise RunError(
            f"The report of {folder} failed: {type(error).__name__}: {error}",
            why="posterior.nc and summary.json are saved completely.",
            remedy=f"Write the report again: jbw report {folder}.",
        ) from error


def save_predictions(
    folder: Path, found: Mapping[str, xr.Dataset], rows: Sequence[Mapping[str, Any]]
) -> None:
    """Write predictions.nc, predictions.json and a figure per test; write nothing if one fails."""
    from jbw.report.prediction import prediction

    tree = xr.DataTree.from_dict(
        {f"/{safe(test)}": comparison for test, comparison in found.items()}
    )

    def draw(figures: Path) -> None:
        figures.mkdir()
        for number, (test, comparison) in enumerate(found.items(), start=1):
            slug = re.sub(r"[^\w.-]+", "_", test)
            write_figure(figures / f"{number:02d}_{slug}.png", prediction(test, comparison))

    numbers: dict[str, Write] = {
        "predictions.json": lambda path: write_json(path, list(rows)),
        "predictions.nc": lambda path: write_tree(path, tree),
    }
    save_outputs(folder, numbers, {"figures": draw})


def save_outputs(folder: Path, numbers: Mapping[str, Write], pictures: Mapping[str, Write]) -> None:
    """Write numbers, then figures, so that a failing figure does not lose the numbers.

    Args:
        folder: The output folder.
        numbers: Functions that write one file each, by file name, in the order in which files are
            moved to their place.
        pictures: Functions that write figures and pages, by file name.

    Raises:
        RunError: The pictures failed after the numbers were saved.
        OSError: The numbers cannot be written.
    """
    _save(folder, numbers)
    try:
        _save(folder, pictures)
    except Exception as error:
        raise RunError(
            f"The figures in {folder} failed: {type(error).__name__}: {error}",
            why=f"{', '.join(numbers)} are saved completely.",
            remedy=REPEAT,
        ) from error


def _save(folder: Path, outputs: Mapping[str, Write]) -> None:
    with writing(folder, *outputs) as part:
        for name, write in outputs.items():
            write(part / name)


@contextmanager
def writing(folder: Path, *names: str) -> Iterator[Path]:
    """Yield a hidden folder for the files `names`; at the end, move these files into `folder`."""
    left = list(folder.glob(f"{PART}-*"))  # A killed process may have left these folders.
    with tempfile.TemporaryDirectory(dir=folder, prefix=f"{PART}-") as name:
        yield Path(name)
        for path in left:
            shutil.rmtree(path, ignore_errors=True)
        for output in names:
            part, target = Path(name, output), folder / output
            if target.is_dir():
                shutil.rmtree(target)
            elif part.is_file():
                with part.open("rb+") as stream:
                    # The file's content must be on the disk before its final name.
                    os.fsync(stream.fileno())
            os.replace(part, target)


def write_json(path: Path, value: Any) -> None:
    """Write plain values as JSON; raise an error if a number is not finite."""
    text = json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def write_figure(path: Path, drawn: "Panels") -> None:
    """Write a figure as PNG, completely or not at all."""
    from jbw.report.figures import figure_of

    part = path.with_name(f".{path.name}.part")
    try:
        figure_of(drawn).savefig(part, dpi=130, facecolor="white", format=path.suffix[1:])
        os.replace(part, path)
    except OSError:
        part.unlink(missing_ok=True)
        raise


def save_loads(
    folder: Path,
    found: Mapping[str, xr.Dataset],
    rows: Sequence[LoadNumber],
    posterior: str | None = None,
) -> None:
    """Write loads.nc, loads.json, CSV files and figures of predictions; write nothing if one fails.

    Args:
        folder: The output folder.
        found: Predictions by the names of their loads.
        rows: Single numbers, for loads.json.
        posterior: SHA-256 of the file of the posterior that predicts; a run's report shows
            only predictions by its own posterior.
    """
    from jbw.report.load_section import POSTERIOR, load_figure

    named = {f"/{safe(name)}": dataset.assign_attrs(load=name) for name, dataset in found.items()}
    tree = xr.DataTree.from_dict(named)
    tree.attrs = {} if posterior is None else {POSTERIOR: posterior}
    slugs = {name: messages.slug_of(name) for name in found}

    def draw(figures: Path) -> None:
        figures.mkdir()
        for name, dataset in found.items():
            write_figure(figures / f"{slugs[name]}.png", load_figure(name, dataset))

    numbers: dict[str, Write] = {
        "loads.json": lambda path: write_json(path, plain_rows(rows)),
        "loads.nc": lambda path: write_tree(path, tree),
    }
    for name, dataset in found.items():
        for axis, text in csv_tables(dataset).items():
            suffix = "" if axis in ("freq", "level") else f"_{axis}"
            numbers[f"{slugs[name]}{suffix}.csv"] = partial(
                Path.write_text, data=text, encoding="utf-8"
            )
    save_outputs(folder, numbers, {"figures": draw})


def plain_rows(rows: Sequence[LoadNumber]) -> list[dict[str, Any]]:
    """Return rows of plain values in which infinite numbers and NaN are replaced by None."""
    return [
        {key: None if isinstance(x, float) and not np.isfinite(x) else x for key, x in row}
        for row in rows
    ]


def csv_tables(dataset: xr.Dataset) -> dict[str, str]:
    """Return the bands of a prediction as CSV texts, one for each independent variable."""
    columns: dict[str, dict[str, np.ndarray]] = {}
    for name, values in dataset.data_vars.items():
        if values.dims[:1] != ("quantile",) or len(values.dims) != 2:
            continue
        axis = str(values.dims[1])
        of_axis = columns.setdefault(axis, {
            f"{axis} [{dataset[axis].attrs['units']}]": dataset[axis].values
        })  # fmt: skip
        for end, row in zip(("_low", "", "_high"), values.values, strict=True):
            of_axis[f"{name}{end} [{values.attrs['units']}]"] = row
    return {axis: _csv(of_axis) for axis, of_axis in columns.items()}


def _csv(columns: Mapping[str, np.ndarray]) -> str:
    """Return named columns as a CSV text with nine digits."""
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(f"{x:.9g}" for x in row) for row in rows)]
    return "\n".join(lines) + "\n"
