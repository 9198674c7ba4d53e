"""Comparison of the data groups of a test with the predictions of the likelihood's model.

This applies to tests of plain kinds without a special route, and to points of controlled tests.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.measurement.records import Test
from jbw.observables.groups import compared
from jbw.observables.observable import Observable
from jbw.observables.register import OBSERVABLES
from jbw.results.attributes import PredictedTest
from jbw.verification.bands import QUANTILE_AXIS, beside, errors
from jbw.verification.predicted import Predicted, RepeatNoise, Source, noise_of, of_repeats
from jbw.verification.predictive_basis import count_of, seen_of


class Group(NamedTuple):
    """One data group of a test with its predictions; magnitudes replace complex values."""

    label: str
    measured: Float[np.ndarray, " value"]  # mean of the repeats
    model: Float[np.ndarray, "draw value"]
    others: dict[str, Float[np.ndarray, " value"]]  # predictions of reference models
    noise: RepeatNoise  # noise of each repeat
    std: float | None  # standard deviation of the noise in the mean of the repeats, for the bands


def _observable(test: Test) -> type[Observable] | None:
    """Return the likelihood class of a test that is compared by its data groups alone, or None."""
    taking = (kind for kind in OBSERVABLES if test.kind in kind.kinds and not kind.own_shifts)
    return next(taking, None) if test.traits.is_plain or test.traits.is_controlled else None


def has_groups_alone(test: Test) -> bool:
    """Return whether only the reduced values of a test are compared, and not its records."""
    return _observable(test) is not None


def predict_groups(source: Source, test: Test) -> Predicted:
    """Predict all data groups of a test; return one dataset with bands, and the unit of each group.

    The error is the root mean square over the values of all groups.
    """
    predictions = [prediction for _, prediction in predict_apart(source, test)]
    datasets = [prediction.dataset for prediction in predictions]
    sizes = np.array([dataset.sizes["value"] for dataset in datasets], float)
    # For a controlled test, these are the attributes of the force.
    attrs = dict(datasets[-1].attrs)
    for name in [str(name) for name in attrs if str(name).startswith("nrmse")]:
        squares = np.array([dataset.attrs[name] ** 2 for dataset in datasets])
        attrs[name] = float(np.sqrt(np.average(squares, weights=sizes)))
    if all("coverage" in dataset.attrs for dataset in datasets):
        inside = [PredictedTest.of(dataset).coverage for dataset in datasets]
        attrs |= {"coverage": float(np.average(inside, weights=sizes)), "num_values": sizes.sum()}
    together = xr.concat(datasets, "value", combine_attrs="drop_conflicts")
    return predictions[-1]._replace(dataset=together.assign_attrs(attrs))


def predict_apart(source: Source, test: Test) -> Iterator[tuple[str, Predicted]]:
    """Yield the label and the separate prediction of each data group of a test."""
    observable, basis = _observable(test), source.basis
    if observable is None:
        raise TypeError(
            f"Tests of kind {test.kind} cannot be predicted: register an observable for this kind."
        )
    omega_n = source.omega_n
    for part in observable.reduce([test], laws=basis.laws, substeps=basis.substeps):
        peak = part.shown(omega_n).y_peak
        peaks = np.full(count_of(source.draws), peak) if peak > 0 else None
        for number, group in enumerate(groups_of(source, test, part)):
            yield group.label, Predicted(_dataset(test, part, number, group), peaks, group.noise)


def _dataset(test: Test, part: Observable, number: int, group: Group) -> xr.Dataset:
    """Return the comparison of one data group over its coordinate, with relative errors."""
    shown, unit = part.shown(), part.groups.units[number]
    (axis, unit_of_axis), size = shown.axis, group.measured.size
    positions = np.arange(1.0, size + 1) if shown.places is None else shown.places[number]
    std = group.std
    if std is not None and shown.spreads is not None:
        std = std * shown.spreads[number]
    reference = np.sqrt(np.mean(group.measured**2)) * np.ones(size)
    if shown.references is not None:
        reference = shown.references[number]
    quantity = group.label.removeprefix(test.name).strip()
    attributes = {"units": unit} | ({"long_name": quantity} if quantity else {})
    variables = beside("value", group.measured, group.model, std, attributes)
    variables |= {
        f"{name}_response": ("value", response, attributes)
        for name, response in group.others.items()
    }
    coords = {
        axis: ("value", positions, {"units": unit_of_axis}),
        "group": ("value", np.array([group.label] * size, object)),
        "unit": ("value", np.array([unit] * size, object)),
        "quantile": QUANTILE_AXIS,
    }
    attrs: dict[str, Any] = {"kind": test.kind, "axis": axis}
    attrs |= {"quantity": quantity} if quantity else {}
    if np.isfinite(test.level):
        level_unit = "m" if test.traits.is_controlled else seen_of(test).source
        attrs |= {"level": test.level, "level_unit": level_unit}

    def relative(values: np.ndarray) -> np.ndarray:
        """Return values as 1 plus their error, relative to the reference value."""
        return 1.0 + (values - group.measured) / reference

    others = {name: relative(values) for name, values in group.others.items()}
    noise = None if std is None else std / reference
    attrs |= errors(np.ones(size), relative(group.model), others, noise)
    return xr.Dataset(variables, coords, attrs)


def groups_of(source: Source, test: Test, part: Observable) -> Iterator[Group]:
    """Yield the data groups of a test, with predictions by the model and the reference models."""
    predicted, others = source.observed(part)
    plain = np.abs if part.groups.is_complex else np.asarray
    for i, label in enumerate(part.groups.labels):
        where = compared(part.groups, i)
        repeat_noise, behind = of_repeats(part.groups, i), label.removeprefix(test.name)
        noise = noise_of(source.basis, test, repeat_noise, label=label, behind=behind)
        of_others = {name: plain(other[i][where]) for name, other in others.items()}
        model, of_others, std = source.compared(
            noise, plain(predicted[:, i][:, where]), of_others, len(test.records)
        )
        yield Group(label, plain(np.asarray(part.mean)[i][where]), model, of_others, noise, std)
