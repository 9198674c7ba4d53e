"""The files of a test, in the campaign's folder, and its repeats as records."""

import fnmatch
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path

from jbw.campaign.tables import TestSpec
from jbw.errors import ConfigError, DataError, JbwError, did_you_mean
from jbw.measurement.base_motion import beside_base
from jbw.measurement.faults.begins_late import after_its_blow
from jbw.measurement.files.assemble import joined
from jbw.measurement.files.clocks import REGULARITY
from jbw.measurement.files.read import records
from jbw.measurement.files.sampling import Wanted
from jbw.measurement.records import BASE, Record
from jbw.measurement.resampled import on_one_clock
from jbw.memory import Admit, admit_alone
from jbw.quantities import natural

DATA_FOLDER = "$JBW_DATA"
Part = tuple[Path, Wanted]  # a file and the items to read from it


def repeats_of(
    test: TestSpec, folder: Path, *, allow_outside: bool = False, admit: Admit = admit_alone
) -> Iterator[Record | JbwError]:
    """Yield the repeats of a test in SI units, before their samples are checked.

    An unreadable repeat is yielded as its error, in its place, so that the others can still be
    checked. `admit` refuses a record from the size stated in its file, before it is read.
    """
    unused = set(test.exclude)
    number = num_repeats = 0
    fs = float("nan")  # sampling frequency of the first repeat
    try:
        sets = _file_sets(test, folder, allow_outside)
    except JbwError as error:
        yield error
        return
    for parts in sets:
        files = [file.name for file, _ in parts]
        dropped = {x for x in test.exclude if isinstance(x, str) and fnmatch.filter(files, x)}
        unused -= dropped
        # An excluded file is not read, because it may be excluded for being unreadable.
        if dropped:
            number += 1
            continue
        read: Sequence[Record | JbwError]
        try:
            columns = [records(file, selection, admit) for file, selection in parts]
            read = columns[0] if len(columns) == 1 else joined(columns)
        except JbwError as error:
            read = [error]
        for item in read:
            if number in unused:
                unused.remove(number)
            else:
                num_repeats += 1
                if isinstance(item, Record):
                    item = _on_grid(_as_stated(item, test), fs)
                    fs = item.fs if fs != fs else fs
                yield item
            number += 1
    if unused:
        listed = ", ".join(repr(item) for item in sorted(unused, key=str))
        yield ConfigError(
            f"Test {test.name!r}: `exclude` names {listed}, which is not one of its {number} "
            "repeats.",
            remedy="Repeats are counted from zero; file names may contain * and ?.",
        )
    elif not num_repeats:
        yield DataError(
            f"Test {test.name!r} has no repeats left, because `exclude` lists all of them.",
            remedy="Remove the repeats to be fitted from `exclude` of this test.",
        )


def _on_grid(record: Record, fs: float) -> Record:
    """Give a record the sampling rate of another record if both rates differ only by rounding.

    Printed times with different origins have mean rates that differ in the last digit.
    """
    is_one = abs(record.fs - fs) * record.num_samples <= REGULARITY * fs
    return replace(record, fs=fs) if is_one else record


def _as_stated(record: Record, test: TestSpec) -> Record:
    """Apply a record's stated drive and clock; by default a decay starts at its impact."""
    record = on_one_clock(replace(record, drive=test.drive or ""), test.clock_ppm)
    if BASE in record.channels:
        return beside_base(record, is_relative=test.relative_to_base)
    finds_blow = test.traits.is_free and "settle" not in test.model_fields_set
    return after_its_blow(record, test.band) if finds_blow else record


def _file_sets(test: TestSpec, folder: Path, allow_outside: bool) -> list[list[Part]]:
    """Return the files of each repeat; there are several if its channels are in several files."""
    selection = Wanted(**{field.name: getattr(test, field.name) for field in fields(Wanted)})
    if not isinstance(test.files, Mapping):
        files = found_files(test.files, folder, allow_outside)
        return [[(file, selection)] for file in files]
    columns = []
    for patterns in dict.fromkeys(test.files.values()):
        roles = [role for role, role_files in test.files.items() if role_files == patterns]
        of_roles = {
            table: {role: x for role, x in getattr(test, table).items() if role in roles}
            for table in ("channels", "units", "scale", "sensitivity")
        }
        some = replace(selection, **of_roles)
        columns.append([(file, some) for file in found_files(patterns, folder, allow_outside)])
    counts = {len(column) for column in columns}
    if len(counts) > 1:
        listed = ", ".join(f"{column[0][0].name}: {len(column)}" for column in columns)
        raise DataError(
            f"Test {test.name!r} must have equally many files for each role, but has {listed}.",
            remedy="Add the missing files, or remove files without a counterpart: the files of all "
            "roles are paired in natural order.",
        )
    return [list(parts) for parts in zip(*columns, strict=True)]


def found_files(patterns: Iterable[str], folder: Path, allow_outside: bool = False) -> list[Path]:
    """Return the files that match the patterns, each once, in the order of the patterns.

    A pattern is a file name with * and ?, relative to the campaign's folder. $JBW_DATA at its
    beginning stands for the folder in that environment variable.
    """
    files: list[Path] = []
    for written in patterns:
        if re.match(r"[A-Za-z][A-Za-z0-9+.-]*://", written):
            raise ConfigError(
                f"`files` = {written!r} is a URL, but must name files on this computer.",
                remedy="Download the file first and put its path into `files`.",
            )
        pattern = _with_data_folder(written)
        # The pattern is checked before any access, because nothing outside the folder may be
        # touched.
        _stay_inside(folder / pattern, pattern, folder, allow_outside)
        for file in _matching(pattern, folder):
            _stay_inside(file, pattern, folder, allow_outside)
            if file not in files:
                files.append(file)
    return files


def _stay_inside(path: Path, pattern: str, folder: Path, allow_outside: bool) -> None:
    if not allow_outside and not path.resolve().is_relative_to(folder.resolve()):
        raise ConfigError(
            f"`files` = {pattern!r} points outside the campaign's folder `{folder}`.",
            why="A campaign file from elsewhere must not read your other files.",
            remedy="Move the data next to the campaign file, or pass --allow-outside.",
        )


def _with_data_folder(pattern: str) -> str:
    """Return the pattern with $JBW_DATA replaced by this machine's data folder."""
    if not pattern.startswith(DATA_FOLDER):
        return pattern
    folder = os.environ.get(DATA_FOLDER[1:])
    if not folder:
        raise ConfigError(
            f"`files` = {pattern!r} begins with {DATA_FOLDER}, which is not set.",
            remedy=f"Set the environment variable {DATA_FOLDER[1:]} to the folder of your data.",
        )
    return str(Path(folder).absolute()) + pattern[len(DATA_FOLDER) :]


def _matching(pattern: str, folder: Path) -> list[Path]:
    literal = folder / pattern
    if literal.is_file() or not re.search(r"[*?\[]", pattern):
        matches = [literal]
    else:
        anchor = Path(literal.anchor) if Path(pattern).is_absolute() else folder
        matches = anchor.glob(str(literal.relative_to(anchor)))
    if files := sorted(
        (path for path in matches if path.is_file()), key=lambda path: natural(path.name)
    ):
        return files
    names = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    guess = did_you_mean(pattern, names)
    more = f" and {len(names) - 10} more" if len(names) > 10 else ""
    raise DataError(
        f"`files` = {pattern!r} matches nothing in `{folder}`.",
        remedy=f"{guess}Found: {', '.join(names[:10]) or 'nothing'}{more}.",
    )
