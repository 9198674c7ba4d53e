"""How far beyond the displacements that were fitted a test lies."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from jbw.measurement.channels import derivative_order
from jbw.measurement.records import RESPONSES, Test
from jbw.study.verifying import safe

BEYOND = 1.05  # of the fitted displacement: from where on a prediction extrapolates
IN_TIME = ("sweep", "multisine", "decay")


def mark_reach(
    groups: dict[str, xr.Dataset], tests: Sequence[Test], y_peak: float, omega_n: float
) -> None:
    """Give verified tests that were not fitted the attribute `extrapolation`.

    It is the largest displacement that the model predicts, at the upper edge of its 99 % band, over
    the largest among what was fitted; read as that one is, a velocity by division by omega_n.

    Args:
        groups: Path to dataset, of the whole result; changed in place.
        tests: The campaign's tests.
        y_peak: Largest displacement among what was fitted [m].
        omega_n: Natural frequency [rad/s].
    """
    ratios = {safe(test.name) for test in tests if "ratio" in test.records[0].provenance}
    for path, dataset in groups.items():
        kind, _, name = path.removeprefix("/verification/").partition("/")
        if dataset.attrs.get("fitted", 1) or name in ratios or y_peak <= 0:
            continue
        found = _displacement(kind, dataset, omega_n)
        if found is not None:
            dataset.attrs["extrapolation"] = found / y_peak


def _displacement(kind: str, dataset: xr.Dataset, omega_n: float) -> float | None:
    """Largest predicted displacement of a verified test [m]; None where it is not told."""
    attrs = dataset.attrs
    if kind in IN_TIME:
        edges = np.abs(dataset["model_band"].values)
        return float(edges.max()) / omega_n ** derivative_order(str(attrs["response"]))
    if kind == "loop":
        return float(np.max(np.abs(dataset["displacement"].values)))
    if kind != "curve" or "model_magnitude" not in dataset:
        return None
    omega = 2 * np.pi * dataset["freq"].values
    if attrs["quantity"] in RESPONSES:
        upper = dataset["model_magnitude"].isel(quantile=-1).values
        return float(np.max(upper / omega ** derivative_order(attrs["quantity"])))
    return float(np.max(attrs["level"] / omega ** derivative_order(attrs["held"])))
