"""Two generations of every checkpoint, each with a hash of its own: the newest whole one counts."""

import hashlib
import io
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from jbw.run.files import write_whole
from jbw.run.interruption import Interruption

MAGIC = b"jbw-checkpoint-1"
EVERY_S = 5.0  # between two savings at least
COST = 0.02  # share of the time that saving may take
Watch = Callable[[str, Any], None]


def unwatched(name: str, so_far: Any) -> None:
    """The `Watch` of chains that nobody waits for."""


class Generation(NamedTuple):
    """A checkpoint as it was read.

    Attributes:
        number: How many were saved before it.
        arrays: What it holds.
    """

    number: int
    arrays: dict[str, np.ndarray]


def pack(number: int, arrays: Mapping[str, np.ndarray]) -> bytes:
    """A checkpoint as bytes: a line with the hash of all that follows, the number, the arrays.

    Args:
        number: How many were saved before it.
        arrays: Plain arrays by name.
    """
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **arrays)
    content = b"%d\n" % number + stream.getvalue()
    return b"%s %s\n" % (MAGIC, hashlib.sha256(content).hexdigest().encode()) + content


def unpack(content: bytes) -> Generation | None:
    """A checkpoint from its bytes; None where they are torn or changed.

    Args:
        content: What a file held.
    """
    head, _, rest = content.partition(b"\n")
    if head != b"%s %s" % (MAGIC, hashlib.sha256(rest).hexdigest().encode()):
        return None
    number, _, arrays = rest.partition(b"\n")
    with np.load(io.BytesIO(arrays), allow_pickle=False) as stored:
        return Generation(int(number), {name: stored[name] for name in stored.files})


class Checkpoint:
    """The chains of one posterior, in two files of which the older is written next.

    Args:
        folder: Where they are kept.
        name: Name of the posterior.
        interruption: What may ask to stop after a saving.
        watch: Called with the name and how far the chains are, after every chunk of steps.
    """

    def __init__(
        self, folder: Path, name: str, interruption: Interruption, watch: Watch = unwatched
    ) -> None:
        self._name, self._watch = name, watch
        self._files = [folder / f"{name}.{i}.checkpoint" for i in (0, 1)]
        self._interruption = interruption
        self._number = 0
        self._saved, self._cost = perf_counter(), 0.0

    def load(self) -> dict[str, np.ndarray] | None:
        """What was saved last and is whole, or None; what is damaged is warned of."""
        contents = [path.read_bytes() for path in self._files if path.exists()]
        found = sorted((one for c in contents if (one := unpack(c))), key=lambda one: one.number)
        if len(found) < len(contents):
            then = "the one before it is used" if found else "its chains start again"
            warnings.warn(
                f"A checkpoint of {self._name} in {self._files[0].parent} is damaged: {then}.",
                stacklevel=2,
            )
        if not found:
            return None
        self._number = found[-1].number + 1
        return found[-1].arrays

    def grown(self, so_far: Any) -> None:
        """Pass on how far the chains are.

        Args:
            so_far: What is known of them.
        """
        self._watch(self._name, so_far)

    def due(self) -> bool:
        """Whether to save: when asked to stop, or when saving takes a small share of the time."""
        self._interruption.wait(True)
        if self._interruption.asked:
            return True
        return perf_counter() - self._saved > max(EVERY_S, self._cost / COST)

    def save(self, arrays: Mapping[str, np.ndarray], *, last: bool) -> None:
        """Save in place of the older generation, then stop if that was asked for.

        Args:
            arrays: Plain arrays by name.
            last: Whether the chains are complete.

        Raises:
            RunError: If the disk is full or the folder cannot be written.
            KeyboardInterrupt: If the run was asked to stop.
        """
        clock = perf_counter()
        write_whole(self._files[self._number % 2], pack(self._number, arrays))
        self._number += 1
        self._saved = perf_counter()
        self._cost = self._saved - clock
        self._interruption.wait(not last)
        self._interruption.stop_if_asked()
