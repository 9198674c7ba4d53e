"""Storage of predictions under other loads in a folder: numbers, CSV files and figures."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from jbw.report.load_section import POSTERIOR
from jbw.report.loads import load_figure
from jbw.report.messages import loads as messages
from jbw.results.loads import LoadNumber
from jbw.run.netcdf import write_tree
from jbw.study.store import Write, save_outputs, write_figure, write_json
from jbw.verification.places import safe


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
            numbers[f"{slugs[name]}{suffix}.csv"] = partial(_write_text, text)
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


def _write_text(text: str, path: Path) -> None:
    path.write_text(text, encoding="utf-8")
