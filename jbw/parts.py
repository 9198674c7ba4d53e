"""Parts of a long job, kept in files until its output is written, so that the same command goes on.

A part is one law, unit, replication, sampler, test or candidate. Its file holds plain values,
arrays and labelled arrays with the SHA-256 of all that decides them: what was typed, the inputs,
the sources and the seed. Nothing of it is code.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import xarray as xr

from jbw.errors import RunError
from jbw.report.messages.run import REPEAT
from jbw.run.checkpoints import pack, unpack
from jbw.run.files import put_whole

ENDING = ".kept"


class Parts(Protocol):
    """A function that makes a part of a job, or loads it if it was made before."""

    def __call__[T](self, name: str, make: Callable[[], T], /, *kinds: type) -> T:
        """Return what `make` returns.

        Args:
            name: Of the part, one of its kind in the job.
            make: Makes it, if need be.
            kinds: Dataclasses and named tuples in it, which are made again of their fields.
        """
        ...


def unkept[T](name: str, make: Callable[[], T], /, *kinds: type) -> T:
    """Make a part and keep nothing."""
    return make()


@dataclass(frozen=True)
class KeptParts:
    """Parts in a folder, each in a file of its own.

    Attributes:
        folder: The folder.
        mark: Begins the names of files whose numbers the same decides.
    """

    folder: Path
    mark: str

    def __call__[T](self, name: str, make: Callable[[], T], /, *kinds: type) -> T:
        """Return the part of this name: as its file holds it, also where it was made just now.

        Raises:
            RunError: The file cannot be written.
        """
        path = self.folder / f"{self.mark}-{digest_of(name)}{ENDING}"
        kept = unpack(path.read_bytes()) if path.exists() else None  # None of a damaged file
        if kept is None:
            content = pack(0, as_arrays(make(), *kinds))
            try:
                put_whole(path, content)
            except OSError as error:
                raise RunError(
                    f"{path} cannot be written: {error.strerror or error}.", remedy=REPEAT
                ) from error
            kept = unpack(content)
        return from_arrays(kept.arrays if kept else {}, *kinds)


def digest_of(text: str) -> str:
    """Return the first 16 hexadecimal digits of the SHA-256 of a text."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def as_arrays(value: Any, *kinds: type) -> dict[str, np.ndarray]:
    """Return a value as named arrays, of which "value" is JSON that names the others.

    Args:
        value: Of None, numbers, text, lists, tuples, mappings, arrays, datasets and trees.
        kinds: Dataclasses and named tuples in it.

    Raises:
        TypeError: Something else is in it.
    """
    arrays: dict[str, np.ndarray] = {}

    def plain(value: Any) -> Any:
        if value is None or type(value) in (bool, int, float, str):
            return value
        if type(value) in kinds:
            fields = vars(value) if is_dataclass(value) else value._asdict()
            return [type(value).__name__, plain(dict(fields))]
        if isinstance(value, xr.DataTree):
            nodes = {path: node.to_dataset(inherit=False) for path, node in value.subtree_with_keys}
            return ["tree", plain(nodes)]
        if type(value) is xr.Dataset:
            coords, data = (
                {name: (x.dims, x.values, x.attrs) for name, x in variables.items()}
                for variables in (value.coords, value.data_vars)
            )
            return ["dataset", plain((data, coords, value.attrs))]
        if isinstance(value, Mapping):
            return ["dict", [[plain(key), plain(item)] for key, item in value.items()]]
        if type(value) in (list, tuple):
            return [type(value).__name__, [plain(item) for item in value]]
        if isinstance(value, np.generic | np.ndarray) or hasattr(value, "__array__"):
            array = np.asarray(value)
            name = str(len(arrays))
            arrays[name] = array.astype(str) if array.dtype.kind == "O" else array
            return ["scalar" if isinstance(value, np.generic) else "array", name]
        raise TypeError(f"A part of a job must be plain values and arrays, not {type(value)}.")

    told = json.dumps(plain(value))
    return {**arrays, "value": np.array(told)}


def from_arrays(arrays: Mapping[str, np.ndarray], *kinds: type) -> Any:
    """Return the value that `as_arrays` took."""
    made: dict[str, Callable[[Any], Any]] = {
        **{kind.__name__: lambda told, kind=kind: kind(**value(told)) for kind in kinds},
        "tree": lambda told: xr.DataTree.from_dict(
            {"/" if path == "." else path: node for path, node in value(told).items()}
        ),
        "dataset": lambda told: xr.Dataset(*value(told)),
        "dict": lambda told: {value(key): value(item) for key, item in told},
        "list": lambda told: [value(item) for item in told],
        "tuple": lambda told: tuple(value(item) for item in told),
        "array": lambda name: arrays[name],
        "scalar": lambda name: arrays[name][()],
    }

    def value(told: Any) -> Any:
        return made[told[0]](told[1]) if isinstance(told, list) else told

    return value(json.loads(str(arrays["value"])))
