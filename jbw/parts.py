"""Partial results of a long computation, stored in files, so that it can be resumed.

A partial result is that of one law, unit, replication, sampler, test or candidate. Its file
contains plain values, arrays and labelled arrays, marked with the SHA-256 of everything that
determines them: the command, the inputs, the sources and the seed. It contains no code.
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
    """A function that computes a partial result, or loads it if it is stored."""

    def __call__[T](self, name: str, make: Callable[[], T], /, *kinds: type) -> T:
        """Return a stored partial result; if none is stored, call `make` and store its result.

        Args:
            name: Name of the partial result, unique in the computation.
            make: Function that computes the partial result if it is not stored.
            kinds: Dataclasses and named tuples in it, which are rebuilt from their fields.
        """
        ...


def unkept[T](name: str, make: Callable[[], T], /, *kinds: type) -> T:
    """Compute a partial result without storing it."""
    return make()


@dataclass(frozen=True)
class KeptParts:
    """The partial results of a long computation, stored in a folder, one file each.

    Attributes:
        folder: The folder of the files.
        mark: Prefix of the names of files that the same inputs determine.
    """

    folder: Path
    mark: str

    def __call__[T](self, name: str, make: Callable[[], T], /, *kinds: type) -> T:
        """Return a stored partial result; if none is stored, call `make` and store its result.

        The result is always rebuilt from the file, so that a resumed computation gives the same
        values.

        Raises:
            RunError: The file cannot be written.
        """
        path = self.folder / f"{self.mark}-{digest_of(name)}{ENDING}"
        kept = unpack(path.read_bytes()) if path.exists() else None  # None for a damaged file
        if kept is None:
            content = pack(0, as_arrays(make(), *kinds))
            try:
                put_whole(path, content)
            except OSError as error:
                raise RunError(
                    f"{path} cannot be written: {error.strerror or error}.", remedy=REPEAT
                ) from error
            kept = unpack(content)
        return from_arrays(kept[1] if kept else {}, *kinds)


def digest_of(text: str) -> str:
    """Return the first 16 hexadecimal digits of the SHA-256 hash of a text."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def as_arrays(value: Any, *kinds: type) -> dict[str, np.ndarray]:
    """Convert a value to named arrays; the array "value" is JSON that refers to the other arrays.

    Args:
        value: Value made of None, numbers, text, lists, tuples, mappings, arrays, datasets, trees.
        kinds: Dataclasses and named tuples in the value.

    Raises:
        TypeError: The value contains something else.
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
    """Reconstruct the value that `as_arrays` converted to named arrays."""
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
