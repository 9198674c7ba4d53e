"""The predictive mixture of compared laws, and the folder of a comparison.

The mixture contains draws of every law in proportion to its weight. The weights are those with
which the laws together would have predicted the left-out runs best; with too few runs the best law
predicts alone. Tests beyond the fitted amplitudes and tests of other kinds have separate weights,
of the laws that predict the highest level, or each kind from the others, best.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import xarray as xr

from jbw.errors import DataError
from jbw.identification.evidence import Candidate
from jbw.inference.posterior.summary import posterior_draws
from jbw.law_comparison.answers import weights_for
from jbw.measurement.records import Test
from jbw.report.laws import laws_figure, render_laws
from jbw.report.messages.laws import ACROSS, OUTWARD, WITHIN
from jbw.report.result import require_finite
from jbw.results.laws import StoredLaws
from jbw.run.netcdf import read_tree, write_tree
from jbw.study.store import Write, save_outputs, write_figure, write_json
from jbw.verification.predictive_basis import Basis, basis_attrs, basis_of


def law_groups(
    tests: Sequence[Test], named: Mapping[str, Candidate], draws: Mapping[str, xr.DataTree]
) -> dict[str, xr.Dataset]:
    """Return each law's posterior, with attributes for predictions, by path in the result tree."""
    groups = {}
    for name, candidate in named.items():
        posterior, data = posterior_draws(draws[name]), candidate.fitted.data
        held = {key: float(value) for key, value in data.held.items()}
        omega_n = {**held, **candidate.fitted.fit.theta}.get("omega_n", 1.0)
        attrs = basis_attrs(tests, data, held, float(omega_n))
        groups |= {f"/laws/{name}": xr.Dataset(attrs=attrs), f"/laws/{name}/posterior": posterior}
    return groups


def save_laws(folder: Path, tree: xr.DataTree, record: StoredLaws) -> None:
    """Write laws.nc and laws.json, then laws.png and laws.html."""
    numbers: dict[str, Write] = {
        "laws.nc": lambda path: write_tree(path, tree),
        "laws.json": lambda path: write_json(path, record.plain()),
    }
    pictures: dict[str, Write] = {
        "laws.png": lambda path: write_figure(path, laws_figure(tree)),
        "laws.html": lambda path: path.write_text(render_laws(tree, record), encoding="utf-8"),
    }
    save_outputs(folder, numbers, pictures)


def holds_laws(folder: Path) -> bool:
    """Return whether a folder contains a comparison of laws."""
    return (folder / "laws.json").is_file()


def stack_of(tree: xr.DataTree, record: StoredLaws) -> Basis:
    """Return the inputs of predictions by several weighted laws, best law first."""
    rows, laws = record.laws, tree.children["laws"].children
    (best,) = record.answered("best")
    within = {best: 0.0} | weights_for(rows, WITHIN)
    of_target = {
        target: _mixture(laws, shares)
        for target in (OUTWARD, ACROSS)
        if (shares := weights_for(rows, target)) and shares.keys() != within.keys()
    }
    return replace(_mixture(laws, within), **of_target)


def _mixture(laws: Mapping[str, xr.DataTree], shares: Mapping[str, float]) -> Basis:
    """Combine the laws' draws into one mixture, weighted by `shares`."""
    first, *others = shares
    beside = tuple((shares[name], basis_of(laws[name])) for name in others)
    return replace(basis_of(laws[first]), beside=beside)


def basis_of_laws(folder: Path) -> Basis:
    """Return the inputs of predictions from a folder of compared laws, best law first.

    Raises:
        DataError: The folder contains no complete comparison.
    """
    try:
        record = StoredLaws.read(json.loads((folder / "laws.json").read_text()))
        tree = read_tree(folder / "laws.nc")
        require_finite(tree, folder / "laws.nc")
        return stack_of(tree, record)
    except DataError:
        raise
    except (OSError, KeyError, TypeError, ValueError) as cause:
        raise DataError(
            f"The comparison of laws in {folder} cannot be read: {type(cause).__name__} {cause}",
            remedy="Repeat the comparison: jbw laws CAMPAIGN.toml.",
        ) from cause
