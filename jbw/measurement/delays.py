"""Removal of a response's delay relative to the drive."""

from dataclasses import replace

import numpy as np

from jbw.errors import DataError
from jbw.measurement.records import Record, Test


def advance(samples: np.ndarray, delay: float, fs: float) -> np.ndarray:
    r"""Remove a delay tau [s] from a signal at rest at both ends: $X(\omega)\,e^{+j\omega\tau}$."""
    if delay == 0.0:
        return samples
    omega = 2 * np.pi * np.fft.rfftfreq(len(samples), 1 / fs)
    return np.fft.irfft(np.fft.rfft(samples) * np.exp(1j * omega * delay), len(samples))


def on_time(test: Test) -> Test:
    """Remove a test's delay; keep only the samples that have both drive and response.

    `settle` excludes the time before the response started; the time after it ended is cut off. A
    record of whole periods is rotated instead, because its ends meet.
    """
    if test.delay == 0.0:
        return test
    shifted = [_on_time(record, test.delay, cyclic=test.is_cyclic) for record in test.records]
    records = tuple(record for record, _ in shifted)
    unknown = max(seconds for _, seconds in shifted)
    return replace(test, records=records, delay=0.0, settle=max(test.settle, unknown))


def _on_time(record: Record, delay: float, *, cyclic: bool) -> tuple[Record, float]:
    whole_samples = 0 if cyclic else round(delay * record.fs)
    size = record.num_samples - abs(whole_samples)
    if size < 2:
        raise DataError(
            f"Key `delay` must be shorter than record `{record.name}` of "
            f"{record.num_samples / record.fs:.4g} s, but is {delay:g} s.",
            remedy="Correct `delay`, or leave the record out with exclude.",
        )
    response = record.channels[record.response]
    x = advance(response, delay - whole_samples / record.fs, record.fs)
    if whole_samples < 0:  # If the response leads, its first samples belong to later times.
        channels = {
            **record.channels,
            record.response: np.append(np.zeros(-whole_samples), x[:size]),
        }
        return replace(record, channels=channels), -whole_samples / record.fs
    channels = {role: values[:size] for role, values in record.channels.items()}
    return replace(record, channels={**channels, record.response: x[whole_samples:]}), 0.0
