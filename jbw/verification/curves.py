"""Comparison of measured and predicted harmonics: response curves, stepped sines, tones.

If runs have separate offsets, the draws are those of a new run (`predictive_basis.scattered`): a
test, fitted or not, is compared with the joint of all runs and the scatter between them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import batched
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Complex
from numpy.typing import NDArray

from jbw.measurement.records import Test
from jbw.observables.harmonic_groups import (
    ORDERS,
    MeasuredHarmonic,
    curve_group,
    family_of,
    stepped_groups,
    tone_groups,
)
from jbw.observables.observable import alone
from jbw.observables.steady import Points, added_motion, force_of, motion_of
from jbw.quantities import UNIT_OF
from jbw.report.messages import verification as messages
from jbw.verification.bands import QUANTILE_AXIS, errors, gaussian_band, middle, phase_near, polar
from jbw.verification.predicted import Predicted, Source, carry, noise_of, of_repeats
from jbw.verification.predictive_basis import Draws, count_of

# number of rounds of Newton's method, each of which starts from the median of the last draws
ROUNDS = 3
# relative distance from the solution below which one more round gives an error of 1e-8
CLOSE = 0.01


class Curve(NamedTuple):
    """A measured response curve: one or more harmonics at the same frequencies."""

    groups: Sequence[MeasuredHarmonic]  # measured harmonics, the fundamental first
    test: Test  # the test, or one of the single-tone tests that form the curve


def curves_of(tests: Sequence[Test], of_tones: str = "") -> dict[str, Curve]:
    """Return curves by name: one for each test, but one for all single-tone tests of a level."""
    curves: dict[str, Curve] = {}
    tones: dict[float, list[Test]] = {}
    for test in tests:
        if test.traits.is_controlled:
            continue
        if test.traits.is_curve:
            curves[test.name] = Curve([curve_group(test)], test)
        elif test.traits.is_stepped:
            curves[test.name] = Curve(stepped_groups(test), test)
        elif test.is_single_tone:
            tones.setdefault(test.level, []).append(test)
    for family in tones.values():
        for i, groups in enumerate(batched(tone_groups(family), len(ORDERS))):
            name = family_of(family[0]) + of_tones + (f" {i + 1}" if i else "")
            curves[name] = Curve(groups, family[0])
    return curves


def predict_curve(source: Source, test: Test) -> Predicted:
    """Predict the harmonics of a tone, a stepped sine or a response curve."""
    (predicted,) = predict_curves(source, list(curves_of([test]).values()))
    return predicted


def predict_curves(source: Source, curves: Sequence[Curve]) -> list[Predicted]:
    """Predict the harmonics of all curves: of the response or, if it was controlled, the force."""
    predictions: dict[int, Predicted] = {}
    for residuals in dict.fromkeys(curve.test.residuals for curve in curves):
        indices = [i for i, curve in enumerate(curves) if curve.test.residuals == residuals]
        predicted = _predict_alike(source, [curves[i] for i in indices], residuals)
        predictions |= zip(indices, predicted, strict=True)
    return [predictions[i] for i in range(len(curves))]


def _predict_alike(source: Source, curves: Sequence[Curve], residuals: str) -> list[Predicted]:
    """Predict the harmonics of those curves that have the same residual terms."""
    # Phases of a force refer to the displacement, those of a response to the source. Errors include
    # real and imaginary parts.
    groups = [group for curve in curves for group in curve.groups]
    data = Points.of(groups, laws=source.basis.laws, residuals=residuals)
    # Without names of their data groups, tests of equal shape share compiled code.
    nameless = alone(data)
    (model, peaks), others = source.carried(
        lambda draws, laws: _carried(replace(nameless, laws=laws), draws)
    )
    predictions, row = [], 0
    for curve in curves:
        first, test, fundamental = row, curve.test, curve.groups[0]
        row += len(curve.groups)
        order = np.argsort(fundamental.omega)
        size, variables, attrs, noises = len(order), {}, _facts(fundamental, test), []
        for i, group in enumerate(curve.groups, start=first):
            repeated = of_repeats(data.groups, i)
            noise = noise_of(source.basis, test, repeated, label=group.label, order=group.order)
            noises.append(noise)
            if not np.any(group.values):
                continue  # The sampling rate is too low to show this harmonic.
            of_others = {
                name: values[i, :size]
                for name, (values, _) in others.items()
                # A linear oscillator has no higher harmonics to compare.
                if group.order == 1 or name != "linear"
            }
            values, of_others, std = source.compared(
                noise, model[:, i, :size], of_others, float(data.groups.num_repeats[i])
            )
            harmonic, error_values = _compared(group, test, values, of_others, order, std)
            suffix = "" if group.order == 1 else f"_{group.order}"
            variables |= {name + suffix: variable for name, variable in harmonic.items()}
            attrs |= {name + suffix: value for name, value in error_values.items()}
        freq = ("freq", fundamental.omega[order] / (2 * np.pi), {"units": "Hz"})
        dataset = xr.Dataset(variables, {"freq": freq, "quantile": QUANTILE_AXIS}, attrs)
        # The amplitude of the motion during an FRF measurement is unknown.
        has_amplitude = "ratio" not in test.records[0].provenance
        predictions.append(
            Predicted(dataset, peaks[:, first] if has_amplitude else None, noises[0])
        )
    return predictions


def _carried(
    data: Points, draws: Draws
) -> tuple[Complex[np.ndarray, "draw group value"], NDArray[np.float64]]:
    """Predict the values of each data group for every draw; return peak displacements as well."""
    point, column = np.asarray(data.point), np.asarray(data.position)[:, None]
    is_point = np.asarray(data.factor) != 0  # A group's row is padded after its last point.
    held = np.array(data.of_force)
    size = count_of(draws)
    values = np.zeros((size, *point.shape), complex)
    moved = np.broadcast_to(np.asarray(data.motion), (size, *data.motion.shape))
    if not held.all():
        moved = _motion(data, draws)
        response = moved + carry(added_motion, draws, data)
        values = np.asarray(data.factor) * response[:, point, column]
    if held.any():
        values[:, held] = carry(_forces, draws, data)[:, held]
        of_held = np.isin(np.arange(len(data.omega)), point[held][is_point[held]])
        moved = np.where(of_held[:, None], np.asarray(data.motion), moved)
    return values, np.max(np.abs(moved[..., 0])[:, point], axis=-1, where=is_point, initial=0.0)


def _forces(theta: Mapping[str, Array], data: Points) -> Complex[Array, "group value"]:
    """Return the source amplitudes at which the model reproduces the measured motion."""
    return data.factor * force_of(theta, data)[data.point] / theta["gain"]


def _motion(data: Points, draws: Draws) -> Complex[np.ndarray, "draw point harmonic"]:
    """Return the odd harmonics of displacement at each point, for every draw."""
    # Newton's method starts from the measured motion, which is close only if the model is right.
    # Later rounds start from the median of the draws.
    motion = np.asarray(carry(motion_of, draws, data), complex)
    for _ in range(ROUNDS - 1):
        median = middle(motion)
        guess, distance = data.motion, np.abs(median - np.asarray(data.motion))[:, 0]
        if np.all(distance < CLOSE * np.abs(median[:, 0])):  # A NaN makes this comparison false.
            break
        data = replace(data, motion=jnp.where(np.isfinite(median), median, guess))
        motion = np.asarray(carry(motion_of, draws, data), complex)
    return motion


def _facts(group: MeasuredHarmonic, test: Test) -> dict[str, Any]:
    record = test.records[0]
    held, measured = record.source, record.response
    if group.of_force:
        held, measured = measured, held
    return {
        "level": test.level,
        "level_unit": {**UNIT_OF, **record.units}.get(held, ""),
        "kind": test.kind,
        "held": held,
        "quantity": measured,
    }


def _compared(
    group: MeasuredHarmonic,
    test: Test,
    model: Complex[np.ndarray, "draw value"],
    others: Mapping[str, Complex[np.ndarray, " value"]],
    order: NDArray[np.intp],
    noise_std: float | None,
) -> tuple[dict[str, Any], dict[str, float]]:
    """Return the measured values and bands of one harmonic over frequency, with errors."""
    everything = {"measured": group.values, "model": model, **others}
    # Errors include real and imaginary parts, as in the likelihood.
    parts = {n: np.concatenate([np.real(x), np.imag(x)], axis=-1) for n, x in everything.items()}
    error_values = errors(parts.pop("measured"), parts.pop("model"), parts, noise_std)
    record = test.records[0]
    turn = np.ones(len(order))
    magnitude = {"units": group.unit, "long_name": record.response}
    phase_name = "phase of the response"
    if group.of_force:
        turn = np.exp(-1j * np.angle(group.motion[order, 0]))
        magnitude = {"units": group.unit, "long_name": record.source}
        phase_name = messages.FORCE_PHASE
    measured, model = turn * group.values[order], turn * model[:, order]
    reference = np.angle(measured)
    how = reference, magnitude, {"units": "rad", "long_name": phase_name}
    variables = polar("measured", measured, *how, "freq") | polar("model", model, *how)
    if noise_std is not None:
        size, turned = np.abs(model), phase_near(model, reference)
        # Noise perpendicular to a phasor changes its phase by the ratio of noise to amplitude.
        angle = noise_std / np.abs(np.median(size, axis=0))
        dims = ("quantile", "freq")
        variables["predictive_magnitude"] = (dims, gaussian_band(size, noise_std), magnitude)
        variables["predictive_phase"] = (dims, gaussian_band(turned, angle), how[-1])
    for name, values in others.items():
        variables |= polar(name, turn * values[order], *how, "freq")
    return variables, error_values
