"""A campaign looked at channel by channel, without stopping at the first fault."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from jbw.campaign.agree import findings, unread
from jbw.campaign.files import repeats_of
from jbw.campaign.load import force_per_unit, test_names
from jbw.campaign.schema import TestSpec, read_spec
from jbw.errors import ConfigError, DataError, JbwError
from jbw.measurement.checks import Fault, worst
from jbw.measurement.records import Record


@dataclass(frozen=True)
class Row:
    """One channel of one test, or one setting.

    Attributes:
        test: The test's name; "[identify]" of a setting.
        channel: The channel's name or path in the file, or the setting's key.
        role: What it is.
        unit: Its unit in the file, as the campaign says.
        fs: Sampling frequency [Hz]; None when unknown or not a time record.
        repeats: Repeats that could be read.
        status: ok, warning or error.
        findings: What was found in it, over all repeats.
    """

    test: str
    channel: str
    role: str
    unit: str
    fs: float | None
    repeats: int
    status: str
    findings: tuple[Fault, ...]


@dataclass(frozen=True)
class Check:
    """A whole campaign, checked.

    Attributes:
        campaign: Its name.
        rows: Its channels.
        exit_code: 0 when usable, 2 when the campaign file must change, 3 when the data must.
    """

    campaign: str
    rows: tuple[Row, ...]
    exit_code: int

    @property
    def status(self) -> str:
        """The worst status of all channels."""
        return worst(finding for row in self.rows for finding in row.findings)


def check_campaign(path: str | Path, *, allow_outside: bool = False) -> Check:
    """Look at every channel of every repeat of a campaign.

    Args:
        path: The campaign file.
        allow_outside: Let `files` point out of the campaign file's folder.

    Raises:
        ConfigError: The campaign file itself is against the schema.
    """
    path = Path(path)
    spec = read_spec(path)
    folder = path.resolve().parent
    rows = [
        Row("[identify]", fault.channel, "", "", None, 0, fault.severity, (fault,))
        for fault in unread(spec)
    ]
    codes = {0}
    for test, name in zip(spec.tests, test_names(spec), strict=True):
        seen = _looked_at(test, name, folder, allow_outside, force_per_unit(spec))
        rows += seen.rows(test, name)
        codes |= seen.codes()
    return Check(spec.name, tuple(rows), min(codes - {0}, default=0))


def as_json(check: Check) -> dict[str, Any]:
    """The check as plain values, for scripts."""
    channels = [asdict(row) for row in check.rows]
    return {"campaign": check.campaign, "status": check.status, "channels": channels}


@dataclass(frozen=True)
class _Seen:
    """What is left of a test once its records have been looked at, one at a time."""

    findings: Sequence[Fault]
    failures: Sequence[JbwError]
    fs: float | None
    repeats: int

    def codes(self) -> set[int]:
        found = {failure.exit_code for failure in self.failures}
        return found | ({DataError.exit_code} if worst(self.findings) == "error" else set())

    def rows(self, test: TestSpec, name: str) -> list[Row]:
        rows = []
        failed = tuple(
            Fault("error", "", failure.what, failure.why, failure.remedy)
            for failure in self.failures
        )
        for role, channel in test.channels.items():
            found = tuple(finding for finding in self.findings if finding.channel == role)
            found += () if rows else failed  # once a test, in its first channel's row
            found = tuple(sorted(found, key=lambda finding: finding.severity))
            unit = test.units.get(role, "")
            rows.append(Row(name, channel, role, unit, self.fs, self.repeats, worst(found), found))
        return rows


def _looked_at(
    test: TestSpec, name: str, folder: Path, allow_outside: bool, per_unit: float | None
) -> _Seen:
    placed: list[Fault] = []
    failures: list[JbwError] = []
    first: list[Record] = []
    repeats = 0
    for item in repeats_of(test, name, folder, allow_outside=allow_outside):
        if isinstance(item, ConfigError | DataError):
            if item.args not in [failure.args for failure in failures]:
                failures.append(item)
            continue
        if isinstance(item, JbwError):
            raise item
        repeats += 1
        found = findings(item, test, first, per_unit=per_unit)
        placed += [_placed(finding, item.name) for finding in found]
        first = first or [_without_samples(item)]
    fs = first[0].fs if first and first[0].fs == first[0].fs else None
    return _Seen(placed, failures, fs, repeats)


def _placed(finding: Fault, record: str) -> Fault:
    what = f"{record}: {finding.what}"
    return Fault(finding.severity, finding.channel, what, finding.why, finding.remedy)


def _without_samples(record: Record) -> Record:
    """The record's head, so that a huge campaign is never held in memory."""
    empty = {role: samples[:0].copy() for role, samples in record.channels.items()}
    return Record(record.fs, empty, record.units, record.name)
