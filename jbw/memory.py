"""The memory that a process may use, and the memory that an identification needs."""

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from jbw.errors import DataError, RunError
from jbw.report.messages.reading import FEWER_SAMPLES

# largest size of one array that jbw reads; this stops decompression bombs
MAX_BYTES = 4 * 2**30
# Memory in bytes, measured as the peaks of whole processes on sweeps of two channels. Until the fit
# begins, a test needs 250 to 330 bytes per sample, with 0.5 to 20 million samples. Records are kept
# in float64; every test keeps its mean with its polynomials and spectra, and one record at a time
# is filtered and transformed. The fit needs 0.94 GB with its compiled programs, plus memory for 16
# parallel parameter sets of every sample through which a solver steps: 520 bytes for one mode with
# one joint (0.1 and 0.4 million samples), 2,700 for five modes with two joints (4,096 and 65,536
# samples).
PROCESS, VALUE, OF_TEST, OF_LONGEST, FOLLOWED = 0.95e9, 8, 100, 200, 330
CONTAINER = Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes")


def require_readable(size: float, takes: str, remedy: str) -> None:
    """Raise a DataError for an array or file too large to be read at once, before it is read.

    Args:
        size: Unpacked size in bytes.
        takes: Subject and verb of the sentence, for example "File `a.npz` unpacks to".
        remedy: Text that says what to do.

    Raises:
        DataError: The size exceeds `MAX_BYTES`.
    """
    if size > MAX_BYTES:
        raise DataError(
            f"{takes} {size / 2**30:.1f} GiB, but at most {MAX_BYTES / 2**30:.0f} GiB are read at "
            "once.",
            remedy=remedy,
        )


def address_space() -> float:
    """Return the address space limit of this process [bytes]; infinite if unlimited."""
    try:
        import resource
    except ImportError:  # Only Unix has the module `resource` and a limit of the address space.
        return float("inf")
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return float("inf") if soft == resource.RLIM_INFINITY else float(soft)


def most_memory() -> float:
    """Return the smallest memory limit: of the machine, container or address space [bytes]."""
    limits = [address_space()]
    with suppress(AttributeError, OSError, ValueError):  # not available on every system
        limits.append(float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")))
    for path in CONTAINER:
        # The file is missing or says "max", so there is no limit.
        with suppress(OSError, ValueError):
            limits.append(float(path.read_text()))
    return min(limits)


@dataclass(frozen=True)
class HeldRecords:
    """Numbers of samples and bytes of those records that have been read so far.

    Attributes:
        values: Number of samples of all channels.
        largest: Number of samples of the longest record of all.
        longest: Number of samples of the longest record of the present test.
        size: Number of modes and joints that a fit follows through every sample of the present
            test.
        finished: Bytes for earlier tests, including those that a fit needs.
    """

    values: int = 0
    largest: int = 0
    longest: int = 0
    size: int = 0
    finished: int = 0

    def begun(self, size: int) -> "HeldRecords":
        """Return the counts of samples and bytes at the start of a test."""
        return HeldRecords(self.values, self.largest, 0, size, self.of_tests)

    def beside(self, samples: int, channels: int) -> "HeldRecords":
        """Return the counts of samples and bytes after one more record of the present test."""
        return replace(
            self,
            values=self.values + samples * channels,
            largest=max(self.largest, samples),
            longest=max(self.longest, samples),
        )

    @property
    def of_tests(self) -> int:
        """The memory for all tests begun so far, including that of their fit [bytes]."""
        return self.finished + (OF_TEST + FOLLOWED * self.size) * self.longest

    @property
    def needed(self) -> float:
        """The memory that an identification needs for the records read so far [bytes]."""
        return PROCESS + VALUE * self.values + self.of_tests + OF_LONGEST * self.largest


NO_RECORDS = HeldRecords()
Admit = Callable[[int, int, str], None]
"""A function of a record's samples, channels and name; it raises an error before a record that is
too large is read."""


def require_memory(held: HeldRecords, last: str) -> None:
    """Raise a DataError if an identification of the records would exceed the memory.

    Args:
        held: Sizes of all records up to the last, which need not be read yet.
        last: Name of the last record.

    Raises:
        DataError: The records need more than `most_memory`.
    """
    needed, most = held.needed, most_memory()
    if needed > most:
        raise DataError(
            f"The records up to {last} need about {needed / 2**30:.1f} GiB, but this process may "
            f"use {most / 2**30:.1f} GiB.",
            remedy=FEWER_SAMPLES,
        )


def admit_all(samples: int, channels: int, name: str) -> None:
    """Accept a record of any size, because `require_readable` limits what is merely read."""


def admit_alone(samples: int, channels: int, name: str) -> None:
    """Raise a DataError for a record that alone is too large for an identification."""
    require_memory(NO_RECORDS.beside(samples, channels), name)


def out_of_memory(error: BaseException) -> RunError:
    """Return the error of a process that has run out of memory."""
    return RunError(
        f"The memory that this process may use ({most_memory() / 2**30:.1f} GiB) is exhausted: "
        f"{' '.join(str(error).split()) or 'no size is stated'}.",
        remedy=FEWER_SAMPLES,
    )
