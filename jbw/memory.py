"""How much memory a process may take, and how much an identification of records takes."""

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from jbw.errors import DataError, RunError
from jbw.report.messages.reading import FEWER_SAMPLES

# Measured by the peak of whole processes, on sweeps of two channels. Up to the fit, of 0.5 to 20
# million samples: 250 to 330 bytes a sample of one test. Records are held in float64; every test
# keeps its mean with its polynomials and spectra, and one record at a time is filtered and
# transformed. In the fit: 0.94 GB with its compiled programs, then 16 parameter sets side by side
# of every sample that a solver follows: 520 bytes of one mode with one joint (0.1 and 0.4 million
# samples), 2,700 of five modes with two joints (4,096 and 65,536 samples).
MAX_BYTES = 4 * 2**30  # of one array that is read: stops decompression bombs and slips
PROCESS, VALUE, OF_TEST, OF_LONGEST, FOLLOWED = 0.95e9, 8, 100, 200, 330
CONTAINER = Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes")


def require_readable(size: float, takes: str, remedy: str) -> None:
    """Refuse an array or a file of more bytes than are read at once, before it is read.

    Args:
        size: Its bytes once unpacked.
        takes: Subject and verb of the sentence, for example "File `a.npz` unpacks to".
        remedy: What to do.

    Raises:
        DataError: It has more than `MAX_BYTES`.
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
    except ImportError:  # no such limits on this system
        return float("inf")
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return float("inf") if soft == resource.RLIM_INFINITY else float(soft)


def most_memory() -> float:
    """Return the memory of the machine, its container or its address space [bytes]: the least."""
    limits = [address_space()]
    with suppress(AttributeError, OSError, ValueError):  # not of every system
        limits.append(float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")))
    for path in CONTAINER:
        with suppress(OSError, ValueError):  # none, or "max"
            limits.append(float(path.read_text()))
    return min(limits)


@dataclass(frozen=True)
class HeldRecords:
    """Sizes of the records that are read so far.

    Attributes:
        values: Samples of all channels.
        largest: Samples of the longest record of all.
        longest: Samples of the longest record of the present test.
        size: Modes and joints that a fit follows through every sample of the present test.
        finished: Bytes that earlier tests keep, and that a fit takes beside them.
    """

    values: int = 0
    largest: int = 0
    longest: int = 0
    size: int = 0
    finished: int = 0

    def begun(self, size: int) -> "HeldRecords":
        """Return the same records at the beginning of a test of so many modes and joints."""
        return HeldRecords(self.values, self.largest, 0, size, self.of_tests)

    def beside(self, samples: int, channels: int) -> "HeldRecords":
        """Return these records and one more of the present test."""
        return replace(
            self,
            values=self.values + samples * channels,
            largest=max(self.largest, samples),
            longest=max(self.longest, samples),
        )

    @property
    def of_tests(self) -> int:
        """Bytes that all tests keep, and that a fit takes beside them."""
        return self.finished + (OF_TEST + FOLLOWED * self.size) * self.longest

    @property
    def needed(self) -> float:
        """The memory that an identification of the records takes [bytes]."""
        return PROCESS + VALUE * self.values + self.of_tests + OF_LONGEST * self.largest


NO_RECORDS = HeldRecords()
Admit = Callable[[int, int, str], None]
"""Refuses a record by its samples, its channels and its name, before it is read."""


def require_memory(held: HeldRecords, last: str) -> None:
    """Refuse records that an identification cannot hold.

    Args:
        held: Records that are read so far, with the last one, which need not be read yet.
        last: Name of the last record.

    Raises:
        DataError: They need more than `most_memory`.
    """
    needed, most = held.needed, most_memory()
    if needed > most:
        raise DataError(
            f"The records up to {last} need about {needed / 2**30:.1f} GiB, but this process may "
            f"take {most / 2**30:.1f} GiB.",
            remedy=FEWER_SAMPLES,
        )


def admit_all(samples: int, channels: int, name: str) -> None:
    """Refuse no record: what is only read is limited by `require_readable`."""


def admit_alone(samples: int, channels: int, name: str) -> None:
    """Refuse a record that an identification of nothing else cannot hold."""
    require_memory(NO_RECORDS.beside(samples, channels), name)


def out_of_memory(error: BaseException) -> RunError:
    """Return the error of a process that got no more memory."""
    return RunError(
        f"The memory is exhausted, of which this process may take {most_memory() / 2**30:.1f} "
        f"GiB: {' '.join(str(error).split()) or 'no size is stated'}.",
        remedy=FEWER_SAMPLES,
    )
