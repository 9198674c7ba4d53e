"""The monitoring of a joint: records are read one after another and each is tested for a change.

The log is `watch.jsonl`, with one line per record, appended completely; a line cut by a crash is
set aside.
"""

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from jbw.campaign.load import load_test
from jbw.campaign.schema import CampaignSpec, read_spec
from jbw.campaign.tables import TestSpec, force_per_unit
from jbw.errors import ConfigError, DataError, JbwError, RunError
from jbw.measurement.kinds import KINDS
from jbw.measurement.records import Record, Test
from jbw.report.messages import watch as messages
from jbw.results.watch import WatchLine, WatchSettings
from jbw.run.folder import lock
from jbw.study.study import campaign_of
from jbw.watch.readings import PER_AMPLITUDE, common_amplitude, names_of, reading
from jbw.watch.statement import Trend, as_plain, sentence, state

FORMAT = 1
FALSE_ALARMS = 1e-3  # default rate of false alarms
# The number of reference records must exceed the number of values per record by at least this.
SPARE = 2
FEW = 20  # If there are fewer reference records than this, one amplitude is better than two.
Say = Callable[[str], None]
# A function that returns the trend of frequency and damping from the torque before any change [N m]
# (or None), the amplitudes and the test.
TrendAt = Callable[[float | None, Sequence[float], Test], Trend]
LOG_NAME = "watch.jsonl"
TORN = "watch.torn"  # name of the file next to the log that receives lines cut off by a crash


@dataclass(frozen=True)
class Wishes:
    """The requested settings for monitoring; None stands for the present setting or the default."""

    amplitudes: tuple[float, ...] | None = None  # peak amplitudes in the unit of the response
    false_alarms: float | None = None  # rate of false alarms per record
    num_reference: int | None = None  # number of records without change
    test: str | None = None  # name of the test whose kind and settings the records share


def watch(
    folder: Path, files: Sequence[Path], wishes: Wishes, *, campaign: Path | None = None,
    trend_at: TrendAt | None = None, say: Say = print,
) -> tuple[WatchSettings, list[WatchLine], list[WatchLine]]:  # fmt: skip
    """Read records, state for each whether the joint has changed, and append both to the log.

    The records of the run's own campaign come first, as references.

    Args:
        folder: Folder of a finished run.
        files: Files of records to add, in the order of measurement.
        wishes: Settings of the watch, on the first call.
        campaign: The run's campaign file, if it was moved.
        trend_at: A function such as `trend_of` with a fleet, which returns the trend of readings
            with torque; with it a change is also stated as a change of torque.
        say: A function that is called with one sentence about anything unusual.

    Returns:
        Settings, the lines of all records with frequency and damping, and the lines of `files`.

    Raises:
        ConfigError: The settings differ from those at the beginning of the watch, or are invalid.
        DataError: The run has no free decays, or too few comparable records.
    """
    with locked_log(folder) as path:
        torn = set_aside(path)
        if torn is not None:
            say(f"warning: {torn}")
        entries = read_log(path)
        source = campaign_of(folder, campaign)
        spec = read_spec(source)
        began = [entry for entry in entries if entry["kind"] == "settings"]
        settings = WatchSettings.read(began[0]) if began else None
        lines = [WatchLine.read(entry) for entry in entries if entry["kind"] != "settings"]
        table = _decay_test(spec, wishes.test if settings is None else settings.test)
        place = source.resolve().parent
        campaign_test = load_test(table, place, per_unit=force_per_unit(spec), allow_outside=True)
        if settings is None:
            settings = _begun(campaign_test, table.name, wishes)
        else:
            _require_same(settings, wishes)
        torque, amplitudes = spec.assembly.torque, settings.amplitudes
        trend = None if trend_at is None else trend_at(torque, amplitudes, campaign_test)
        if not began:
            append(path, settings.plain())
        keeper = _Keeper(path, settings, campaign_test, say, lines, trend)
        identities = {line.id for line in lines}
        for identity, record in _identified(campaign_test.records):
            # On the first call, or after a crash during that call, all records are new.
            if identity not in identities:
                keeper.take(identity, record)
        added: list[WatchLine] = []
        for file in files:
            added += _of_file(file, table, spec, place, keeper)
        return settings, keeper.readings, added


class _Keeper:
    """The log of a monitored joint, to which records are appended one after another."""

    def __init__(
        self, path: Path, settings: WatchSettings, test: Test, say: Say, lines: list[WatchLine],
        trend: Trend | None,
    ) -> None:  # fmt: skip
        self.path, self.settings, self.test, self.say = path, settings, test, say
        self.lines, self.trend = lines, trend

    @property
    def readings(self) -> list[WatchLine]:
        """The records with frequency and damping."""
        return [line for line in self.lines if line.entry == "reading"]

    def take(self, identity: str, record: Record) -> WatchLine:
        """Read a record; append to the log its statement, or the reason why it is rejected."""
        try:
            measured = reading(record, self.test, self.settings.amplitudes)
        except DataError as error:
            return self.refuse(identity, record.name, error)
        number, num_reference = len(self.readings) + 1, self.settings.reference
        line = WatchLine(
            kind="reading", number=number, record=record.name, id=identity, when=_now(),
            role="reference" if number <= num_reference else "watched",
            values=measured.values.tolist(), covariance=measured.covariance.tolist(),
            other_modes=measured.other_modes,
        )  # fmt: skip
        if number > num_reference:
            line = line.replaced(**self._statement([*self.readings, line]))
        return self._append(line)

    def refuse(self, identity: str, name: str, error: JbwError) -> WatchLine:
        """Append to the log why a record is rejected, and print a warning."""
        reason = " ".join(str(error).split())
        self.say(f"warning: refused: {reason}")
        return self._append(
            WatchLine(kind="refused", record=name, id=identity, when=_now(), reason=reason)
        )

    def _append(self, line: WatchLine) -> WatchLine:
        append(self.path, line.plain())
        self.lines.append(line)
        return line

    def _statement(self, readings: Sequence[WatchLine]) -> dict[str, Any]:
        """Return the fields of a line that state whether the joint has changed."""
        num_reference = self.settings.reference
        values = np.array([line.values for line in readings])
        noise_covariance = np.array([line.covariance for line in readings])
        statement = state(
            values[:num_reference], values[num_reference:], self.settings.false_alarms,
            noise_covariance=noise_covariance[-1],
            reference_noise=noise_covariance[:num_reference].mean(axis=0), trend=self.trend,
        )  # fmt: skip
        names = [line.record for line in readings[num_reference:]]
        return {**as_plain(statement), "statement": sentence(statement, names, num_reference)}


def _of_file(
    file: Path, table: TestSpec, spec: CampaignSpec, place: Path, keeper: _Keeper
) -> list[WatchLine]:
    """Read the records of a file and log each; return the log entries."""
    file_spec = table.model_copy(update={"files": (str(file.absolute()),), "exclude": ()})
    try:
        test = load_test(file_spec, place, per_unit=force_per_unit(spec), allow_outside=True)
    except JbwError as error:
        return [keeper.refuse(str(file), file.name, error)]
    lines = []
    for identity, record in _identified(test.records):
        before = [line for line in keeper.readings if line.id == identity]
        if before:
            reason = messages.known_already(record.name, before[0].number or 0)
            keeper.say(f"warning: {reason}")
            lines.append(WatchLine(kind="known", record=record.name, reason=reason))
        else:
            lines.append(keeper.take(identity, record))
    return lines


def _identified(records: Sequence[Record]) -> list[tuple[str, Record]]:
    """Return each record with an identity: the hash of its file and its position in that file."""
    count: dict[str, int] = {}
    identified = []
    for record in records:
        digest = record.provenance.get("sha256", record.name)
        count[digest] = count.get(digest, -1) + 1
        identified.append((f"{digest}#{count[digest]}", record))
    return identified


def _decay_test(spec: CampaignSpec, name: str | None) -> TestSpec:
    """Return the campaign's test of free decays: the one with the given name, or the only one."""
    decays = {test.name: test for test in spec.tests if KINDS[test.kind].is_free}
    if name is not None and name not in decays:
        raise ConfigError(
            f"`--test` must name a test of free decays, but is {name!r}.",
            remedy=f"The tests of free decays in the campaign are: {', '.join(decays) or 'none'}.",
        )
    if not decays:
        raise DataError(
            "The run's campaign has no free decays.",
            why="Frequency and damping are measured at fixed amplitudes along a decay.",
            remedy="Hit the structure with a hammer and identify the records as a test of kind "
            "`decay`.",
        )
    if name is None and len(decays) > 1:
        raise ConfigError(
            f"The run's campaign has {len(decays)} tests of free decays.",
            remedy=f"Choose with --test: {', '.join(decays)}.",
        )
    chosen = decays[name or next(iter(decays))]
    if not isinstance(chosen.files, tuple):
        raise ConfigError(
            f"Test `{chosen.name}` has one file per channel, which `jbw watch` cannot read.",
            remedy="Put the channels of a record into one file.",
        )
    return chosen


def _begun(test: Test, name: str, wishes: Wishes) -> WatchSettings:
    """Return the settings of a new log; unstated ones are chosen from the campaign's records."""
    false_alarms = FALSE_ALARMS if wishes.false_alarms is None else wishes.false_alarms
    if not 0 < false_alarms < 0.5:
        raise ConfigError(
            f"`--false-alarms` must lie between 0 and 0.5, but is {false_alarms:g}.",
            remedy="Give the rate of false alarms per record, such as 1e-3.",
        )
    amplitudes = wishes.amplitudes or (common_amplitude(test),)
    if not all(0 < amplitude < np.inf for amplitude in amplitudes) or len(set(amplitudes)) < len(
        amplitudes
    ):
        raise ConfigError(
            "`--amplitude` must be different positive numbers, but is "
            f"{','.join(f'{amplitude:g}' for amplitude in amplitudes)}.",
            remedy="Give peak amplitudes of the response, in its SI unit.",
        )
    least = PER_AMPLITUDE * len(amplitudes) + SPARE
    number = wishes.num_reference or max(_comparable(test, amplitudes), least)
    if number < least:
        raise ConfigError(
            f"`--reference` must be at least {least} for {len(amplitudes)} amplitudes, but is "
            f"{number}.",
            why=f"From fewer than {least} records the variation between records cannot be "
            "estimated well enough, and no change would be detected.",
            remedy=f"Use `--reference {least}` or more, with as many records of the unchanged "
            "joint, or use only one amplitude.",
        )
    unit = test.records[0].units.get(test.records[0].response, "")
    return WatchSettings(
        kind="settings", format=FORMAT, when=_now(), test=name, amplitudes=list(amplitudes),
        unit=unit, false_alarms=false_alarms, reference=number, names=names_of(amplitudes, unit),
    )  # fmt: skip


def _comparable(test: Test, amplitudes: Sequence[float]) -> int:
    """Count the campaign's records that have frequency and damping at all amplitudes."""
    count = 0
    for record in test.records:
        try:
            reading(record, replace(test, records=(record,)), amplitudes)
            count += 1
        except DataError:
            continue
    return count


def _require_same(settings: WatchSettings, wishes: Wishes) -> None:
    """Raise an error if requested settings differ from those with which the log began."""
    began = {
        "--amplitude": (wishes.amplitudes, tuple(settings.amplitudes)),
        "--false-alarms": (wishes.false_alarms, settings.false_alarms),
        "--reference": (wishes.num_reference, settings.reference),
        "--test": (wishes.test, settings.test),
    }
    for option, (wished, has) in began.items():
        if wished is not None and wished != has:
            raise ConfigError(
                f"`{option}` is {wished}, but the watch began with {has}.",
                why=f"With another `{option}`, the new values of the watch would not be comparable "
                "with the earlier values.",
                remedy=f"Leave `{option}` out, or move watch.jsonl away and begin a new watch.",
            )


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


@contextmanager
def locked_log(folder: Path) -> Iterator[Path]:
    """Lock the log in a run's folder, so that no other process writes to it, and yield its path."""
    path = folder / LOG_NAME
    try:
        held = lock(folder / f".{LOG_NAME}.lock", folder)
    except OSError as error:
        raise _unwritable(path, error) from error
    try:
        yield path
    finally:
        held.release()


def read_log(path: Path) -> list[dict[str, Any]]:
    """Return all entries of a monitoring log, oldest first; an empty list if there is no log.

    Raises:
        RunError: A line is no valid entry (`set_aside` removes an incomplete last line before).
    """
    if not path.exists():
        return []
    entries = []
    lines = path.read_bytes().split(b"\n")
    for number, line in enumerate(lines[:-1], start=1):
        try:
            entry = json.loads(line)
            kind = entry["kind"]
        except (ValueError, KeyError, TypeError, RecursionError):
            kind = None
        if not isinstance(kind, str):
            raise RunError(
                f"Line {number} of {path} is not valid in the log of a watch.",
                why="Every line of the log affects what the watch states about later records.",
                remedy="Restore the log from a copy, or move the log away and begin a new watch.",
            )
        entries.append(entry)
    return entries


def set_aside(path: Path) -> str | None:
    """Move an incomplete last line of a log to `watch.torn`; return a warning, or None."""
    content = path.read_bytes() if path.exists() else b""
    complete, mark, torn = content.rpartition(b"\n")
    if not torn:
        return None
    torn_path = path.with_name(TORN)
    try:
        _append_bytes(
            torn_path,
            torn + b"\n",
            # The line is saved before it is removed. After a crash in between, it therefore exists
            # twice.
        )
        with path.open("rb+") as stream:
            stream.truncate(len(complete) + len(mark))
            os.fsync(stream.fileno())
    except OSError as error:
        raise _unwritable(path, error) from error
    return messages.torn_line(str(path), len(torn), str(torn_path))


def append(path: Path, entry: Mapping[str, Any]) -> None:
    """Append an entry to a log by one write, which is on the disk when this function returns."""
    line = json.dumps(entry, ensure_ascii=False, allow_nan=False) + "\n"
    try:
        _append_bytes(path, line.encode())
    except OSError as error:
        raise _unwritable(path, error) from error


def _append_bytes(path: Path, content: bytes) -> None:
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    try:
        written = os.write(handle, content)
        # The disk is full; the next call moves the incomplete line away.
        if written < len(content):
            raise OSError(f"only {written} of {len(content)} bytes were written")
        os.fsync(handle)
    finally:
        os.close(handle)


def _unwritable(path: Path, error: OSError) -> RunError:
    return RunError(
        f"{path} cannot be written: {error.strerror or error}.",
        why="All records that were added before are complete in the log.",
        remedy="Free some space, or make the folder writable, and add the record again.",
    )
