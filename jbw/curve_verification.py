"""Verification on harmonics: response curves, stepped sines and tones against the model's bands.

Where runs have offsets of their own, the draws are those of a further run (`prediction.scattered`):
a test, fitted or not, is compared with the joint of all runs and the scatter between them.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Complex
from numpy.typing import NDArray

from jbw.measurement.records import Test
from jbw.observables import harmonics
from jbw.observables.harmonics import Group
from jbw.prediction import (
    QUANTILES,
    UNITS,
    Draws,
    band,
    beside,
    carry,
    errors,
    gaussian_band,
    noise_of_mean,
)


class Curve(NamedTuple):
    """Harmonics measured at the same frequencies.

    Attributes:
        groups: The harmonics, the fundamental first.
        test: The test they come from, or one of several tones.
    """

    groups: Sequence[Group]
    test: Test


def curve_verification(
    curves: Sequence[Curve],
    draws: Draws,
    references: Mapping[str, Mapping[str, float]] | None = None,
) -> list[xr.Dataset]:
    """Harmonics of response curves, stepped sines or tones beside those of the model.

    Where a controller held the response the force is what is predicted, its phase counted from
    the displacement; else the response, its phase counted from the source.

    Args:
        curves: What was measured; all of it is carried through the model at once.
        draws: Parameters of the joint and gain.
        references: Oscillators to compare with, by name.

    Returns:
        For each curve magnitudes and phases over (freq) and (quantile, freq), of the third
        harmonic with the suffix `_3`; attributes as of `jbw.prediction.errors`, over real and
        imaginary parts.
    """
    if not curves:
        return []
    data = harmonics.gather([group for curve in curves for group in curve.groups])
    model, others = beside(
        lambda some: carry(harmonics.predict, some, data), draws, references or {}
    )
    found, row = [], 0
    for curve in curves:
        rows = range(row, row + len(curve.groups))
        noises = [noise_of_mean(data.repeats, i) for i in rows]
        own = [{name: one[i] for name, one in others.items()} for i in rows]
        found.append(compare_curve(curve, [model[:, i] for i in rows], own, noises))
        row = rows.stop
    return found


def compare_curve(
    curve: Curve,
    models: Sequence[NDArray[np.complex128]],
    others: Sequence[Mapping[str, NDArray[np.complex128]]],
    noises: Sequence[float | None],
) -> xr.Dataset:
    """One curve beside predictions of it, as of `curve_verification`.

    Args:
        curve: What was measured.
        models: Values of each harmonic by every draw.
        others: The same of other oscillators, by name.
        noises: Noise of the mean of each harmonic, in its real and in its imaginary part, where
            it is known.
    """
    omega = curve.groups[0].omega
    order, size = np.argsort(omega), len(omega)
    variables: dict[str, Any] = {}
    attrs: dict[str, Any] = {}
    for group, padded, of_others, noise in zip(curve.groups, models, others, noises, strict=True):
        if not np.any(group.values):
            continue  # a harmonic beyond what the sampling shows
        suffix = "" if group.order == 1 else f"_{group.order}"
        model = padded[:, :size]
        # A linear oscillator has no higher harmonics to compare.
        shown = {n: x[:size] for n, x in of_others.items() if group.order == 1 or n != "linear"}
        parts = {name: _parts(one) for name, one in shown.items()}
        far = errors(_parts(group.values), _parts(model), parts, noise)
        attrs |= {name + suffix: value for name, value in far.items()}
        drawn = _harmonic(group, curve.test, model[:, order], shown, order, noise)
        variables |= {name + suffix: variable for name, variable in drawn.items()}
    return xr.Dataset(
        variables,
        {
            "freq": ("freq", omega[order] / (2 * np.pi), {"units": "Hz"}),
            "quantile": list(QUANTILES),
        },
        {**_facts(curve.groups[0], curve.test), **attrs},
    )


def _parts(values: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Real and imaginary parts, as they enter the likelihood."""
    return np.concatenate([values.real, values.imag], axis=-1)


def _facts(group: Group, test: Test) -> dict[str, Any]:
    """What was held and what was measured."""
    record = test.records[0]
    held, measured = record.source, record.response
    if group.of_force:
        held, measured = measured, held
    return {
        "level": test.level,
        "level_unit": {**UNITS, **record.units}.get(held, ""),
        "kind": test.kind,
        "held": held,
        "quantity": measured,
    }


def _harmonic(
    group: Group,
    test: Test,
    model: Complex[np.ndarray, "draw value"],
    others: Mapping[str, Complex[np.ndarray, " value"]],
    order: NDArray[np.intp],
    noise: float | None,
) -> dict[str, Any]:
    """Variables of one harmonic, in the order of the frequencies."""
    record = test.records[0]
    turn = np.ones(len(order))
    magnitude = {"units": UNITS[record.response], "long_name": record.response}
    what = "phase of the response"
    if group.of_force:
        turn = np.exp(-1j * np.angle(group.motion[order, 0]))
        magnitude = {"units": record.units[record.source], "long_name": record.source}
        what = "phase of the force ahead of the displacement"
    phase = {"units": "rad", "long_name": what}
    measured, model = turn * group.values[order], turn * model
    reference = np.angle(measured)
    dims = ("quantile", "freq")
    found = {
        "measured_magnitude": ("freq", np.abs(measured), magnitude),
        "measured_phase": ("freq", reference, phase),
        "model_magnitude": (dims, band(np.abs(model)), magnitude),
        "model_phase": (dims, band(_near(model, reference)), phase),
    }
    if noise is not None:
        size, turned = np.abs(model), _near(model, reference)
        # Across the phasor a noise turns it by its share of the length.
        angle = noise / np.abs(np.median(size, axis=0))
        found["predictive_magnitude"] = (dims, gaussian_band(size, noise), magnitude)
        found["predictive_phase"] = (dims, gaussian_band(turned, angle), phase)
    for name, values in others.items():
        alone = turn * values[order]
        found[f"{name}_magnitude"] = ("freq", np.abs(alone), magnitude)
        found[f"{name}_phase"] = ("freq", _near(alone, reference), phase)
    return found


def _near(h: NDArray[Any], reference: NDArray[np.float64]) -> NDArray[np.float64]:
    """Phase on the branch next to a reference, so that bands do not straddle +-pi."""
    return reference + np.angle(h * np.exp(-1j * reference))
