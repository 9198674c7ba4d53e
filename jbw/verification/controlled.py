"""Points of controlled tests beside the model: what is predicted at the amplitude measured."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr

from jbw.measurement.records import Test
from jbw.observables.controlled import ControlledPoints
from jbw.verification.bands import QUANTILE_AXIS, beside, errors
from jbw.verification.groups import Group, groups_of, places_of
from jbw.verification.predicted import Predicted, Source
from jbw.verification.predictive_basis import count_of

PLACE = "controlled"  # of such tests among others, whatever their kind


def predict_controlled(source: Source, test: Test) -> Predicted:
    """Every group of a controlled test, end to end, each in its `unit` and beside its bands."""
    predictions = [prediction for _, prediction in predict_apart(source, test)]
    together = xr.concat(
        [prediction.dataset for prediction in predictions], "value", combine_attrs="drop"
    )
    sizes = np.array([prediction.dataset.sizes["value"] for prediction in predictions], float)
    attrs = dict(predictions[-1].dataset.attrs)  # of the force, the last
    for name in [str(name) for name in attrs if str(name).startswith("nrmse")]:
        squares = np.array([prediction.dataset.attrs[name] ** 2 for prediction in predictions])
        attrs[name] = float(np.sqrt(np.average(squares, weights=sizes)))
    if all("coverage" in prediction.dataset.attrs for prediction in predictions):
        inside = [prediction.dataset.attrs["coverage"] for prediction in predictions]
        attrs |= {"coverage": float(np.average(inside, weights=sizes)), "num_values": sizes.sum()}
    return Predicted(together.assign_attrs(attrs), predictions[-1].peak, predictions[-1].noise)


def predict_apart(source: Source, test: Test) -> Iterator[tuple[str, Predicted]]:
    """The same, each group by its label.

    Errors are relative: of a force to the force, of a frequency to the half width of the resonance,
    of a phase to one radian, so that all are of one size where a law misses.
    """
    basis = source.basis
    for part in ControlledPoints.reduce([test], laws=basis.laws, substeps=basis.substeps):
        peaks = np.full(count_of(source.draws), part.shown().y_peak)
        groups = zip(part.groups.labels, groups_of(source, test, part), strict=True)
        for number, (label, group) in enumerate(groups):
            dataset = _dataset(test, part, number, group)
            yield label, Predicted(dataset, peaks, group.noise)


def _dataset(test: Test, part: ControlledPoints, number: int, group: Group) -> xr.Dataset:
    std = None if group.std is None else group.std * part.spread(number)
    unit = part.groups.units[number]
    (axis, unit_of_axis), positions = part.shown().axis, places_of(part)[number]
    attributes = {"units": unit, "long_name": part.rows[number].quantity}
    variables = beside("value", group.measured, group.model, std, attributes)
    variables |= {
        f"{name}_response": ("value", reference, attributes)
        for name, reference in group.others.items()
    }
    coords = {
        axis: ("value", positions, {"units": unit_of_axis}),
        "group": ("value", np.array([part.groups.labels[number]] * len(positions), object)),
        "unit": ("value", np.array([unit] * len(positions), object)),
        "quantile": QUANTILE_AXIS,
    }
    attrs: dict[str, Any] = {"kind": test.kind, "axis": axis, "quantity": attributes["long_name"]}
    if np.isfinite(test.level):
        attrs |= {"level": test.level, "level_unit": "m"}

    def relative(values: np.ndarray) -> np.ndarray:
        """Values as 1 and the error of the prediction, in what errors are relative to."""
        return 1.0 + (values - group.measured) / part.relative_to(number)

    others = {name: relative(values) for name, values in group.others.items()}
    noise = None if std is None else std / part.relative_to(number)
    attrs |= errors(np.ones(len(positions)), relative(group.model), others, noise)
    return xr.Dataset(variables, coords, attrs)
