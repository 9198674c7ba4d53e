"""The one door for measurement files: read, convert to SI, check, and say what was done."""

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

from jbw.errors import ConfigError, DataError, JbwError
from jbw.measurement.checks import Fault, inspect
from jbw.measurement.files.assemble import records_of
from jbw.measurement.files.detect import opened, sha256
from jbw.measurement.files.paths import closest
from jbw.measurement.files.sampling import Wanted
from jbw.measurement.files.tree import Leaf, names
from jbw.measurement.records import Record
from jbw.measurement.roles import QUANTITIES, ROLES


def read(
    path: str | Path,
    channels: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    *,
    fs: float | str | None = None,
    scale: Mapping[str, float] | None = None,
    repeats: str = "files",
    span: tuple[float, float] | None = None,
    exclude: Sequence[int] = (),
) -> tuple[Record, ...]:
    """Records of one measurement file, in SI and checked.

    Args:
        path: The file: .mat (any version), .h5, .npz, .csv and other text, .wav, .uff, .tdms.
        channels: Role to the channel's path in the file, such as
            {"force": "FRdata.ResponseControl[3].force"}; brackets count from zero, parentheses and
            braces from one as in MATLAB, and `[:]` over cells gives a repeat an item. `a - b` is
            the difference of two channels. The role `time` gives the sampling frequency. When None,
            the channels whose names are roles.
        units: Role to unit, such as {"velocity": "mm/s"}; a file that states units needs none.
        fs: Sampling frequency [Hz], or the path of a scalar that holds it; when None, from the
            time channel or the file's attributes.
        scale: Role to factor, applied before the unit: calibration of a WAV file.
        repeats: "files" when the file is one repeat; "rows" when the rows of a 2-D channel are.
        span: First and last second to read, for cutting; only that part is loaded.
        exclude: Repeats to leave out, counted from zero.

    Returns:
        One record a repeat. What is doubtful is given as a warning.

    Raises:
        DataError: Missing file or channel, damaged file, or a channel that fails a check.
        ConfigError: Unknown role or unit, or one that is missing.
    """
    wanted = Wanted(
        channels, units or {}, fs, scale or {}, check_repeats(repeats), check_span(span)
    )
    kept = [r for i, r in enumerate(records(Path(path), wanted)) if i not in exclude]
    for record in kept:
        report(record, inspect(record))
    return tuple(kept)


def records(path: Path, wanted: Wanted) -> tuple[Record, ...]:
    """Records of a file in SI, not yet checked sample by sample.

    Raises:
        DataError: Missing file or channel, damaged file, no sampling frequency.
        ConfigError: Unknown role or unit, or one that is missing.
    """
    for role in [*(wanted.channels or {}), *wanted.units, *wanted.scale]:
        if role not in QUANTITIES:
            nearest = closest(role, ROLES)
            guess = f"Did you mean `{nearest}`? " if nearest else ""
            raise ConfigError(
                f"Role `{role}` is not known.", remedy=f"{guess}Known: {', '.join(ROLES)}."
            )
    try:
        with opened(path) as contents:
            return records_of(contents, path, wanted, sha256(path))
    except JbwError as error:
        if path.name in error.what:
            raise
        # Some of what is refused inside a reader does not know the file's name.
        what = f"{path.name}: {error.what}"
        raise type(error)(what, why=error.why, remedy=error.remedy) from None


def channels_of(path: Path) -> dict[str, Leaf]:
    """Every numeric array of a file: its path, shape, and what the file says of it."""
    with opened(path) as contents:
        return {name: item for name, item in names(contents.root) if isinstance(item, Leaf)}


def report(record: Record, findings: Sequence[Fault]) -> None:
    """Raise the first error among findings, and warn of the rest.

    Raises:
        DataError: A finding is an error.
    """
    for finding in findings:
        what = f"{record.name}, channel `{finding.channel}`: {finding.what}"
        if finding.severity == "error":
            raise DataError(what, why=finding.why, remedy=finding.remedy)
        warnings.warn(" ".join(filter(None, (what, finding.remedy))), stacklevel=3)


def check_repeats(repeats: str) -> str:
    """The argument `repeats`, if it is one of the two words."""
    if repeats not in ("files", "rows"):
        raise ConfigError(f"Argument `repeats` must be 'files' or 'rows', but is {repeats!r}.")
    return repeats


def check_span(span: tuple[float, float] | None) -> tuple[float, float] | None:
    """The argument `span`, if it is a rising pair of times."""
    if span is not None and not (len(span) == 2 and 0 <= span[0] < span[1]):
        raise ConfigError(
            f"Argument `span` must be [first, last] in seconds, rising from 0, but is {span}."
        )
    return span
