"""The interface of a recorder: how to recognise its files, and how to read their content."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from jbw.measurement.files.tree import Contents


@dataclass(frozen=True)
class Recorder:
    """A recorder: the layout of files as one program writes them.

    A tree of MATLAB, HDF5, UFF, TDMS, WAV or NumPy is recognised by `of`, if one of `readers` made
    it, and annotated by `read`. A text is recognised from its first lines by `of_text`, and parsed
    by `read_text`. The docstring of the recorder's module says how files are recognised, on what
    evidence, and what has not been tested.
    """

    name: str
    of: Callable[[Contents], bool] | None = None
    read: Callable[[Contents], Contents] | None = None
    of_text: Callable[[Sequence[str]], bool] | None = None
    read_text: Callable[[Sequence[str], Path], Contents] | None = None
    is_general: bool = False  # whether this recorder accepts files that no other recognises
    # first words of `Contents.reader`, such as MATLAB, of files to recognise; empty for all files
    readers: tuple[str, ...] = ()

    def recognises(self, contents: Contents) -> bool:
        """Return whether a tree has this recorder's layout; without `of`, its reader decides."""
        is_read = not self.readers or contents.reader.startswith(self.readers)
        return self.read is not None and is_read and (self.of is None or self.of(contents))
