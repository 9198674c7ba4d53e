"""The interface of a recorder: how to recognise its files, and how to read their content."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from jbw.measurement.files.tree import Contents


@dataclass(frozen=True)
class Recorder:
    """One dialect of one program that writes measurement files.

    A tree of MATLAB, HDF5, UFF, TDMS, WAV or NumPy is known by `of` and annotated by `read`; text
    is known by `of_text`, by its first lines, and parsed by `read_text`. The docstring of its
    module says how it is known, on what that rests, and what of it nobody has seen.
    """

    name: str
    of: Callable[[Contents], bool] | None = None
    read: Callable[[Contents], Contents] | None = None
    of_text: Callable[[Sequence[str]], bool] | None = None
    read_text: Callable[[Sequence[str], Path], Contents] | None = None
    is_general: bool = False  # whether it takes what no other recorder is known by
