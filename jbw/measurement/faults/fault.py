"""Faults of records, each with finding, reason and remedy, and the merging of similar faults."""

import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial

from jbw.measurement.spans import of_all

LEAVES_OUT = re.compile(r"`(?:span|exclude) = \[")
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


@dataclass(frozen=True)
class Fault:
    """One error or warning about one channel of a record."""

    severity: str  # `error` if the record cannot be used, `warning` if it is doubtful
    channel: str  # role of the channel that has the fault
    what: str  # the finding, with numbers
    why: str = ""  # the reason why the finding matters
    remedy: str = ""  # the instruction that corrects the fault
    # Frequency [Hz] and damping ratio after the remedy; None where they cannot be determined.
    leaves: tuple[float, float] | None = None
    # Whether so many samples are wrong that no other fault can be searched in the record.
    excludes_others: bool = False


refusal, doubt = partial(Fault, "error"), partial(Fault, "warning")


def gathered(named_faults: Iterable[tuple[str, Fault]], count: int) -> list[Fault]:
    """Merge the faults of `count` records: warnings that differ only in their numbers become one.

    A merged fault says how many records it concerns and the range of its numbers.
    """
    by_pattern: dict[tuple[str, ...], list[tuple[str, Fault]]] = {}
    for name, fault in named_faults:
        # Errors without a remedy for the whole test need a separate remedy for each record.
        of_test = "Put under [[test]]" in fault.remedy or LEAVES_OUT.search(fault.remedy)
        record_name = name if fault.severity == "error" and not of_test else ""
        key = fault.severity, fault.channel, NUMBER.sub("#", fault.what), record_name
        by_pattern.setdefault(key, []).append((name, fault))
    return [_together(pattern_faults, count) for pattern_faults in by_pattern.values()]


@contextmanager
def told_together(test: str, count: int) -> Iterator[None]:
    """Merge the warnings that several records of a test raise inside the `with` block."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    doubts = [("", doubt("", str(warning.message))) for warning in caught]
    for fault in gathered(doubts, count):
        warnings.warn(f"Test {test}: {fault.what}", stacklevel=4)


def _together(faults: Sequence[tuple[str, Fault]], count: int) -> Fault:
    (name, first), *others = faults
    # If all records can use the same key, use the value that suits every record.
    remedies = [fault.remedy for _, fault in faults]
    leaves_out = LEAVES_OUT.search(first.remedy)
    remedy = of_all(remedies, count) if leaves_out else max(remedies, key=_numbers)
    if not others:
        return replace(first, what=f"{name}: {first.what}" if name else first.what, remedy=remedy)
    columns = zip(*(NUMBER.findall(fault.what) for _, fault in faults), strict=True)
    reach = iter([_reach(column) for column in columns])
    first_with_reach = NUMBER.sub(lambda _: next(reach), first.what)
    what = f"{min(len(faults), count)} of {count} records: {first_with_reach}"
    return replace(first, what=what, remedy=remedy)


def _numbers(text: str) -> list[float]:
    return [float(number) for number in NUMBER.findall(text)]


def _reach(numbers: Sequence[str]) -> str:
    """Return the range of numbers as text, such as `2 to 5`, each in its original notation."""
    least, most = min(numbers, key=float), max(numbers, key=float)
    return least if float(least) == float(most) else f"{least} to {most}"


def worst(faults: Iterable[Fault]) -> str:
    """Return the worst severity among faults: `error`, `warning`, or `ok` if there are none."""
    return min((fault.severity for fault in faults), default="ok")
