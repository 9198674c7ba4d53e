"""Predictions under a recorded input from rest: sweeps, noise, multisines, several tones."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jbw.measurement.channels import lines_within
from jbw.measurement.delays import on_time
from jbw.measurement.records import Record, Test
from jbw.measurement.spectra import DEFAULT_SEGMENTS, frf
from jbw.observables.samples import (
    band_limited,
    in_band,
    lines_of,
    motion_under,
    motions_at,
    noise_share,
    response_of,
)
from jbw.oscillator.hold import HeldInput
from jbw.quantities import derivative_order, per
from jbw.verification.bands import QUANTILE_AXIS, about_law, band, beside, error, errors, polar
from jbw.verification.own_constants import completed
from jbw.verification.places import repeats_named
from jbw.verification.predicted import (
    Predicted,
    RepeatNoise,
    Source,
    carry,
    is_measured,
    noise_of,
    of_scatter,
)
from jbw.verification.predictive_basis import Draws, Laws, natural_hz

NEAR = (0.75, 1.25)  # of the natural frequency: the band around the mode
OUTSIDE = 0.005  # of the power of an input: left out below its band, and above it
FORGOTTEN = 7.0  # times 1 / (zeta omega_n): an unknown start has died out to a thousandth
LEAST_LINES = 8  # of a frequency response
SEGMENTS = (DEFAULT_SEGMENTS + 1) / 2  # of which half overlaps the next: their lengths in a record


class Motion(NamedTuple):
    """A test on time beside its simulated responses."""

    test: Test  # its responses advanced by their delay, or the model's median if not measured
    measured: Float[np.ndarray, "repeat time"]  # of the first record's input
    model: Float[np.ndarray, "draw time"]
    peak: Float[np.ndarray, " draw"]  # displacement [m]
    others: dict[str, Float[np.ndarray, " time"]]  # of the oscillators compared with
    noise: RepeatNoise  # of one repeat
    start: int = 0  # samples that are not compared
    repeats: tuple[str, ...] = ("1",)  # names of the measured
    settled: int = 0  # samples until an unknown start has died out, half of the record at most


def predict_motion(
    draws: Draws,
    record: Record,
    laws: Laws,
    *,
    substeps: int = 2,
    residuals: str = "auto",
    point: int = 0,
    source: HeldInput | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Response (draw, time) to the measured input of a record, from rest; peak displacement [m].

    The peak is of the joint's own mode, without what residual terms add to the response, at the
    first point of several, also where the response is at a further one. The `source` is the
    record's input by `band_limited`, for several predictions under it.
    """
    if source is None:
        source = band_limited(record.channels[record.source])
    if not point:
        motions = motions_at(
            draws, source, record.fs, laws=laws, residuals=residuals, substeps=substeps,
            response=record.response,
        )  # fmt: skip
        if motions is not None:
            return motions
    how = _Carried(record.response, laws, substeps, residuals, point)
    return carry(_response, draws, source, record.fs, how)


class _Carried(NamedTuple):
    """What of a motion is predicted, and how; known as it compiles."""

    response: str
    laws: Laws
    substeps: int
    residuals: str
    point: int


def _response(
    theta: Mapping[str, Array], source: HeldInput, fs: float, how: _Carried
) -> tuple[Float[Array, " time"], Float[Array, ""]]:
    motion = motion_under(
        theta, source, fs, laws=how.laws, substeps=how.substeps, every_point=how.point > 0
    )
    responses = response_of(
        motion, theta, source, fs, response=how.response, residuals=how.residuals
    )
    if how.point:
        return responses[how.point], jnp.max(jnp.abs(motion.y[0]))
    return responses, jnp.max(jnp.abs(motion.y))


def motion_of(source: Source, test: Test, *, substeps: int | None = None) -> Motion:
    """Carry the input of a test's first record through the model, by the run's steps when None."""
    test = on_time(test)
    record, steps = test.records[0], substeps or source.basis.substeps
    predict = partial(
        predict_motion,
        record=record,
        substeps=steps,
        residuals=test.residuals,
        point=("", *source.basis.points).index(test.point),
        source=band_limited(record.channels[record.source]),
    )
    (model, peak), others = source.carried(lambda draws, laws: predict(draws, laws=laws))
    reference_responses = {name: response for name, (response, _) in others.items()}
    start = round(_settling(test, source.draws) * record.fs)
    if not is_measured(test):
        stand_in = {**record.channels, record.response: np.median(model, axis=0)}
        test = replace(test, records=(replace(record, channels=stand_in),))
        measured = stand_in[record.response][None]
        noise = noise_of(source.basis, test)
        return Motion(test, measured, model, peak, reference_responses, noise, settled=start)
    # Repeats of the first record's input; noise of the input channel is far below a tenth of it.
    u = record.channels[record.source]
    repeated = {
        name: repeat.channels[repeat.response]
        for name, repeat in zip(repeats_named(test.records), test.records, strict=True)
        if repeat.num_samples == record.num_samples
        and np.linalg.norm(repeat.channels[repeat.source] - u) <= 0.1 * np.linalg.norm(u)
    }
    measured = np.stack(list(repeated.values()))
    lines = lines_of(test.band_hz or (), measured.shape[1], record.fs)
    size = measured.shape[1] if lines is None else 2 * (lines[1] - lines[0])
    model, reference_responses = completed(
        source.basis, test, measured.mean(axis=0), model, reference_responses, start
    )
    compared = in_band(measured, lines)
    within = float(np.sum((compared - compared.mean(axis=0)) ** 2))
    noise = noise_of(source.basis, test, of_scatter(within, size, len(measured)))
    return Motion(
        test, measured, model, peak, reference_responses, noise, start, tuple(repeated), start
    )


def predict_records(source: Source, test: Test) -> Predicted:
    """Bands in time, of the first record where inputs differ, and of the frequency response."""
    # What a record's unknown start makes of it is left out: the first seconds, and `settle`.
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


def compare_records(source: Source, motion: Motion) -> xr.Dataset:
    """Repeats of one input beside the model's responses, in a band where the test has one."""
    test, record = motion.test, motion.test.records[0]
    fs, response, size = record.fs, record.response, motion.measured.shape[1] - motion.start
    lines = lines_of(test.band_hz or (), size, fs)

    def compared(samples: NDArray[np.float64]) -> NDArray[np.float64]:
        return in_band(samples[..., motion.start :], lines)

    measured, model = compared(motion.measured), compared(motion.model)
    others = {name: compared(values) for name, values in motion.others.items()}
    model, others, std = source.compared(
        motion.noise, model, others, share=noise_share(lines, size)
    )
    noise_std = std or 0.0
    mean, unit = measured.mean(axis=0), {"units": record.units[response]}
    variables = beside("time", mean, model, noise_std, unit)
    variables["measured"] = ("time", mean, {**unit, "long_name": f"mean measured {response}"})
    nrmse = [error(repeat, np.median(model, axis=0)) for repeat in measured]
    variables["nrmse_of_repeat"] = ("repeat", nrmse, {"units": "1", "long_name": "error over rms"})
    return xr.Dataset(
        {**variables, "measured_band": (("quantile", "time"), band(measured), unit)},
        {
            "time": ("time", np.arange(size) / fs + motion.start / fs, {"units": "s"}),
            "quantile": QUANTILE_AXIS,
            "repeat": ("repeat", list(motion.repeats)),
        },
        {
            "level": test.level,
            "level_unit": record.units[record.source],
            "response": response,
            "num_repeats": len(measured),
            **errors(mean, model, others, noise_std, measured),
        },
    )


def _resolves(motion: Motion, band_hz: tuple[float, float]) -> bool:
    """Whether the segments of a settled broadband record have enough lines in a band."""
    record = motion.test.records[0]
    segment_s = (record.num_samples - motion.settled) / (SEGMENTS * record.fs)
    lines = (band_hz[1] - band_hz[0]) * segment_s
    return motion.test.traits.is_broadband and lines >= LEAST_LINES


def compare_frfs(motion: Motion, band_hz: tuple[float, float]) -> xr.Dataset:
    """FRF of every repeat, and of every draw under the first one's input, by the same estimator."""
    test, record = motion.test, motion.test.records[0]
    from_rest = test.traits.is_transient and not test.settle
    estimate = partial(_frf, band_hz=band_hz, skip=None if from_rest else motion.settled)
    unit = record.units[record.source]
    measured = [estimate(r, r.channels[r.response]) for r in test.records]
    h = np.stack([receptance for _, receptance in measured])
    model, _ = about_law(motion.model, motion.others)
    simulated = np.stack([estimate(record, response)[1] for response in model])
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
    record: Record, y: NDArray[np.float64], band_hz: tuple[float, float], *, skip: int | None
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    r"""Receptance in a band; of a whole sweep the ratio of spectra, $H = Y(\omega) / U(\omega)$.

    `skip` are samples that are left out at the start of other records; None of a whole sweep.
    """
    u = record.channels[record.source]
    if skip is not None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the window does the same to both sides
            estimate = frf(u[skip:], y[skip:], record.fs, response=record.response, band=band_hz)
        return estimate.freq, estimate.h
    freq = np.fft.rfftfreq(len(u), 1 / record.fs)
    keep = lines_within(freq, band_hz)
    ratio = np.fft.rfft(y)[keep] / np.fft.rfft(u)[keep]
    return freq[keep], ratio / (2j * np.pi * freq[keep]) ** derivative_order(record.response)


def bands_of_modes(draws: Draws) -> list[tuple[float, float]]:
    """The band around every mode that the draws have [Hz]."""
    return [(NEAR[0] * hz, NEAR[1] * hz) for hz in natural_hz(draws)]


def most_driven(record: Record, bands: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """That of some bands [Hz] in which an input has the most power."""
    source = record.channels[record.source]
    freq, power = np.fft.rfftfreq(len(source), 1 / record.fs), np.abs(np.fft.rfft(source)) ** 2
    return max(bands, key=lambda edges: _share(power, freq, edges))


def _share(
    power: NDArray[np.float64], freq: NDArray[np.float64], edges: tuple[float, float]
) -> float:
    """Share of the power in a band."""
    return float(np.sum(power[lines_within(freq, edges)]) / np.sum(power))


def _around_mode(record: Record, draws: Draws) -> tuple[float, tuple[float, float] | None]:
    """Share of an input's power around a mode, the most of any, and how far it fills that [Hz]."""
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
    """Seconds at the start that are not compared: a sweep starts from rest unless it says more."""
    if test.traits.is_transient:
        return test.settle
    record = test.records[0]
    rate = float(np.mean(draws["zeta"] * draws["omega_n"]))
    forgotten = FORGOTTEN / rate if rate > 0 else 0.0
    return min(max(test.settle, forgotten), 0.5 * record.num_samples / record.fs)
