"""Predictions under a recorded input from rest: sweeps, noise, multisines, several tones.

A record is brought on time once, its input carried through the model once; bands in time and of
the frequency response are both made from that.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float
from numpy.typing import NDArray

from jbw.measurement.records import Record, Test
from jbw.measurement.spectra import frf
from jbw.observables.samples import advance, in_band, lines_of, noise_share
from jbw.quantities import derivative_order, per
from jbw.verification.bands import QUANTILES, band, error, gaussian_band, phase_near
from jbw.verification.draws import Draws, predict_motion, with_references
from jbw.verification.noise import Noise, noise_of, of_samples
from jbw.verification.predicted import Predicted, Source, is_measured

SETTLING = 8.0  # s of a noise record during which the unknown start of the motion dies out
NEAR = (0.75, 1.25)  # of the natural frequency: the band around the mode
OUTSIDE = 0.005  # of the power of an input: left out below its band, and above it
FORGOTTEN = 7.0  # times 1 / (zeta omega_n): an unknown start has died out to a thousandth
LEAST_LINES = 8  # of a frequency response


class Motion(NamedTuple):
    """A test on time beside its simulated responses.

    Attributes:
        test: The test, its responses advanced by their delay; where nobody measured one, the
            model's median stands in.
        measured: Responses of the repeats of the first record's input.
        model: Response of every draw to that input.
        peak: Peak displacement of every draw [m].
        others: Responses of the oscillators compared with, by name.
        noise: Noise of one repeat.
        start: Samples at the start that are not compared.
    """

    test: Test
    measured: Float[np.ndarray, "repeat time"]
    model: Float[np.ndarray, "draw time"]
    peak: Float[np.ndarray, " draw"]
    others: dict[str, Float[np.ndarray, " time"]]
    noise: Noise
    start: int


def motion_of(source: Source, test: Test, *, substeps: int | None = None) -> Motion:
    """Carry the input of a test's first record through the model.

    Args:
        source: What is carried.
        test: Its records are the repeats of one input, or noise.
        substeps: Steps of the solver between samples; as many as the run took when None.
    """
    test = _on_time(test)
    record, steps = test.records[0], substeps or source.basis.substeps
    (model, peak), others = with_references(
        lambda some, laws: predict_motion(some, record, laws, substeps=steps),
        source.draws, source.basis.laws, source.references,
    )  # fmt: skip
    alone = {name: response for name, (response, _) in others.items()}
    if not is_measured(test):
        stand_in = {**record.channels, record.response: np.median(model, axis=0)}
        test = replace(test, records=(replace(record, channels=stand_in),))
        measured = stand_in[record.response][None]
        return Motion(test, measured, model, peak, alone, noise_of(source.basis, test), 0)
    measured = np.stack([one.channels[one.response] for one in repeated(test)])
    start = round(_settling(test, source.draws) * record.fs)
    lines = lines_of(test.band_hz or (), measured.shape[1], record.fs)
    size = measured.shape[1] if lines is None else 2 * (lines[1] - lines[0])
    noise = noise_of(source.basis, test, of_samples(in_band(measured, lines), size))
    return Motion(test, measured, model, peak, alone, noise, start)


def predict_records(source: Source, test: Test) -> Predicted:
    """Bands in time, and of the frequency response around the mode.

    Repeats that have inputs of their own, as of noise, leave the first record to compare in time.
    What a record's unknown start makes of it is left out: the first seconds of noise, and `settle`.

    Args:
        source: What is carried.
        test: Its records are the repeats of one input, or noise.
    """
    motion = motion_of(source, test)
    dataset = compare_records(source, motion)
    share, band_hz = around_mode(motion.test.records[0], source.draws)
    dataset.attrs["input_near_mode"] = share
    if band_hz is not None and _has_frf(test):
        in_frequency = compare_frfs(motion, band_hz)
        attrs = in_frequency.attrs | dataset.attrs
        dataset = dataset.merge(in_frequency).assign_attrs(attrs)
    return Predicted(dataset, motion.peak, motion.noise)


def compare_records(source: Source, motion: Motion) -> xr.Dataset:
    r"""Repeats of one input beside the model's responses to it, in a band where the test has one.

    The predictive band is that of a Gaussian with the draws' variance and the noise's together,

    $$m(t) \pm 2.576 \sqrt{\mathrm{var}_\theta[v(t; \theta)] + \sigma^2}$$

    Args:
        source: What was carried.
        motion: The test beside its simulated responses.

    Returns:
        Variables over (quantile, time); attributes `coverage`, the share of all measured samples
        inside the predictive band, `nrmse`, the error of the median against the mean repeat, and
        `nrmse_linear` and so on, that of the oscillators to compare with.
    """
    test, record = motion.test, motion.test.records[0]
    fs, response, size = record.fs, record.response, motion.measured.shape[1] - motion.start
    lines = lines_of(test.band_hz or (), size, fs)

    def compared(samples: NDArray[np.float64]) -> NDArray[np.float64]:
        return in_band(samples[..., motion.start :], lines)

    measured, model = compared(motion.measured), compared(motion.model)
    others = {name: compared(one) for name, one in motion.others.items()}
    noise_std = source.std(motion.noise) or 0.0
    predictive = gaussian_band(model, noise_std * noise_share(lines, size))
    mean = measured.mean(axis=0)
    inside = (measured >= predictive[0]) & (measured <= predictive[-1])
    unit, time = record.units[response], np.arange(size) / fs + motion.start / fs
    dims = ("quantile", "time")
    return xr.Dataset(
        {
            "measured": ("time", mean, {"units": unit, "long_name": f"mean measured {response}"}),
            "measured_band": (dims, band(measured), {"units": unit}),
            "model_band": (dims, band(model), {"units": unit}),
            "predictive_band": (dims, predictive, {"units": unit}),
        },
        {"time": ("time", time, {"units": "s"}), "quantile": list(QUANTILES)},
        {
            "level": test.level,
            "level_unit": record.units[record.source],
            "response": response,
            "num_repeats": len(measured),
            "coverage": float(inside.mean()),
            "num_values": inside.size,
            "nrmse": error(mean, predictive[1]),
            **{f"nrmse_{name}": error(mean, one) for name, one in others.items()},
        },
    )


def compare_frfs(motion: Motion, band_hz: tuple[float, float]) -> xr.Dataset:
    """FRF of every repeat, and of every draw under the first one's input, by the same estimator.

    Args:
        motion: A noise or sweep test beside its simulated responses.
        band_hz: Band to show [Hz].

    Returns:
        Magnitudes and phases, measured over (repeat, freq) and of the model over (quantile, freq).
    """
    test, record = motion.test, motion.test.records[0]
    estimate = _sweep_frf if test.kind == "sweep" else _noise_frf
    source = record.channels[record.source]
    measured = [
        estimate(r.channels[r.source], r.channels[r.response], r, band_hz) for r in test.records
    ]
    freq = measured[0][0]
    h = np.stack([one for _, one in measured])
    simulated = np.stack([estimate(source, one, record, band_hz)[1] for one in motion.model])
    reference = np.angle(h.mean(axis=0))
    unit = record.units[record.source]
    magnitude = {"units": per("m", unit), "long_name": "receptance"}
    phase = {"units": "rad"}
    dims, bands = ("repeat", "freq"), ("quantile", "freq")
    return xr.Dataset(
        {
            "measured_magnitude": (dims, np.abs(h), magnitude),
            "measured_phase": (dims, phase_near(h, reference), phase),
            "model_magnitude": (bands, band(np.abs(simulated)), magnitude),
            "model_phase": (bands, band(phase_near(simulated, reference)), phase),
        },
        {"freq": ("freq", freq, {"units": "Hz"}), "quantile": list(QUANTILES)},
        {"level": test.level, "level_unit": unit, "kind": test.kind},
    )


def _noise_frf(
    u: NDArray[np.float64], y: NDArray[np.float64], record: Record, band_hz: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    skip = round(SETTLING * record.fs)
    estimate = frf(u[skip:], y[skip:], record.fs, response=record.response, band=band_hz)
    return estimate.freq, estimate.h


def _sweep_frf(
    u: NDArray[np.float64], y: NDArray[np.float64], record: Record, band_hz: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    r"""Ratio of the spectra of a whole sweep, $H = Y(\omega) / U(\omega)$."""
    freq = np.fft.rfftfreq(len(u), 1 / record.fs)
    keep = (freq >= band_hz[0]) & (freq <= band_hz[1])
    ratio = np.fft.rfft(y)[keep] / np.fft.rfft(u)[keep]
    return freq[keep], ratio / (2j * np.pi * freq[keep]) ** derivative_order(record.response)


def around_mode(record: Record, draws: Draws) -> tuple[float, tuple[float, float] | None]:
    """Share of an input's power in the band around the mode, and how far it fills that band.

    Args:
        record: The record.
        draws: Parameters of the joint.

    Returns:
        The share, and the lowest and highest frequency [Hz]; None where next to nothing of the
        band is driven.
    """
    source = record.channels[record.source]
    freq = np.fft.rfftfreq(len(source), 1 / record.fs)[1:]
    power = np.abs(np.fft.rfft(source)[1:]) ** 2
    grown = np.cumsum(power) / np.sum(power)
    natural = float(np.mean(draws["omega_n"])) / (2 * np.pi)
    low, high = (part * natural for part in NEAR)
    share = float(np.sum(power[(freq >= low) & (freq <= high)]) / np.sum(power))
    low = max(low, freq[np.searchsorted(grown, OUTSIDE)])
    high = min(high, freq[np.searchsorted(grown, 1 - OUTSIDE)])
    enough = np.count_nonzero((freq >= low) & (freq <= high)) >= LEAST_LINES
    return share, (float(low), float(high)) if enough else None


def repeated(test: Test) -> tuple[Record, ...]:
    """Repeats of the first record's input; the first alone where every repeat has its own."""
    first = test.records[0]
    source = first.channels[first.source]
    size = 0.1 * np.linalg.norm(source)  # noise of the input channel is far below
    return tuple(
        record
        for record in test.records
        if record.num_samples == first.num_samples
        and np.linalg.norm(record.channels[record.source] - source) <= size
    )


def _has_frf(test: Test) -> bool:
    """Whether the frequency response of a test is estimated: noise must outlast its start."""
    record = test.records[0]
    if test.traits.is_transient:
        return True
    return test.traits.is_broadband and record.num_samples > 2 * SETTLING * record.fs


def _on_time(test: Test) -> Test:
    """The test with its responses advanced by their delay."""

    def one(record: Record) -> Record:
        on_time = advance(record.channels[record.response], test.delay, record.fs)
        return replace(record, channels={**record.channels, record.response: on_time})

    return replace(test, records=tuple(one(record) for record in test.records), delay=0.0)


def _settling(test: Test, draws: Draws) -> float:
    """Seconds at the start that are not compared: a sweep starts from rest, others may not."""
    if test.traits.is_transient:
        return 0.0
    record = test.records[0]
    rate = float(np.mean(draws["zeta"] * draws["omega_n"]))
    forgotten = FORGOTTEN / rate if rate > 0 else 0.0
    return min(max(test.settle, forgotten), 0.5 * record.num_samples / record.fs)
