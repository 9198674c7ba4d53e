"""Tests that were not measured: a sweep, a stepped sine or tones, and their prediction."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
import xarray as xr

from jbw.errors import ConfigError
from jbw.measurement.records import Record, Test
from jbw.observables.harmonic_groups import ORDERS
from jbw.observables.steady import planned_motion
from jbw.oscillator.excitation import sampled, sweep
from jbw.quantities import UNIT_OF, derivative_order
from jbw.report.messages import verification as messages
from jbw.verification.bands import QUANTILE_AXIS, gaussian_band, polar
from jbw.verification.predicted import Predicted, Source, noise_of
from jbw.verification.predictive_basis import Basis, Draws, Laws

FADE = 0.02  # duration of the fade-out as a fraction of the sweep's duration


def planned_sweep(
    basis: Basis, band_hz: tuple[float, float], level: float, duration: float, fs: float
) -> Test:
    """Return a linear sweep from rest as a test; its source has the unit of the run's source.

    The fade covers the last 2 % of the sweep.
    """
    _require_positive(sweep=min(band_hz), level=level, duration=duration, fs=fs)
    if max(band_hz) >= 0.5 * fs:
        raise ConfigError(
            f"Argument `sweep` must stay below fs/2 = {0.5 * fs:g} Hz, but reaches "
            f"{max(band_hz):g} Hz.",
            remedy="Raise --fs.",
        )
    u = sampled(sweep(level, *band_hz, duration, fade=FADE * duration), fs, round(duration * fs))
    name = f"sweep {band_hz[0]:g} to {band_hz[1]:g} Hz at {level:g}"
    return Test("sweep", (_record(basis, "sweep", np.asarray(u), fs),), name, level=level)


def planned_tones(basis: Basis, freq_hz: Sequence[float], level: float) -> Test:
    """Return one or more steady tones as a test, at a level in the unit of the run's source."""
    single = len(freq_hz) == 1
    _require_positive(level=level, **{"tone" if single else "stepped": min(freq_hz)})
    kind = "tones" if single else "stepped"
    ends = f"{freq_hz[0]:g}" if single else f"{freq_hz[0]:g} to {freq_hz[-1]:g}"
    name = f"{'tone' if single else kind} {ends} Hz at {level:g}"
    record = _record(basis, kind, np.full(2, level), np.nan)
    return Test(kind, (record,), name, level=level, tones_hz=tuple(map(float, freq_hz)))


def steps(band_hz: tuple[float, float]) -> tuple[float, ...]:
    """Return the frequencies of a stepped sine over a band [Hz]."""
    return tuple(np.linspace(*band_hz, 61).tolist())


def predict_planned(source: Source, test: Test) -> Predicted:
    """Predict the first and third harmonic of the steady motion at each tone of a test."""
    record = test.records[0]
    omega = 2 * np.pi * np.asarray(test.tones_hz)

    def steady(draws: Draws, laws: Laws) -> np.ndarray:
        columns = {name: jnp.asarray(values)[:, None] for name, values in draws.items()}
        return np.asarray(planned_motion(columns, omega, test.level, laws))

    motion, others = source.carried(steady)
    magnitude = {"units": UNIT_OF[record.response], "long_name": record.response}
    phase = {"units": "rad", "long_name": "phase of the response"}
    noises = {order: noise_of(source.basis, test, order=order) for order in ORDERS}
    variables = {}
    for order, noise in noises.items():
        factor = (1j * order * omega) ** derivative_order(record.response)
        of_others = {name: factor * other[:, order // 2] for name, other in others.items()}
        values, _, std = source.compared(noise, factor * motion[:, :, order // 2], of_others)
        middle = np.unwrap(np.angle(np.mean(values, axis=0))).astype(np.float64)
        harmonic = polar("model", values, middle, magnitude, phase)
        if source.noise and std:
            predictive = gaussian_band(np.abs(values), std)
            harmonic["predictive_magnitude"] = (("quantile", "freq"), predictive, magnitude)
        suffix = "" if order == 1 else f"_{order}"
        variables |= {name + suffix: variable for name, variable in harmonic.items()}
    freq = ("freq", omega / (2 * np.pi), {"units": "Hz"})
    attrs = {"held": record.source, "quantity": record.response}
    attrs["level_unit"] = record.units[record.source]
    dataset = xr.Dataset(variables, {"freq": freq, "quantile": QUANTILE_AXIS}, attrs)
    return Predicted(dataset, np.abs(motion[..., 0]).max(axis=-1), noises[1])


def _record(basis: Basis, kind: str, source: np.ndarray, fs: float) -> Record:
    """Return a record that contains only the source, in the units of the run."""
    driven = [
        fitted_test
        for fitted_test in basis.seen.values()
        if fitted_test.source and fitted_test.response in UNIT_OF
    ]
    same_kind = [fitted_test for fitted_test in driven if fitted_test.kind == kind] or driven
    unit = same_kind[0].source if same_kind else messages.SOURCE_UNIT
    response = same_kind[0].response if same_kind else "displacement"
    role = "force" if unit == "N" else "input"
    return Record(
        fs,
        {role: source, response: np.full(len(source), np.nan)},
        {role: unit, response: UNIT_OF[response]},
        name="not measured",
    )


def _require_positive(**values: float) -> None:
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0):
            example = {"sweep": "10:25", "stepped": "15:22"}.get(name, "1")
            raise ConfigError(
                f"Argument `{name}` must be positive, but is {value:g}.",
                remedy=f"Give a positive value, for example --{name} {example}.",
            )
