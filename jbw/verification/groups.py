"""A test beside the model by its observable alone, where its kind has no trait that says more."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.measurement.records import Test
from jbw.observables.groups import compared
from jbw.observables.observable import Observable
from jbw.observables.register import OBSERVABLES
from jbw.verification.bands import QUANTILE_AXIS, beside, errors
from jbw.verification.predicted import Predicted, RepeatNoise, Source, noise_of, of_repeats
from jbw.verification.predictive_basis import count_of, seen_of


class Group(NamedTuple):
    """One group of a test with its predictions, of complex values the magnitudes."""

    measured: Float[np.ndarray, " value"]  # mean of the repeats
    model: Float[np.ndarray, "draw value"]
    others: dict[str, Float[np.ndarray, " value"]]  # by other oscillators
    noise: RepeatNoise  # of one repeat
    std: float | None  # of the mean, for the bands


def _observable(test: Test) -> type[Observable] | None:
    """What takes a test whose kind has no trait, if it measures repeatedly."""
    taking = (kind for kind in OBSERVABLES if test.kind in kind.kinds and not kind.own_shifts)
    return next(taking, None) if test.traits.is_plain else None


def has_groups_alone(test: Test) -> bool:
    """Whether nothing but the observable of its kind says how a test is predicted."""
    return _observable(test) is not None


def predict_groups(source: Source, test: Test) -> Predicted:
    """Every group of a test of a kind without traits, end to end, beside the model's bands."""
    observable, basis = _observable(test), source.basis
    if observable is None:
        raise TypeError(f"Tests of kind {test.kind} have no observable.")
    parts = observable.reduce([test], laws=basis.laws, substeps=basis.substeps)
    groups = [group for part in parts for group in groups_of(source, test, part)]
    labels = [label for part in parts for label in part.groups.labels]
    positions = [places for part in parts for places in places_of(part)]
    measured = np.concatenate([group.measured for group in groups])
    model = np.concatenate([group.model for group in groups], axis=1)
    others = {
        name: np.concatenate([group.others[name] for group in groups]) for name in source.references
    }
    sizes = [group.measured.size for group in groups]
    noise_stds = [group.std for group in groups if group.std is not None]
    noise_std = np.repeat(noise_stds, sizes) if len(noise_stds) == len(groups) else None
    (axis, unit_of_axis), unit = parts[0].shown().axis, {"units": parts[0].groups.unit}
    variables = beside("value", measured, model, noise_std, unit)
    variables |= {
        f"{name}_response": ("value", response, unit) for name, response in others.items()
    }
    coords = {
        axis: (
            "value",
            np.concatenate(positions),
            {"units": unit_of_axis},
        ),
        "group": ("value", np.repeat(np.array(labels, object), sizes)),
        "quantile": QUANTILE_AXIS,
    }
    attrs: dict[str, Any] = {"kind": test.kind, "axis": axis}
    if np.isfinite(test.level):
        attrs |= {"level": test.level, "level_unit": seen_of(test).source}
    attrs |= errors(measured, model, others, noise_std)
    omega_n = float(np.mean(source.draws["omega_n"]))
    peak = max(part.shown(omega_n).y_peak for part in parts)
    peaks = np.full(count_of(source.draws), peak) if peak > 0 else None
    return Predicted(xr.Dataset(variables, coords, attrs), peaks, groups[0].noise)


def places_of(part: Observable) -> list[Float[np.ndarray, " value"]]:
    """Return where the compared values of each group stand: at their numbers if it does not say."""
    if (places := part.shown().places) is not None:
        return list(places)
    rows = [np.asarray(row) for row in part.mean]
    counts = [row[compared(part.groups, i)].size for i, row in enumerate(rows)]
    return [np.arange(1.0, count + 1.0) for count in counts]


def groups_of(source: Source, test: Test, part: Observable) -> Iterator[Group]:
    """The groups of a part of a test, each with its predictions where these are compared."""
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
        yield Group(plain(np.asarray(part.mean)[i][where]), model, of_others, noise, std)
