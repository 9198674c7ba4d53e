"""A test beside the model by its observable alone, where its kind has no trait that says more."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.measurement.records import Test
from jbw.observables.observable import prediction
from jbw.observables.register import OBSERVABLES
from jbw.observables.repeated import Repeated
from jbw.verification.bands import QUANTILES, band, errors, gaussian_band
from jbw.verification.predicted import Noise, Predicted, Source, carry, noise_of, of_repeats
from jbw.verification.predictive_basis import count_of, seen_of


class Group(NamedTuple):
    """One group of a test with its predictions, of complex values the magnitudes.

    Attributes:
        label: Its label.
        axis: Name and unit of what its values stand over.
        place: Where they stand there.
        unit: Of the values.
        measured: Mean of the repeats.
        model: Prediction by every draw.
        others: Predictions by other oscillators, by name.
        noise: Noise of one repeat.
    """

    label: str
    axis: tuple[str, str]
    place: Float[np.ndarray, " value"]
    unit: str
    measured: Float[np.ndarray, " value"]
    model: Float[np.ndarray, "draw value"]
    others: dict[str, Float[np.ndarray, " value"]]
    noise: Noise


def _observable(test: Test) -> type[Repeated] | None:
    """What takes a test whose kind has no trait, if it measures repeatedly."""
    taking = (one for one in OBSERVABLES if test.kind in one.kinds and issubclass(one, Repeated))
    return next(taking, None) if test.traits.is_plain else None


def has_groups_alone(test: Test) -> bool:
    """Whether nothing but the observable of its kind says how a test is predicted."""
    return _observable(test) is not None


def predict_groups(source: Source, test: Test) -> Predicted:
    """Every group of a test beside what the model predicts of it.

    Args:
        source: What is carried through the model.
        test: Test of a kind without traits.

    Returns:
        `measured` and bands over (value) and (quantile, value), the groups end to end, with the
        coordinates `group` and the observable's own, whose name is the attribute `axis`;
        attributes as of `jbw.verification.bands.errors`.
    """
    observable, basis = _observable(test), source.basis
    if observable is None:
        raise TypeError(f"Tests of kind {test.kind} have no observable.")
    parts = observable.reduce([test], laws=basis.laws, substeps=basis.substeps)
    groups = [group for part in parts for group in _groups(source, test, part)]
    measured = np.concatenate([group.measured for group in groups])
    model = np.concatenate([group.model for group in groups], axis=1)
    others = {
        name: np.concatenate([group.others[name] for group in groups]) for name in source.references
    }
    sizes = [group.measured.size for group in groups]
    stds = [source.std(group.noise, len(test.records)) for group in groups]
    known = [std for std in stds if std is not None]
    noise_std = np.repeat(known, sizes) if len(known) == len(groups) else None
    (axis, unit_of_axis), unit = groups[0].axis, {"units": groups[0].unit}
    bands = ("quantile", "value")
    variables: dict[str, Any] = {
        "measured": ("value", measured, unit),
        "model_band": (bands, band(model), unit),
    }
    if noise_std is not None:
        variables["predictive_band"] = (bands, gaussian_band(model, noise_std), unit)
    variables |= {f"{name}_response": ("value", one, unit) for name, one in others.items()}
    place = np.concatenate([group.place for group in groups])
    labels = np.repeat(np.array([group.label for group in groups], object), sizes)
    attrs: dict[str, Any] = {"kind": test.kind, "axis": axis}
    if np.isfinite(test.level):
        attrs |= {"level": test.level, "level_unit": seen_of(test).source}
    dataset = xr.Dataset(
        variables,
        {
            axis: ("value", place, {"units": unit_of_axis}),
            "group": ("value", labels),
            "quantile": list(QUANTILES),
        },
        attrs | errors(measured, model, others, noise_std),
    )
    peak = max(part.y_peak(float(np.mean(source.draws["omega_n"]))) for part in parts)
    reached = np.full(count_of(source.draws), peak) if peak > 0 else None
    return Predicted(dataset, reached, groups[0].noise)


def _groups(source: Source, test: Test, part: Repeated) -> Iterator[Group]:
    """The groups of a part of a test, each with its predictions."""
    every, others = source.carried(
        lambda draws, laws: carry(prediction, draws, replace(part, laws=laws))
    )
    plain = np.abs if part.is_complex else np.asarray
    for i, label in enumerate(part.labels):
        kept = part.compared(i)
        axis, unit_of_axis, place = part.coordinate(i)
        yield Group(
            label,
            (axis, unit_of_axis),
            place,
            part.unit,
            plain(np.asarray(part.mean)[i][kept]),
            plain(every[:, i][:, kept]),
            {name: plain(other[i][kept]) for name, other in others.items()},
            noise_of(source.basis, test, of_repeats(part.repeats, i), label=label),
        )
