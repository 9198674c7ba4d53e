r"""The effect of an attached shaker on a structure that is driven in several ways.

The attachment is determined from a test with measured voltage, force and drive point. Of several,
the test with the least voltage is used: omega_n and zeta of a fit are those of weak motion. The
predicted change has a standard deviation of 30 % of itself; 60 % where the drive point is also the
response that is fitted.
"""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from jbw.errors import ConfigError, JbwError
from jbw.identification.shaker import ShakerReading, read_shaker, tells_shaker
from jbw.measurement.channels import rms
from jbw.measurement.records import BASE, BY_UNIT, Record, Test, drive_of, run_of
from jbw.observables.attachment import Foretold, label_of, mode_words
from jbw.observables.dataset import Dataset
from jbw.observables.drives import attached, named
from jbw.observables.observable import Observable
from jbw.quantities import FED
from jbw.report.messages import instruments as messages

Own = Float[np.ndarray, " own"]
# relative standard deviation of the predicted effect of a shaker: usually, and if the shaker's
# drive point is also the fitted response
SHARE, SHARE_OF_RESPONSE = 0.3, 0.6
# smallest relative standard deviation of the predicted omega_n and zeta
LEAST_OMEGA, LEAST_ZETA = 2e-4, 0.02
MOST_MODES = (1, 2, 3)  # numbers of modes that are tried in this order for the fit in a band
# If the ratio of armature mass to modal mass exceeds this, the change of the joint's share of the
# stiffness matters.
HEAVY = 0.03


def require_one_unit(tests: Iterable[Test]) -> None:
    """Raise a ConfigError if sources of one drive, which share one gain, have different units."""
    first_units: dict[str, tuple[str, str]] = {}
    for test in tests:
        drive = drive_of(test)
        if drive in ("", "none") or test.traits.is_free:
            continue
        record = test.records[0]
        unit = record.units.get(record.source, "")
        first, name = first_units.setdefault(drive, (unit, test.name))
        if unit != first:
            raise ConfigError(
                f"Tests driven by {drive} must have their source in one unit, but `{name}` has it "
                f"in {first} and `{test.name}` in {unit}.",
                why="Tests with the same drive share one gain.",
                remedy="State `drive` in the test with another drive, or convert both tests to one "
                "unit by `scale` and `units`.",
            )


def foretold(tests: Sequence[Test], parts: Sequence[Observable]) -> list[Observable]:
    """Predict for each drive how its shaker changes omega_n and zeta; warn if this fails.

    This needs tests of the structure without a shaker's feed as input as well: they determine its
    own omega_n and zeta.
    """
    predictions: list[Observable] = []
    for drive in attached(parts):
        others = {part.drive for part in parts} - {"", BASE, *FED}
        readable = [test for test in tests if tells_shaker(test) and _feeds(test, drive)]
        if not readable or not others:
            continue
        test = min(
            readable, key=lambda readable_test: rms(readable_test.records[0].channels["input"])
        )
        if (reading := _read(test)) is None:
            continue
        share = SHARE_OF_RESPONSE if _is_response(test.records[0]) else SHARE
        runs = [run for part in parts for run in part.groups.runs]
        run = run_of(test) if run_of(test) in runs else runs[0]
        mode = _nearest(reading, parts)
        mean, std = _change(reading, mode, share)
        words = _sentence(test, reading, mode, share)
        predictions.append(Foretold.of(mean, std, drive, run, words, laws=parts[0].laws))
    return predictions


def _read(test: Test) -> ShakerReading | None:
    """Identify the shaker with as few modes in the band as possible; warn if this fails."""
    reason = ""
    for modes in MOST_MODES:
        try:
            return read_shaker(test, modes)
        except JbwError as error:
            reason = reason or " ".join(str(error).split())
    warnings.warn(f"The shaker could not be identified. {reason}", stacklevel=3)
    return None


def _feeds(test: Test, drive: str) -> bool:
    """Return whether a drive is the voltage or the current of a test's shaker."""
    return BY_UNIT.get(test.records[0].units.get("input", ""), drive) == drive


def _is_response(record: Record) -> bool:
    """Return whether the drive point and the measured response are the same channel."""
    response = record.channels[record.response]
    return record.response == "acceleration" and bool(
        np.array_equal(response, record.channels["drive_point"])
    )


def _nearest(reading: ShakerReading, parts: Sequence[Observable]) -> int:
    """Return the index of the shaker's fitted mode that is nearest to the joint's mode."""
    frequencies = (part.shown().first_values().get("omega_n") for part in parts)
    omega = next(filter(None, frequencies), reading.modes.omega[0])
    return int(np.argmin(np.abs(reading.modes.omega - omega)))


def _change(reading: ShakerReading, mode: int, share: float) -> tuple[Own, Own]:
    """Return the predicted change of a mode's omega_n and zeta by a shaker, with its sd."""
    omega, zeta = reading.modes.omega[mode], reading.modes.zeta[mode]
    mean = np.array([reading.omega[mode] - omega, reading.zeta[mode] - zeta])
    least = np.array([LEAST_OMEGA * omega, LEAST_ZETA * zeta])
    return mean, np.maximum(share * np.abs(mean), least)


def _sentence(test: Test, reading: ShakerReading, mode: int, share: float) -> str:
    """Return the sentence on the predicted effect of a shaker: its accuracy and added mass."""
    added = reading.shaker.mass * reading.modes.residues[mode, 0]
    sentence = messages.attachment(test.name, share, added, at_drive_point=share > SHARE)
    return f"{sentence} {messages.heavy(HEAVY)}" if abs(added) > HEAVY else sentence


def drive_sentences(theta: Mapping[str, Any], data: Dataset) -> list[str]:
    """Return sentences that state which omega_n and zeta include the shaker's mass and damping."""
    drives = {part.drive for part in data.parts if part.drive}
    if len(drives) == 1 and drives <= set(FED):
        return [messages.with_shaker(drives.pop())]
    everything = {**data.held, **theta}
    sentences = []
    for drive in attached(data.parts):
        if label_of(drive) in data.labels or drive not in FED:
            continue
        omega, zeta = (float(everything[named(name, drive)]) for name in ("omega_n", "zeta"))
        unloaded = mode_words(float(everything["omega_n"]), float(everything["zeta"]))
        sentences.append(messages.mode_with_shaker(drive, mode_words(omega, zeta), unloaded))
    return sentences
