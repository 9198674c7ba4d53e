"""The functions that read any measurement file: open, convert to SI, check and report changes.

A reader is a module with `contents(path)`, a context manager that yields the open file as a tree
(`jbw.measurement.files.tree`), and one line in `READERS`; npz.py is the shortest example. If the
file is damaged, a reader may raise any error, preferably `ValueError`; it becomes a DataError here.
"""

import hashlib
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

from jbw.errors import ConfigError, DataError, JbwError, did_you_mean, naming
from jbw.measurement.faults.channels import inspect
from jbw.measurement.faults.fault import Fault
from jbw.measurement.files.assemble import records_of
from jbw.measurement.files.sampling import Wanted
from jbw.measurement.files.tree import Contents
from jbw.measurement.recorders import annotated
from jbw.measurement.records import ROLES, Record
from jbw.memory import Admit, admit_all
from jbw.report.messages.reading import EXPORTS

# the module that reads files of each suffix; it is imported when first needed
READERS: dict[str, str] = {}
PICKLES = (".pkl", ".pickle", ".p", ".joblib", ".pt")


def register(module: str, *suffixes: str) -> None:
    """Register a module, by its dotted name, as the reader of files with given suffixes."""
    READERS.update(dict.fromkeys(suffixes, module))


register("jbw.measurement.files.mat", ".mat")
register("jbw.measurement.files.hdf5", ".h5", ".hdf5", ".hdf", ".nc", ".nc4")
register("jbw.measurement.files.npz", ".npz", ".npy")
register("jbw.measurement.files.csv", ".csv", ".txt", ".tsv", ".dat", ".asc", ".lvm")
register("jbw.measurement.files.wav", ".wav")
register("jbw.measurement.files.uff", ".uff", ".unv")
register("jbw.measurement.files.tdms", ".tdms")
register("jbw.measurement.files.mdf", ".mf4", ".mdf")
register("jbw.measurement.files.seismic", ".mseed", ".sac")


def read(
    path: str | Path,
    channels: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    *,
    fs: float | str | None = None,
    scale: Mapping[str, float] | None = None,
    sensitivity: Mapping[str, str] | None = None,
    repeats: str = "files",
    span: tuple[float, float] | None = None,
    exclude: Sequence[int] = (),
) -> tuple[Record, ...]:
    """Return the records of one measurement file in SI units, after checking them.

    Args:
        path: The file: .mat (any version), .h5, .npz, .csv and other text, .wav, .uff, .tdms, .mf4,
            .mseed, .sac.
        channels: Path in the file of each role's channel, such as
            {"force": "FRdata.ResponseControl[3].force"}. Brackets count from zero, parentheses
            and braces from one as in MATLAB; `[:]` over cells gives one repeat per item. `a - b`
            is the difference of two channels. The role `time` gives the sampling frequency. When
            None, channels named like a role are read.
        units: Unit of each role, such as {"velocity": "mm/s"}; not needed if the file states units.
        fs: Sampling frequency [Hz], or the path of a scalar that contains it; when None, taken
            from the time channel or the attributes of the file.
        scale: Factor of each role, applied before the unit, as for the calibration of a WAV file.
        sensitivity: Sensor sensitivity of each role whose channel is in volts, such as
            {"acceleration": "100 mV/g"}.
        repeats: "files" if the file is one repeat; "rows" if each row of a 2-D channel is one.
        span: First and last second to read; only that part is loaded.
        exclude: Indices of the repeats to leave out, counted from zero.

    Returns:
        One record per repeat. Doubts are issued as warnings.

    Raises:
        DataError: The file or a channel is missing, damaged or fails a check.
        ConfigError: A role or unit is unknown, or a unit is missing.

    Examples:
        A laser in mm/s is read in m/s, with the sampling frequency that the file has:

        >>> import jbw
        >>> import numpy as np
        >>> v = 20.0 * np.cos(118.0 * np.arange(2048) / 512.0)
        >>> np.savez("hit.npz", laser=v, rate=512.0)
        >>> (record,) = jbw.read("hit.npz", {"velocity": "laser"}, {"velocity": "mm/s"}, fs="rate")
        >>> print(record.fs, record.channels["velocity"][0], record.units["velocity"])
        512.0 0.02 m/s
    """
    if repeats not in ("files", "rows"):
        raise ConfigError(f"Argument `repeats` must be 'files' or 'rows', but is {repeats!r}.")
    if span is not None and not (len(span) == 2 and 0 <= span[0] < span[1]):
        raise ConfigError(
            f"Argument `span` must be [first, last] in seconds, rising from 0, but is {span}."
        )
    request = Wanted(
        channels, units or {}, fs, scale or {}, repeats, span, sensitivity=sensitivity or {}
    )
    included = [r for i, r in enumerate(records(Path(path), request)) if i not in exclude]
    for record in included:
        report(record, inspect(record))
    return tuple(included)


def records(path: Path, request: Wanted, admit: Admit = admit_all) -> tuple[Record, ...]:
    """Return a file's records in SI units, without checks of the samples; raise as `read` does."""
    tables = (request.channels or {}, request.units, request.scale, request.sensitivity)
    for role in [role for table in tables for role in table]:
        if role not in ROLES:
            roles_known = f"Known: {', '.join(ROLES)}."
            raise ConfigError(
                f"Role `{role}` is not known.", remedy=did_you_mean(role, ROLES) + roles_known
            )
    with naming(path.name), opened(path) as contents, path.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
        return records_of(contents, path, request, digest, admit)


def report(record: Record, findings: Sequence[Fault]) -> None:
    """Raise the first error among faults as a DataError, and issue the others as warnings."""
    for finding in findings:
        what = f"{record.name}, channel `{finding.channel}`: {finding.what}"
        if finding.severity == "error":
            raise DataError(what, why=finding.why, remedy=finding.remedy)
        warnings.warn(" ".join(filter(None, (what, finding.remedy))), stacklevel=3)


@contextmanager
def opened(path: Path) -> Iterator[Contents]:
    """Open a measurement file with the reader for its suffix; raise a DataError if that fails."""
    module = _reader_of(path)
    try:
        with import_module(module).contents(path) as contents:
            yield annotated(contents)
    except (JbwError, KeyboardInterrupt, MemoryError):
        raise
    except Exception as error:  # A damaged file may raise any error inside a reader.
        reason = str(error).strip().splitlines()[0] if str(error).strip() else "no reason given"
        raise DataError(
            f"File `{path}` ({path.stat().st_size} bytes) cannot be read by the {_short(module)} "
            f"reader: {type(error).__name__}: {reason}",
            remedy="Copy the file again from the recorder, or export the file again.",
        ) from error


def _reader_of(path: Path) -> str:
    if not path.is_file():
        folder = path.parent
        files = sorted(p.name for p in folder.iterdir() if p.is_file()) if folder.is_dir() else []
        listed = f"Found: {', '.join(files[:10])}." if files else ""
        where = listed or f"Correct `{path}`: folder `{folder}` has no files."
        raise DataError(
            f"File `{path}` does not exist.", remedy=did_you_mean(path.name, files) + where
        )
    suffix = path.suffix.lower()
    if suffix in PICKLES:
        raise DataError(
            f"File `{path.name}` is a pickle, which is never read.",
            why="Opening a pickle runs any program that the pickle contains.",
            remedy="Save the arrays with numpy.savez, or as HDF5.",
        )
    if suffix not in READERS:
        raise DataError(
            f"File `{path.name}` has the suffix `{suffix}`, for which there is no reader.",
            remedy=EXPORTS.get(suffix, f"Export one of these formats: {', '.join(READERS)}."),
        )
    if path.stat().st_size == 0:
        raise DataError(
            f"File `{path}` (0 bytes) cannot be read by the {_short(READERS[suffix])} reader.",
            remedy="The file is empty: copy or export the file again.",
        )
    return READERS[suffix]


def _short(module: str) -> str:
    return module.rpartition(".")[2]
