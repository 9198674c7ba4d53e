"""Fits of one mode to records of decays and sweeps, and the choice of the band."""

from dataclasses import replace
from typing import Any

import numpy as np

from jbw.measurement.channels import Reals
from jbw.measurement.readings import decay, sweep
from jbw.measurement.readings.decay import DecayFits
from jbw.measurement.readings.sweep import SweepFits, SweepSignal
from jbw.measurement.records import Record
from jbw.quantities import derivative_order

FEWEST = 16  # smallest number of values of an envelope
MOVING = 0.05  # The mode is moving if its motion exceeds this fraction of the largest motion.
# width added on either side, divided by the frequency range in which the mode is moving
PADDED = 0.35
NARROWER = 0.7  # A narrower band replaces the given one if its width is below this fraction.
FAST = 6.0  # smallest half width of a band, as a multiple of the square root of the sweep rate
DRIVEN = 5e-3  # fraction of the drive's energy beyond either end of its sweep
MARGIN = 0.15  # width added on either side, divided by the swept range
MOST_VALUES = (
    20_000  # largest number of values of a thinned sweep; no mode's band needs more values
)


def decay_fits(record: Record, band_hz: tuple[float, float], settle_s: float) -> DecayFits | None:
    """Fit one mode to a record of a decay; return None if its band contains too few values."""
    x = record.channels[record.response][round(settle_s * record.fs) :]
    low, high = band_hz
    if len(x) < FEWEST or not 0 < low < high < record.fs / 2 or not np.any(x):
        return None
    x = x - np.mean(x)
    # The record is scaled to unit amplitude, so the optimiser's steps do not depend on its unit.
    unit = float(np.max(np.abs(x)))
    signal = decay.decay_signal(x / unit, record.fs, band_hz, derivative_order(record.response))
    signal = replace(signal, unit=unit)
    if len(signal.z) < FEWEST or not np.all(signal.size > 0):
        return None
    return decay.fit_bases(signal)


def swept_signal(
    record: Record, band_hz: tuple[float, float] | None, lag_s: float
) -> tuple[SweepSignal, tuple[float, float]] | None:
    """Filter a record of a sweep; return it and the band used, or None if there is no band."""
    u, y = (record.channels[role] for role in (record.source, record.response))
    u, y = u - np.mean(u), y - np.mean(y)
    band = swept_band(u, record.fs, band_hz)
    if band is None:
        return None
    order = derivative_order(record.response)
    units = [float(np.max(np.abs(samples))) for samples in (u, y)]
    u, y = u / units[0], y / units[1]
    facts: Any = {"lag_s": lag_s, "is_force": record.source == "force"}
    signal = sweep.sweep_signal(u, y, record.fs, band, order, **facts)
    if (near := near_resonance(signal, band)) is not None:
        band = near
        signal = sweep.sweep_signal(u, y, record.fs, band, order, **facts)
    return replace(signal, unit=units[1], drive_unit=units[0]), band


def sweep_fits(signal: SweepSignal) -> SweepFits | None:
    """Fit one mode to a sweep; return None for too few or too many values, or without motion."""
    if not FEWEST < len(signal.time) < MOST_VALUES or np.any(signal.rate <= 0):
        return None
    return sweep.fit_bases(signal)


def swept_band(
    u: Reals, fs: float, band_hz: tuple[float, float] | None
) -> tuple[float, float] | None:
    """Return the frequencies [Hz] inside a band that a drive sweeps; None if there are none."""
    freq = np.fft.rfftfreq(len(u), 1 / fs)
    power = np.abs(np.fft.rfft(u)) ** 2
    if not power.sum() > 0 or len(freq) < 8:
        return None
    share = np.cumsum(power) / power.sum()
    low, high = (float(freq[np.searchsorted(share, x)]) for x in (DRIVEN, 1 - DRIVEN))
    wide = max(high - low, 0.05 * high)
    low, high = max(low - MARGIN * wide, 0.25 * low), min(high + MARGIN * wide, 0.49 * fs)
    if band_hz is not None:
        low, high = max(low, band_hz[0]), min(high, band_hz[1])
    return (low, high) if 0 < low < high else None


def near_resonance(signal: SweepSignal, band_hz: tuple[float, float]) -> tuple[float, float] | None:
    """Return a narrower band about the single resonance [Hz]; None if the band is narrow enough.

    The band contains the frequencies at which the motion, including ringing, exceeds 5 % of its
    largest value, and a third more on either side. It lasts at least many lengths of its own
    filter.
    """
    hz, motion = signal.rate / (2 * np.pi), signal.amplitude
    moving = hz[motion > MOVING * motion.max()]
    low, high = float(moving.min()), float(moving.max())
    speed = abs(hz[-1] - hz[0]) / float(np.ptp(signal.time))
    at_top = float(hz[signal.top])
    reach = max(PADDED * (high - low), FAST * np.sqrt(speed))
    low, high = min(low, at_top) - reach, max(high, at_top) + reach
    low, high = max(low, band_hz[0]), min(high, band_hz[1])
    return (low, high) if high - low < NARROWER * (band_hz[1] - band_hz[0]) else None
