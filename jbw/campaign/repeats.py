"""The repeats of a test: its files in order, what is excluded left out, each read into records."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path

from jbw.campaign.finding import found_files
from jbw.campaign.schema import TestSpec
from jbw.errors import ConfigError, DataError, JbwError
from jbw.measurement.files.assembling import joined
from jbw.measurement.files.door import records
from jbw.measurement.files.sampling import Wanted
from jbw.measurement.records import Record

Part = tuple[Path, Wanted]  # a file, and what to take from it


def repeats_of(
    test: TestSpec, name: str, folder: Path, *, allow_outside: bool = False
) -> Iterator[Record | JbwError]:
    """Repeats of a test in SI, without the excluded ones; not yet checked sample by sample.

    What cannot be read comes as the error, in its place, so that the others can still be seen.
    """
    unused = set(test.exclude)
    number = kept = 0
    try:
        sets = _file_sets(test, name, folder, allow_outside)
    except JbwError as error:
        yield error
        return
    for parts in sets:
        dropped = {x for x in test.exclude if isinstance(x, str) and _matches(parts, x)}
        unused -= dropped
        if dropped:  # perhaps because it cannot be read
            number += 1
            continue
        for item in _read(parts):
            if number in unused:
                unused.remove(number)
            else:
                kept += 1
                yield item
            number += 1
    if unused:
        yield _unused(unused, name, number)
    elif not kept:
        yield DataError(f"Test {name!r} has no repeats left.", remedy="Shorten `exclude`.")


def _file_sets(test: TestSpec, name: str, folder: Path, allow_outside: bool) -> list[list[Part]]:
    """The files of each repeat; more than one where roles have files of their own."""
    wanted = Wanted(
        test.channels,
        test.units,
        test.fs,
        test.scale,
        test.repeats,
        test.span,
        test.amplitudes,
        test.remove_mean,
    )
    if not isinstance(test.files, Mapping):
        files = found_files(test.files, folder, allow_outside=allow_outside)
        return [[(file, wanted)] for file in files]
    columns = []
    for patterns in dict.fromkeys(test.files.values()):
        roles = [role for role, own in test.files.items() if own == patterns]
        files = found_files(patterns, folder, allow_outside=allow_outside)
        columns.append([(file, _only(wanted, roles)) for file in files])
    counts = {len(column) for column in columns}
    if len(counts) > 1:
        listed = ", ".join(f"{column[0][0].name}: {len(column)}" for column in columns)
        raise DataError(
            f"Test {name!r} must have equally many files for each role, but has {listed}.",
            remedy="Files are paired in their natural order; name those that belong together.",
        )
    return [list(parts) for parts in zip(*columns, strict=True)]


def _only(wanted: Wanted, roles: Sequence[str]) -> Wanted:
    """What to take from a file that holds some of the roles."""
    channels, units, scale = (
        {role: table[role] for role in roles if role in table}
        for table in (wanted.channels or {}, wanted.units, wanted.scale)
    )
    return replace(wanted, channels=channels, units=units, scale=scale)


def _matches(parts: Sequence[Part], pattern: str) -> bool:
    return any(fnmatch(file.name, pattern) for file, _ in parts)


def _read(parts: Sequence[Part]) -> tuple[Record | JbwError, ...]:
    try:
        read = [records(file, wanted) for file, wanted in parts]
        return read[0] if len(read) == 1 else joined(read)
    except JbwError as error:
        return (error,)


def _unused(unused: set[int | str], name: str, number: int) -> ConfigError:
    listed = ", ".join(repr(item) for item in sorted(unused, key=str))
    return ConfigError(
        f"Test {name!r}: `exclude` names {listed}, which is none of its {number} repeats.",
        remedy="Repeats are counted from zero; file names may hold * and ?.",
    )
