"""Trials of remedies before they are proposed: each line is applied to a copy of the record.

A line is printed if its fault is gone, the mode equals the one that was fitted together with the
cause, and no new fault appears, except for a doubt that its own line remedies, since a record may
have two faults. Lines of keys that do not change a record in memory (units, laws, levels) are
printed untried.
"""

import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from pydantic import ValidationError

from jbw.campaign.tables import TestSpec
from jbw.errors import JbwError
from jbw.measurement.faults.examine import Examined
from jbw.measurement.faults.fault import NUMBER, Fault
from jbw.measurement.files.assemble import unwindowed
from jbw.measurement.records import RESPONSES, Record
from jbw.measurement.resampled import on_one_clock
from jbw.measurement.spans import SPAN, span_words, start_of
from jbw.measurement.steady_lines import without_lines
from jbw.report.messages import remedies

LINE = re.compile(r"`((\w+) = [^`]+)`(?:\sand\s`([^`]+)`)?")
# Keys that only affect the examination and leave the samples unchanged.
STATED = {"settle", "band", "delay", "load_cell", "periods"}
OR = ", or "  # text that separates the alternatives of a remedy
# Two modes are equal if their relative difference in damping, and their difference in frequency
# divided by the half-power width, are below this. Correct remedies of simulated faults give less
# than 0.13, wrong remedies 0.18 or more.
ALIKE = 0.15

Look = Callable[[Record, TestSpec], Sequence[Fault]]
Read = Callable[[Record, TestSpec], Examined | None]
Change = Callable[[Record, Any], Record]


def tried(
    faults: Sequence[Fault],
    stated: Sequence[Fault],
    record: Record,
    test: TestSpec,
    look: Look,
    read: Read,
) -> tuple[Fault, ...]:
    """Return the findings on a record, with only those remedies that were shown to work.

    Args:
        faults: Faults whose remedies are tried.
        stated: Other faults that `look` finds in the record.
        record: The record.
        test: Table of its test.
        look: Function that returns the faults of a record under a table.
        read: Function that examines the record's mode; None for kinds without such an examination.
    """
    known = {_kind(fault) for fault in (*stated, *faults)}

    def is_offered(fault: Fault, part: str) -> bool:
        one = replace(fault, remedy=part)
        return LINE.search(part) is None or _cures(one, known, record, test, look, read)

    return tuple(
        replace(fault, remedy=_of_parts([part for part in parts if is_offered(fault, part)], parts))
        for fault in faults
        for parts in [fault.remedy.split(OR)]
    )


def _kind(fault: Fault) -> tuple[str, str]:
    return fault.channel, NUMBER.sub("#", fault.what)


def _cures(
    fault: Fault,
    known: set[tuple[str, str]],
    record: Record,
    test: TestSpec,
    look: Look,
    read: Read,
    *,
    further: bool = True,
) -> bool:
    """Return whether the first line of a remedy removes a finding without causing another finding.

    With `further`, a new fault is accepted if its own line cures it.
    """
    line = LINE.search(fault.remedy)
    if line is None or (line[2] not in STATED and line[2] not in CHANGES):
        return line is not None
    values = tomllib.loads("\n".join(filter(None, line.group(1, 3))))
    try:
        for key, value in values.items():
            if key in STATED:
                test = test.model_copy(update={key: tuple(value) if key == "band" else value})
            else:
                record = CHANGES[key](record, value)
        left = look(record, test)
        if (examined := read(record, test)) is not None and not _leaves(examined, line[2], fault):
            return False
    except (JbwError, ValueError, ValidationError):
        return False
    if _kind(fault) in {_kind(one) for one in left}:
        return False
    new = [one for one in left if _kind(one) not in known]
    known = known | {_kind(one) for one in left}
    return all(
        further
        and one.severity == "warning"
        and _cures(one, known, record, test, look, read, further=False)
        for one in new
    )


def _leaves(examined: Examined, key: str, fault: Fault) -> bool:
    """Return whether a corrected record still has the mode that was fitted together with the fault.

    A part of a record (`span`) has other amplitudes, at which a joint has another mode; any single
    mode is accepted then, as it is if no mode could be fitted before.
    """
    reading = examined.reading
    if fault.leaves is None and key != "span":
        return True
    if reading is None or not reading.holds:
        return False
    if fault.leaves is None or key == "span":
        return True
    hz, zeta = fault.leaves
    of_hz = abs(reading.linear_hz.value / hz - 1) / zeta
    return max(of_hz, abs(reading.linear_zeta.value / zeta - 1)) < ALIKE


def _of_parts(kept: Sequence[str], parts: Sequence[str]) -> str:
    """Return a remedy with only those alternatives that work; unchanged if all of them do."""
    if not kept:
        return remedies.NO_LINE
    remedy = OR.join(kept).removesuffix(".") + "." * parts[-1].endswith(".")
    if kept[0] == parts[0]:
        return remedy
    excludes = remedies.EXCLUDE.search(kept[0])
    if excludes:
        return f"{remedies.PUT} `exclude = {excludes[1]}`."
    return remedy[0].upper() + remedy[1:]


def _cut(record: Record, span: Sequence[float]) -> Record:
    begins = start_of(record)
    first, last = (max(round((end - begins) * record.fs), 0) for end in span)
    channels = {role: x[first:last] for role, x in record.channels.items()}
    place = {SPAN: span_words((span[0], span[1]))}
    return replace(record, channels=channels, provenance={**record.provenance, **place})


def _of_responses(record: Record, change: Callable[[Any], Any]) -> Record:
    channels = {role: change(x) if role in RESPONSES else x for role, x in record.channels.items()}
    return replace(record, channels=channels)


def _without_window(record: Record, tau_s: float) -> Record:
    first = round(start_of(record) * record.fs)
    return _of_responses(record, lambda x: unwindowed(x, tau_s * record.fs, first))


def _scaled(record: Record, factors: Mapping[str, float]) -> Record:
    channels = {role: factors.get(role, 1.0) * x for role, x in record.channels.items()}
    return replace(record, channels=channels)


# the change of a record that each key of a campaign file causes
CHANGES: Mapping[str, Change] = {
    "span": _cut,
    "window_s": _without_window,
    "lines_hz": lambda record, hz: _of_responses(
        record, lambda x: without_lines(x, record.fs, hz)[0]
    ),
    "clock_ppm": on_one_clock,
    "scale": _scaled,
    "remove_mean": lambda record, _: _of_responses(record, lambda x: x - x.mean()),
}
