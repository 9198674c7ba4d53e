"""Samplers side by side on one posterior: their numbers, and how far apart they are."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.inference.posterior.summary import diagnose

QUANTILES = {"q010": 0.01, "q500": 0.5, "q990": 0.99}
QUANTITIES = ("mean", "sd", *QUANTILES)
GOOD_R_HAT = 1.01

Row = dict[str, float | None]


def numbers(draws: Float[np.ndarray, "chain draw"]) -> Row:
    """Mean, sd, q010, q500, q990 and mcse_ of each, of one parameter; ess_bulk, ess_tail, r_hat.

    None is for what cannot be had. Vehtari et al. (2021), Bayesian Analysis 16, 667.
    """
    from arviz_stats.base.array import array_stats  # a second of imports, needed only here

    stats: Any = array_stats  # its annotations admit tuples that it never returns here
    row = {"mean": np.mean(draws), "sd": np.std(draws, ddof=1)}
    row |= {name: np.quantile(draws, probability) for name, probability in QUANTILES.items()}
    diagnostics = diagnose(draws)
    row |= diagnostics
    if np.isfinite(diagnostics["ess_bulk"]):
        row |= {f"mcse_{name}": stats.mcse(draws, method=name) for name in ("mean", "sd")}
        for name, probability in QUANTILES.items():
            row[f"mcse_{name}"] = stats.mcse(draws, method="quantile", prob=probability)
    return {name: float(value) if np.isfinite(value) else None for name, value in row.items()}


def exact_numbers(tree: xr.DataTree) -> dict[str, Row]:
    """The same from the table of a quadrature, with the errors that it states."""
    table = tree["exact"].to_dataset()
    error = float(tree.attrs["quadrature_error"])
    rows: dict[str, Row] = {}
    for name in table["parameter"].values:
        column = table.sel(parameter=name)
        row = {"mean": float(column["mean"]), "sd": float(column["sd"])}
        for called, probability in QUANTILES.items():
            row[called] = float(column["quantiles"].sel(probability=probability, method="nearest"))
        errors = {f"mcse_{quantity}": error * row["sd"] for quantity in QUANTITIES}
        rows[str(name)] = {**row, **errors}
    return rows


def worst_ess(rows: Mapping[str, Row]) -> float | None:
    """Smallest effective sample size, of bulk and tail, over all parameters."""
    sizes = [row[kind] for row in rows.values() for kind in ("ess_bulk", "ess_tail")]
    available = [value for value in sizes if value is not None]
    return min(available) if available and len(available) == len(sizes) else None


def reference_of(rows: Mapping[str, Mapping[str, Row]]) -> str:
    """The sampler of the largest worst effective size, of those whose chains agree or of all."""

    def agrees(sampler: str) -> bool:
        r_hats = [row["r_hat"] for row in rows[sampler].values()]
        return all(value is not None and value < GOOD_R_HAT for value in r_hats)

    among = [sampler for sampler in rows if agrees(sampler)] or list(rows)
    return max(among, key=lambda sampler: worst_ess(rows[sampler]) or 0.0)


def distances(row: Row, reference: Row) -> dict[str, float | None]:
    """Distances of all quantities from a reference's, z_ before each."""
    return {f"z_{name}": distance(row, reference, name, f"mcse_{name}") for name in QUANTITIES}


def distance(
    row: Mapping[Any, Any], reference: Mapping[Any, Any], name: str, error: str
) -> float | None:
    r"""Distance in standard errors, $(a - b) / \sqrt{\mathrm{mcse}_a^2 + \mathrm{mcse}_b^2}$."""
    operands: list[Any] = [
        sampler_row.get(key) for key in (name, error) for sampler_row in (row, reference)
    ]
    if None in operands:
        return None
    a, b, *errors = operands
    size = float(np.hypot(*errors))
    return float(a - b) / size if size > 0 else None


def furthest(rows: Sequence[Row]) -> float | None:
    """Largest of all distances, without its sign."""
    scores = [row.get(f"z_{name}") for row in rows for name in QUANTITIES]
    sizes = [abs(value) for value in scores if value is not None]
    return max(sizes) if sizes else None
