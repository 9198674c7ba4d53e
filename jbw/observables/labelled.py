"""Measured and predicted groups as labelled arrays."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from jbw.observables.observable import Row
from jbw.observables.repeated import Repeated


def datasets(
    data: Repeated,
    axis: tuple[str, str],
    places: Sequence[np.ndarray],
    predicted: np.ndarray | None,
) -> dict[str, xr.Dataset]:
    """The groups of an observable by label.

    Args:
        data: What was measured.
        axis: Name of the coordinate, and its unit.
        places: The coordinate of each group, as long as its mean.
        predicted: Predictions (draw, group, value), or none.
    """
    attrs, found = {"units": data.unit} if data.unit else {}, {}
    rows: list[Row] = data.means
    for i, (label, place, mean) in enumerate(zip(data.labels, places, rows, strict=True)):
        variables: dict[str, Any] = {"measured": (axis[0], mean, attrs)}
        if predicted is not None:
            rows_of = np.asarray(predicted)[:, i, : len(mean)]
            variables["predicted"] = (("draw", axis[0]), rows_of, attrs)
        coordinate = (axis[0], np.asarray(place), {"units": axis[1]})
        found[label] = xr.Dataset(variables, {axis[0]: coordinate}, {"run": data.runs[i]})
    return found
