"""One examination of a record for all commands, kept in a cache: frequency, damping and faults."""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from jbw.cache import cached, keep
from jbw.errors import DataError, JbwError
from jbw.measurement.faults.begins_late import begins_late
from jbw.measurement.faults.drop_off import RANDOM, drive_course
from jbw.measurement.faults.fault import Fault, doubt
from jbw.measurement.faults.hypotheses import explained
from jbw.measurement.faults.hypothesis import Facts, Fits
from jbw.measurement.faults.responses import about_peak, undecaying
from jbw.measurement.faults.second_mode import damping_rate, first_hz
from jbw.measurement.readings.read import decay_fits, sweep_fits, swept_signal
from jbw.measurement.readings.sweep import SweepFits
from jbw.measurement.readings.table import MeasuredChange, ModeReading, read_fits
from jbw.measurement.records import Record, Test
from jbw.measurement.spans import start_of
from jbw.report.messages import decay_faults as messages
from jbw.report.messages.reading import none_decays
from jbw.sources import sources_of

Band = tuple[float, float]
UNREADABLE = (ArithmeticError, IndexError, JbwError, ValueError, np.linalg.LinAlgError)
FOLDER = "readings"  # folder of the user's cache
# Packages that determine the result: a change of their source invalidates the cache.
SOURCES = ("jbw.measurement.readings", "jbw.measurement.faults", "jbw.report.messages")


@dataclass(frozen=True)
class Examined:
    """Frequency and damping measured in one record, with its faults and the band used.

    Attributes:
        reading: Frequency and damping against amplitude; None if they cannot be read.
        faults: Errors and doubts found in the record.
        band_hz: Band that was read [Hz].
    """

    reading: ModeReading | None
    faults: tuple[Fault, ...]
    band_hz: Band


_read: dict[str, Examined] = {}


def examined_decay(record: Record, band_hz: Band | None, settle_s: float) -> Examined:
    """Measure frequency and damping of a free decay's record, and find its faults.

    Args:
        record: A record whose samples are all finite.
        band_hz: Band of its single mode [Hz]; if None, a band about its strongest line.
        settle_s: Time at the start of the record that is not read [s].
    """
    band = band_hz or about_peak(record, settle_s)
    key = _key(record, "decay", (*band, settle_s))
    return _kept(key, band, lambda: _decay(record, band, settle_s))


def read_decays(test: Test) -> list[ModeReading | None]:
    """Return frequency and damping of each record of a decay test; None for unreadable records.

    Raises:
        DataError: No record can be read.
    """
    found = [examined_decay(record, test.band_hz, test.settle) for record in test.records]
    readings = [one.reading for one in found]
    if all(reading is None for reading in readings):
        faults = [fault for one in found for fault in one.faults]
        what, why, remedy = none_decays(test.name)
        if faults:
            why, remedy = faults[0].what, faults[0].remedy or remedy
        raise DataError(what, why=why, remedy=remedy)
    return readings


def examined_sweep(record: Record, band_hz: Band | None, delay_s: float) -> Examined:
    """Measure frequency and damping in a sweep's record, and find its faults.

    Args:
        record: A record whose source and response have finite samples.
        band_hz: Band of its single mode [Hz]; if None, the band that the drive sweeps.
        delay_s: Stated lag of the response [s].
    """
    key = _key(record, "sweep", (*(band_hz or ()), delay_s))
    swept = band_hz or (0.0, record.fs / 2)
    return _kept(key, swept, lambda: _sweep(record, band_hz, delay_s))


def _decay(record: Record, band: Band, settle_s: float) -> Examined:
    late = tuple(begins_late(record, band, settle_s)) or tuple(undecaying(record, settle_s))
    if late:
        return Examined(None, late, band)
    fits = decay_fits(record, band, settle_s)
    if fits is None:
        return Examined(None, (), band)
    faults = tuple(explained(fits, Facts(record, settle_s, 0.0, band)))
    return Examined(_read_fits(fits), faults, band)


def _sweep(record: Record, band_hz: Band | None, delay_s: float) -> Examined:
    found = swept_signal(record, band_hz, delay_s)
    if found is None:
        return Examined(None, (), band_hz or (0.0, record.fs / 2))
    signal, band = found
    _, varies = drive_course(signal)
    if varies > RANDOM or (fits := sweep_fits(signal)) is None:
        return Examined(None, (), band)
    if unpassed := tuple(_unpassed(fits, record)):
        return Examined(None, unpassed, band)
    faults = tuple(explained(fits, Facts(record, 0.0, delay_s, band)))
    return Examined(_read_fits(fits), faults, band)


def _unpassed(fits: SweepFits, record: Record) -> Iterator[Fault]:
    """Yield a warning if a sweep ends more than two half-power widths before the resonance."""
    hz, reach = first_hz(fits), 4 * damping_rate(fits) / (2 * np.pi)
    low, high = (float(end) / (2 * np.pi) for end in np.quantile(fits.signal.rate, [0, 1]))
    if not low - reach < hz < high + reach:
        yield doubt(record.response, *messages.unpassed(low, high, hz))


def _read_fits(fits: Fits) -> ModeReading | None:
    """Return frequency and damping from the fits to a record, or None without known errors."""
    try:
        return read_fits(fits)
    except np.linalg.LinAlgError:
        return None


def _key(record: Record, kind: str, numbers: Sequence[float]) -> str:
    """Return a hash of everything that determines the examination of a record."""
    digest = hashlib.blake2b(sources_of(*SOURCES).encode(), digest_size=20)
    facts = kind, record.fs, numbers, record.name, start_of(record), record.drive
    digest.update(repr(facts).encode())
    for role in sorted(record.channels):
        digest.update(role.encode())
        digest.update(np.ascontiguousarray(record.channels[role]).tobytes())
    return digest.hexdigest()


def _kept(key: str, band: Band, make: Callable[[], Examined]) -> Examined:
    """Return the stored examination of a record; if there is none, examine the record and store it.

    If the folder cannot be written or a file cannot be read, the only cost is a new computation.
    The result is empty if the numerics fail on an unusual record.
    """
    if key not in _read:
        if (kept := _opened(cached(FOLDER, f"{key}.json"))) is None:
            kept = Examined(None, (), band)
            # Searches may diverge.
            with suppress(*UNREADABLE), np.errstate(all="ignore"):
                kept = make()
            content = json.dumps(asdict(kept), default=np.ndarray.tolist)
            keep(FOLDER, f"{key}.json", content.encode())
        _read[key] = kept
    return _read[key]


def _opened(content: bytes | None) -> Examined | None:
    try:
        return None if content is None else _from_json(json.loads(content))
    except (ValueError, TypeError, KeyError):
        return None


def _from_json(kept: Mapping[str, Any]) -> Examined:
    reading: Any = kept["reading"]
    if reading is not None:
        types = {field.name: field.type for field in fields(ModeReading)}
        values: dict[str, Any] = {
            name: MeasuredChange(*value)
            if types[name] in (MeasuredChange, "MeasuredChange")
            else (np.array(value) if isinstance(value, list) else value)
            for name, value in reading.items()
        }
        reading = ModeReading(**values)
    faults = tuple(
        Fault(**fault | {"leaves": (leaves := fault["leaves"]) and tuple(leaves)})
        for fault in kept["faults"]
    )
    low, high = kept["band_hz"]
    return Examined(reading, faults, (low, high))
