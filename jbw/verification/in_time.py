"""Predictions under a recorded input, from rest: sweeps, noise, multisines, several tones."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jbw.inference.lanes import LANES, at_points, seeing, solved_first
from jbw.measurement.channels import lines_within
from jbw.measurement.delays import on_time
from jbw.measurement.records import Record, Test
from jbw.measurement.spectra import DEFAULT_SEGMENTS, frf
from jbw.observables.dataset import Dataset, solved, unnamed
from jbw.observables.groups import single_records
from jbw.observables.modes import Modes
from jbw.observables.records import Records
from jbw.observables.residual_terms import has_own, own_columns
from jbw.observables.samples import (
    band_limited,
    in_band,
    motion_under,
    noise_share,
    response_of,
)
from jbw.oscillator.modes.parameters import has_further_modes
from jbw.quantities import UNIT_OF, derivative_order, per
from jbw.verification.bands import QUANTILE_AXIS, about_law, band, beside, error, errors, polar
from jbw.verification.places import repeats_named
from jbw.verification.predicted import LANES as SIDE_BY_SIDE
from jbw.verification.predicted import (
    Predicted,
    RepeatNoise,
    Source,
    is_measured,
    noise_of,
    of_repeats,
)
from jbw.verification.predictive_basis import Basis, Draws, count_of, natural_hz

NEAR = (0.75, 1.25)  # band around a mode, relative to its natural frequency
OUTSIDE = 0.005  # fraction of the input's power that is omitted on each side of its band
# time, in units of 1 / (zeta omega_n), after which the effect of the start is below a thousandth
FORGOTTEN = 7.0
LEAST_LINES = 8  # smallest number of lines with which a frequency response is estimated
# ratio of record length to segment length, for segments that overlap by half
SEGMENTS = (DEFAULT_SEGMENTS + 1) / 2
DrawnTime = Float[np.ndarray, "draw time"]
Time = Float[np.ndarray, " time"]
Others = dict[str, Time]


class Motion(NamedTuple):
    """A test in the time domain with simulated responses, from the first evaluated sample on.

    Attributes:
        test: The test; if not measured, its response is the median of the model.
        data: Repeats of the test with the same input.
        model: Responses of the draws.
        peak: Largest displacement of every draw [m].
        others: Responses of reference oscillators.
        noise: Noise of one repeat.
        repeats: Names of the repeats.
        unsettled: Number of samples of the model until an unknown start has died out.
    """

    test: Test
    data: Records
    model: DrawnTime
    peak: Float[np.ndarray, " draw"]
    others: dict[str, Float[np.ndarray, " time"]]
    noise: RepeatNoise
    repeats: Sequence[str] = ("1",)
    unsettled: int = 0


def responses_at(draws: Draws, data: Records) -> tuple[DrawnTime, Float[np.ndarray, " draw"]]:
    """Return the response of each draw to a recorded input, and its largest displacement [m].

    The displacement is that of the joint's mode, without residual terms of the response, at the
    first point even if the response is at another one.
    """
    lanes = min(LANES if data.is_marched(draws) else SIDE_BY_SIDE, count_of(draws))
    return at_points(_response, draws, Dataset.of([data]), lanes=lanes)


@seeing(unnamed)
@solved_first(partial(solved, writes=True))
def _response(
    theta: Mapping[str, Array], dataset: Dataset
) -> tuple[Float[Array, " time"], Float[Array, ""]]:
    data: Any = dataset.parts[0]
    if data.solution is not None:
        return data.predict(theta)[0], data.solution.y_peak[0]
    source, (point,) = jax.tree.map(lambda x: x[0], data.held), data.points
    motion = motion_under(theta, source, data.fs, every_point=bool(point), **data.solving)
    how = {"response": data.response, "residuals": data.residuals}
    seen = response_of(motion, theta, source, data.fs, **how)[..., data.skipped :]
    if point:
        return seen[1 + data.modes.points.index(point)], jnp.max(jnp.abs(motion.y[0]))
    return seen, jnp.max(jnp.abs(motion.y))


def reduced(basis: Basis, test: Test, substeps: int | None = None, **how: Any) -> Records:
    """Return a test's records in the form that the likelihood needs, with the laws of a run."""
    steps = substeps or basis.substeps
    data = Records.of([test], laws=basis.laws, substeps=steps, **how)
    return replace(data, modes=Modes((), points=basis.points), depth=None)


def motion_of(source: Source, test: Test, *, substeps: int | None = None) -> Motion:
    """Simulate the model under a test's first recorded input, with the run's step by default."""
    test = on_time(test)
    record = test.records[0]
    # Use the repeats whose input differs from that of the first record by less than a tenth.
    u = record.channels[record.source]
    repeats = {
        name: repeat
        for name, repeat in zip(repeats_named(test.records), test.records, strict=True)
        if repeat.num_samples == record.num_samples
        and np.linalg.norm(repeat.channels[repeat.source] - u) <= 0.1 * np.linalg.norm(u)
    }
    settling = _settling(test, source.draws)
    compared = replace(
        test, records=tuple(repeats.values()), settle=settling if is_measured(test) else 0.0
    )
    data = replace(reduced(source.basis, compared, substeps), held=band_limited(u[None]))
    if is_measured(test):
        return followed(source, test, data)._replace(repeats=tuple(repeats))
    motion = followed(source, test, data)
    median = np.median(motion.model, axis=0)
    stand_in = replace(record, channels={**record.channels, record.response: median})
    return motion._replace(
        test=replace(test, records=(stand_in,)),
        data=replace(data, mean=in_band(median, data.lines)[None]),
        unsettled=round(settling * record.fs),
    )


def followed(source: Source, test: Test, data: Records) -> Motion:
    """Return a test together with the model's responses to its recorded input."""
    (model, peak), others = source.carried(
        lambda draws, laws: responses_at(draws, replace(data, laws=laws))
    )
    responses = {name: response for name, (response, _) in others.items()}
    if is_measured(test):
        model, responses = completed(source.basis, data, model, responses)
    noise = noise_of(source.basis, test, of_repeats(data.groups))
    return Motion(test, data, model, peak, responses, noise)


def predict_records(source: Source, test: Test) -> Predicted:
    """Predict the records of a test over time and, if it can be estimated, the receptance."""
    # Omit the first seconds (at least `settle`), because the state before the record is unknown.
    motion = motion_of(source, test)
    dataset = compare_records(source, motion)
    record = motion.test.records[0]
    share, band_hz = _around_mode(record, source.draws)
    dataset.attrs["input_near_mode"] = share
    if band_hz is not None and (test.traits.is_transient or _resolves(motion, band_hz)):
        in_frequency = compare_frfs(motion, band_hz)
        dataset = dataset.merge(in_frequency, join="outer").assign_attrs(
            in_frequency.attrs | dataset.attrs
        )
    return Predicted(dataset, motion.peak, motion.noise)


def compare_in_time(
    source: Source,
    motion: Motion,
    repeats: Float[np.ndarray, "repeat time"] | None = None,
    num_repeats: float = 1.0,
) -> tuple[xr.Dataset, DrawnTime, dict[str, Float[np.ndarray, " time"]]]:
    """Return a test's mean and bands over time, with the draws and reference models.

    Bands are those of a mean of `num_repeats`. If `repeats` are given, coverage counts their
    values, and the band is that of the parameters alone if no noise is known.
    """
    data, lines, record = motion.data, motion.data.lines, motion.test.records[0]
    mean = np.asarray(data.mean[0])
    others = {name: in_band(values, lines) for name, values in motion.others.items()}
    model, share = in_band(motion.model, lines), noise_share(lines, len(mean))
    model, others, std = source.compared(motion.noise, model, others, num_repeats, share)
    std = std if repeats is None else std or 0.0
    unit = {"units": UNIT_OF[data.response], "long_name": data.response}
    dataset = xr.Dataset(
        beside("time", mean, model, std, unit),
        {
            "time": ("time", (data.skipped + np.arange(len(mean))) / data.fs, {"units": "s"}),
            "quantile": QUANTILE_AXIS,
        },
        {
            "level": motion.test.level,
            "level_unit": record.units[record.source],
            "response": data.response,
            **errors(mean, model, others, std, repeats),
        },
    )
    return dataset, model, others


def compare_records(source: Source, motion: Motion) -> xr.Dataset:
    """Compare repeats of one input with the model's responses, in the band of the test."""
    data = motion.data
    measured = single_records(np.asarray(data.mean), data.groups).mean[0]
    dataset, model, _ = compare_in_time(source, motion, measured)
    nrmse = [error(repeat, np.median(model, axis=0)) for repeat in measured]
    unit = dataset["measured"].attrs
    variables = {
        "measured_band": (("quantile", "time"), band(measured), unit),
        "nrmse_of_repeat": ("repeat", nrmse, {"units": "1", "long_name": "error over rms"}),
    }
    repeats = {"repeat": ("repeat", list(motion.repeats))}
    dataset["measured"].attrs = {**unit, "long_name": f"mean measured {data.response}"}
    return dataset.assign(variables).assign_coords(repeats).assign_attrs(num_repeats=len(measured))


def _resolves(motion: Motion, band_hz: tuple[float, float]) -> bool:
    """Return whether a broadband record's segments have enough spectral lines in a band."""
    segment_s = (motion.model.shape[1] - motion.unsettled) / (SEGMENTS * motion.data.fs)
    lines = (band_hz[1] - band_hz[0]) * segment_s
    return motion.test.traits.is_broadband and lines >= LEAST_LINES


def compare_frfs(motion: Motion, band_hz: tuple[float, float]) -> xr.Dataset:
    """Compare the FRF of each repeat with the FRFs of the draws, estimated in the same way."""
    test, record = motion.test, motion.test.records[0]
    whole = test.traits.is_transient and not test.settle
    unsettled = 0 if whole else motion.unsettled
    first = motion.data.skipped + unsettled
    estimate = partial(_frf, band_hz=band_hz, whole=whole)
    unit = record.units[record.source]
    measured = [estimate(r, r.channels[r.response][first:]) for r in test.records]
    h = np.stack([receptance for _, receptance in measured])
    model, _ = about_law(motion.model, motion.others)
    simulated = np.stack([estimate(record, response[unsettled:])[1] for response in model])
    how = np.angle(h.mean(axis=0)), {"units": per("m", unit), "long_name": "receptance"}
    phase = {"units": "rad"}
    return xr.Dataset(
        {
            **polar("measured", h, *how, phase, ("repeat", "freq")),
            **polar("model", simulated, *how, phase),
        },
        {
            "freq": ("freq", measured[0][0], {"units": "Hz"}),
            "quantile": QUANTILE_AXIS,
            "repeat": ("repeat", repeats_named(test.records)),
        },
        {"level": test.level, "level_unit": unit, "kind": test.kind},
    )


def _frf(
    record: Record, y: NDArray[np.float64], band_hz: tuple[float, float], *, whole: bool
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    r"""Return the receptance in a band; for a whole sweep it is $H = Y(\omega) / U(\omega)$.

    It is estimated from the last samples of the input, as many as the response has.
    """
    u = record.channels[record.source][-len(y) :]
    if not whole:
        with warnings.catch_warnings():
            # The window then affects the measurement and the model in the same way.
            warnings.simplefilter("ignore")
            estimate = frf(u, y, record.fs, response=record.response, band=band_hz)
        return estimate.freq, estimate.h
    freq = np.fft.rfftfreq(len(u), 1 / record.fs)
    keep = lines_within(freq, band_hz)
    ratio = np.fft.rfft(y)[keep] / np.fft.rfft(u)[keep]
    return freq[keep], ratio / (2j * np.pi * freq[keep]) ** derivative_order(record.response)


def bands_of_modes(draws: Draws) -> list[tuple[float, float]]:
    """Return the band around each mode of the draws [Hz]."""
    return [(NEAR[0] * hz, NEAR[1] * hz) for hz in natural_hz(draws)]


def most_driven(record: Record, bands: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the band [Hz], out of several, in which an input has the most power."""
    source = record.channels[record.source]
    freq, power = np.fft.rfftfreq(len(source), 1 / record.fs), np.abs(np.fft.rfft(source)) ** 2
    return max(bands, key=lambda edges: _share(power, freq, edges))


def _share(
    power: NDArray[np.float64], freq: NDArray[np.float64], edges: tuple[float, float]
) -> float:
    return float(np.sum(power[lines_within(freq, edges)]) / np.sum(power))


def _around_mode(record: Record, draws: Draws) -> tuple[float, tuple[float, float] | None]:
    """Return the fraction of an input's power near the most driven mode, and its band [Hz]."""
    source = record.channels[record.source]
    freq = np.fft.rfftfreq(len(source), 1 / record.fs)[1:]
    power = np.abs(np.fft.rfft(source)[1:]) ** 2
    grown = np.cumsum(power) / np.sum(power)
    shares = {edges: _share(power, freq, edges) for edges in bands_of_modes(draws)}
    low, high = max(shares, key=lambda edges: shares[edges])
    share = shares[low, high]
    low = max(low, freq[np.searchsorted(grown, OUTSIDE)])
    high = min(high, freq[np.searchsorted(grown, 1 - OUTSIDE)])
    enough = np.count_nonzero(lines_within(freq, (low, high))) >= LEAST_LINES
    return share, (float(low), float(high)) if enough else None


def _settling(test: Test, draws: Draws) -> float:
    """Return the time to omit at the start [s]; zero for a sweep from rest without `settle`."""
    if test.traits.is_transient:
        return test.settle
    record = test.records[0]
    rate = float(np.mean(draws["zeta"] * draws["omega_n"]))
    forgotten = FORGOTTEN / rate if rate > 0 else 0.0
    return min(max(test.settle, forgotten), 0.5 * record.num_samples / record.fs)


def completed(
    basis: Basis, data: Records, model: DrawnTime, others: Others
) -> tuple[DrawnTime, Others]:
    """Add residual constants, fitted to the test itself, to all predicted responses of a test.

    The constants are fitted in the test's band.
    """
    if not has_own(data.residuals, several_modes=has_further_modes(basis.posterior)):
        return model, others
    force = np.asarray(data.source)[:, data.skipped :]
    (columns,) = own_columns(force, data.fs, data.response, None)
    columns_in_band = in_band(columns, data.lines)
    size = np.linalg.norm(columns_in_band, axis=1)[:, None]

    def added(response: Time) -> Time:
        """Return the response of constants U and L, fitted to measured minus predicted values."""
        residual = np.asarray(data.mean[0]) - in_band(response, data.lines)
        return np.linalg.lstsq((columns_in_band / size).T, residual)[0] @ (columns / size)

    model = model + added(np.median(model, axis=0))
    return model, {name: response + added(response) for name, response in others.items()}
