"""How much memory a process may take, and how much an identification of records takes."""

import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from jbw.errors import DataError, RunError
from jbw.report.messages.reading import FEWER_SAMPLES

# Measured by the peak of whole processes up to the fit, on sweeps of 0.5 to 20 million samples and
# two channels: 0.34 GB before any record, then 250 to 330 bytes a sample of one test. Records are
# held in float64; every test keeps its mean with its polynomials and spectra, and one record at a
# time is filtered and transformed.
PROCESS, VALUE, OF_TEST, OF_LONGEST = 0.35e9, 8, 100, 200
CONTAINER = Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes")


def address_space() -> float:
    """Most address space that this process may have [bytes]; infinite where nothing limits it."""
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


def needed_memory(tests: Iterable[Iterable[tuple[int, int]]]) -> float:
    """Return the memory that an identification takes up to its fit [bytes].

    Args:
        tests: Of every test the number of samples and of channels of each record.
    """
    sizes = [list(test) for test in tests]
    values = sum(samples * channels for test in sizes for samples, channels in test)
    longest = [max((samples for samples, _ in test), default=0) for test in sizes]
    return PROCESS + VALUE * values + OF_TEST * sum(longest) + OF_LONGEST * max(longest, default=0)


def require_memory(tests: Iterable[Iterable[tuple[int, int]]], last: str) -> None:
    """Refuse records that an identification cannot hold, as soon as so many are read.

    Args:
        tests: As `needed_memory` takes them, of all that is read so far.
        last: Name of the record that was read last.

    Raises:
        DataError: They need more than `most_memory`.
    """
    needed, most = needed_memory(tests), most_memory()
    if needed > most:
        raise DataError(
            f"The records up to {last} need about {needed / 2**30:.1f} GiB, but this process may "
            f"take {most / 2**30:.1f} GiB.",
            remedy=FEWER_SAMPLES,
        )


def out_of_memory(error: BaseException) -> RunError:
    """Return the error of a process that got no more memory."""
    return RunError(
        f"The memory is exhausted, of which this process may take {most_memory() / 2**30:.1f} "
        f"GiB: {' '.join(str(error).split()) or 'no size is stated'}.",
        remedy=FEWER_SAMPLES,
    )
