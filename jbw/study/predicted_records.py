"""Predictions under a recorded input from rest: sweeps, noise, multisines, several tones."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float
from numpy.typing import NDArray

from jbw.measurement.records import Record, Test
from jbw.observables.response import advance, reduce
from jbw.prediction import Draws, predict_motion
from jbw.study.basis import Basis
from jbw.study.known_noise import Noise, noise_of, or_of_repeats, repeated
from jbw.verification import SETTLING, compare_frfs, compare_records

NEAR = (0.75, 1.25)  # of the natural frequency: the band around the mode
OUTSIDE = 0.005  # of the power of an input: left out below its band, and above it
FORGOTTEN = 7.0  # times 1 / (zeta omega_n): an unknown start has died out to a thousandth
LEAST_LINES = 8  # of a frequency response


class Predicted(NamedTuple):
    """A test beside its prediction.

    Attributes:
        dataset: Measured values and bands.
        peak: Peak displacement of every draw [m]; None where the test does not tell it.
        noise: Noise of one repeat.
    """

    dataset: xr.Dataset
    peak: NDArray[np.float64] | None
    noise: Noise


def predict_records(basis: Basis, test: Test, draws: Draws, *, noise: bool = True) -> Predicted:
    """Bands in time, and of the frequency response around the mode.

    Repeats that have inputs of their own, as of noise, leave the first record to compare in time.
    What a record's unknown start makes of it is left out: the first seconds of noise, and `settle`.

    Args:
        basis: The run.
        test: Its records are the repeats of one input, or noise.
        draws: Parameters of the joint and gain.
        noise: Whether the noise is looked for.
    """
    same = _on_time(replace(test, records=repeated(test)))
    known = noise_of(basis.posterior, basis.seen, test)
    if is_measured(test):
        known = or_of_repeats(known, reduce([same]).repeats)
    record = same.records[0]
    model, peak = predict_motion(draws, record, substeps=basis.substeps)
    if not is_measured(test):  # the median stands in for what nobody measured, and is taken out
        stand_in = {**record.channels, record.response: np.median(model, axis=0)}
        test = same = replace(same, records=(replace(record, channels=stand_in),))
    skip = round(_settling(test, draws) * record.fs)
    found = compare_records(
        _from(same, skip), model[:, skip:], (known.std or 0.0) if noise else 0.0
    )
    found = found.assign_coords(time=found["time"] + skip / record.fs)
    found["time"].attrs["units"] = "s"
    share, band_hz = around_mode(record, draws)
    found.attrs["input_near_mode"] = share
    if band_hz is not None and _has_frf(test):
        beside = compare_frfs(test, model, band_hz)
        found = found.merge(beside).assign_attrs(beside.attrs | found.attrs)
    return Predicted(found, peak, known)


def is_measured(test: Test) -> bool:
    """Whether a test has a response, or is only planned."""
    record = test.records[0]
    return bool(np.any(np.isfinite(record.channels[record.response])))


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


def _has_frf(test: Test) -> bool:
    """Whether the frequency response of a test is estimated: noise must outlast its start."""
    record = test.records[0]
    if test.kind == "sweep":
        return True
    return test.kind in ("noise", "multisine") and record.num_samples > 2 * SETTLING * record.fs


def _on_time(test: Test) -> Test:
    """The test with its responses advanced by their delay."""

    def one(record: Record) -> Record:
        on_time = advance(record.channels[record.response], test.delay, record.fs)
        return replace(record, channels={**record.channels, record.response: on_time})

    return replace(test, records=tuple(one(record) for record in test.records), delay=0.0)


def _settling(test: Test, draws: Draws) -> float:
    """Seconds at the start that are not compared: a sweep starts from rest, others may not."""
    if test.kind == "sweep" or not is_measured(test):
        return 0.0
    record = test.records[0]
    rate = float(np.mean(draws["zeta"] * draws["omega_n"]))
    forgotten = FORGOTTEN / rate if rate > 0 else 0.0
    return min(max(test.settle, forgotten), 0.5 * record.num_samples / record.fs)


def _from(test: Test, skip: int) -> Test:
    """The test without its first samples."""

    def cut(samples: Float[np.ndarray, " time"]) -> Float[np.ndarray, " left"]:
        return samples[skip:]

    return replace(
        test,
        records=tuple(
            replace(record, channels={role: cut(x) for role, x in record.channels.items()})
            for record in test.records
        ),
    )
