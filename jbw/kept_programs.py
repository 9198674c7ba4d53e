"""Compiled functions whose lowered programs are kept in the user's cache between processes.

JAX keeps compiled code, but it traces and lowers a function again in each process to find that
code. A kept program is found without tracing. Its key contains the source files of jbw, the
versions of JAX, the function, and every value that is not an array, so another body or another
value is another program. Programs are stored as serialised StableHLO; nothing is unpickled.
"""

import hashlib
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache, partial, update_wrapper
from importlib.metadata import version
from threading import Lock
from typing import Any

import equinox as eqx
import jax
import jax.export
from jax.core import Tracer

from jbw.cache import Programs, cached, keep
from jbw.report.messages import stages
from jbw.sources import sources_of

FOLDER = "programs"
DIGEST_BYTES = 32  # length of the SHA-256 hash with which a stored program begins


class _UnnamedError(Exception):
    """The error for a value without a text that identifies the value in any process."""


def returned[Type: type](named_tuple: Type) -> Type:
    """Register a class of named tuples that stored programs may return; use it as a decorator."""
    name = f"{named_tuple.__module__}.{named_tuple.__qualname__}"
    jax.export.register_namedtuple_serialization(named_tuple, serialized_name=name)
    return named_tuple


class KeptProgram[**P, R]:
    """A function that `equinox.filter_jit` compiles, or that is loaded from the stored programs.

    Programs are kept in processes that set `jbw.cache.Programs.are_kept`. A function with an
    argument that another process cannot identify, such as a closure, is traced in each process.

    Args:
        function: A function of arrays of JAX, and of other values that do not change often.
        options: Options of XLA's compiler.
    """

    def __init__(self, function: Callable[P, R], options: Mapping[str, Any] | None = None) -> None:
        self._options = dict(options or {})
        self._function = function
        self._compiled = eqx.filter_jit(function, compiler_options=self._options)  # pyright: ignore
        self._programs: dict[Any, Callable[..., R] | None] = {}
        self._lock = Lock()
        update_wrapper(self, function)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Call the function through its compiled program."""
        if not Programs.are_kept:
            return self._compiled(*args, **kwargs)
        leaves, tree = jax.tree.flatten((args, kwargs))
        arrays = [leaf for leaf in leaves if eqx.is_array(leaf)]
        if any(isinstance(leaf, Tracer) for leaf in arrays):
            return self._compiled(*args, **kwargs)
        fixed = tuple((type(leaf), leaf) for leaf in leaves if not eqx.is_array(leaf))
        key = tree, fixed, tuple(map(_form, arrays))
        if key not in self._programs:
            with self._lock:
                if key not in self._programs:
                    self._programs[key] = self._program((args, kwargs), arrays)
        # None also if another thread has just released the program
        program = self._programs.get(key)
        if program is None:
            return self._compiled(*args, **kwargs)
        # A stored program returns arrays that are bound to a device. JAX would compile the program
        # again for arguments that are not bound to a device.
        return program(*jax.device_put(arrays, *arrays[0].devices() if arrays else ()))

    def forget(self) -> None:
        """Release the compiled programs of this process."""
        self._programs.clear()
        # where Equinox stores the compiled function
        clear = getattr(getattr(self._compiled, "_cached", None), "clear_cache", None)
        if clear is not None:
            clear()

    def _program(self, arguments: Any, arrays: Sequence[Any]) -> Callable[..., R] | None:
        """Return a program that takes only the arrays; None if the program cannot be stored."""
        program = _exported(self._function, arguments, arrays)
        if program is None:
            return None
        return jax.jit(program.call, compiler_options=self._options)


def _exported(
    function: Callable[..., Any], arguments: Any, arrays: Sequence[Any]
) -> jax.export.Exported | None:
    """Return the stored program, or export and store it; None if it cannot be stored."""
    try:
        state = *_versions(), jax.default_backend(), str(jax.config.jax_enable_x64)
        named = f"{function.__module__}.{function.__qualname__}", arguments, state
        name = hashlib.sha256(_text(named).encode()).hexdigest()
    except _UnnamedError:
        return None
    program = _opened(cached(FOLDER, name))
    if program is None:
        dynamic, static = eqx.partition(arguments, eqx.is_array)
        tree = jax.tree.structure(dynamic)

        def of_arrays(*values: Any) -> Any:
            args, kwargs = eqx.combine(jax.tree.unflatten(tree, values), static)
            return function(*args, **kwargs)

        try:
            program = jax.export.export(jax.jit(of_arrays))(*arrays)
            content = bytes(program.serialize())
        except Exception:  # Callbacks and some other operations cannot be serialised.
            return None
        keep(FOLDER, name, hashlib.sha256(content).digest() + content)
    return program


def _opened(content: bytes | None) -> jax.export.Exported | None:
    if content is None:
        return None
    digest, program = content[:DIGEST_BYTES], content[DIGEST_BYTES:]
    if hashlib.sha256(program).digest() != digest:
        warnings.warn(stages.DAMAGED_PROGRAM, stacklevel=2)
        return None
    return jax.export.deserialize(bytearray(program))


@cache
def _versions() -> tuple[str, ...]:
    packages = "jax", "jaxlib", "equinox", "diffrax", "optimistix", "numpyro"
    return (sources_of("jbw"), *map(version, packages))


def _form(array: Any) -> tuple[Any, ...]:
    return array.shape, str(array.dtype), getattr(array, "weak_type", False)


def _text(value: Any) -> str:
    """Return a text that two values share, in any process, if and only if they are equal."""
    if eqx.is_array(value):
        return repr(_form(value))
    if value is None or isinstance(value, bool | int | float | complex | str | bytes):
        return f"{type(value).__name__}:{value!r}"
    if isinstance(value, Mapping):
        items = [f"{_text(key)}={_text(value[key])}" for key in value]
        return f"{type(value).__name__}{{{','.join(items)}}}"
    if isinstance(value, tuple | list):
        return f"{_text(type(value))}[{','.join(map(_text, value))}]"
    if isinstance(value, partial):
        return f"partial({_text((value.func, value.args, value.keywords))})"
    if hasattr(value, "__qualname__") and _is_named(value):
        return f"{value.__module__}.{value.__qualname__}"
    if is_dataclass(value) and _is_named(type(value)):
        parts = [
            f"{field.name}={_text(getattr(value, field.name, None))}" for field in fields(value)
        ]
        return f"{_text(type(value))}({','.join(parts)})"
    raise _UnnamedError(repr(value)[:200])


def _is_named(value: Any) -> bool:
    """Return whether a function or class of jbw or Python is found under its own name."""
    if value.__module__.split(".")[0] not in ("jbw", "builtins"):
        return False
    found: Any = sys.modules.get(value.__module__)
    for part in value.__qualname__.split("."):
        found = getattr(found, part, None)
    return found is value
