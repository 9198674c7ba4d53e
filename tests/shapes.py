"""Shapes in annotations checked while the tests run: beartype over jaxtyping, where a shape stands.

Only annotations that name an array are checked, and of them shape and kind of number: whether it
is NumPy's or JAX's, and every other type, is pyright's. What is defined inside a function is left
as it is, for it would be checked anew at every call.
"""

import ast
import operator
import sys
import zlib
from collections.abc import Callable, Mapping, Sequence
from functools import cache, reduce, wraps
from importlib.abc import MetaPathFinder
from importlib.machinery import PathFinder, SourceFileLoader
from pathlib import Path
from types import FunctionType, UnionType
from typing import Any, Union, get_args, get_origin

import jax
import numpy as np
from beartype import BeartypeConf, beartype
from jaxtyping import AbstractArray, Float, Key, Real, jaxtyped

PACKAGE = "jbw"
STATE = f"checked-{zlib.crc32(Path(__file__).read_bytes()):08x}"  # of what compiles the checks in
beartyped = beartype(conf=BeartypeConf(is_pep484_tower=True))  # an int is a float, as for pyright


def names_a_shape(annotation: Any) -> bool:
    """Whether a shape stands in an annotation, at any depth."""
    if isinstance(annotation, type) and issubclass(annotation, AbstractArray):
        return True
    return any(names_a_shape(part) for part in get_args(annotation))


def widened(annotation: Any) -> Any:
    """The annotation with arrays of NumPy beside those of JAX; without a shape, anything."""
    if not names_a_shape(annotation):
        return Any
    if isinstance(annotation, type) and issubclass(annotation, AbstractArray):
        if annotation.array_type not in (jax.Array, np.ndarray) or annotation.dtype is Key:
            return annotation
        dtype = Real if annotation.dtype is Float else annotation.dtype  # whole numbers are real
        dims = annotation.dim_str
        either = dtype[jax.Array, dims] | dtype[np.ndarray, dims]
        bare = all(one.startswith(("*", "...")) for one in dims.split())
        return either | np.generic | complex if bare else either  # a scalar is of no dimension
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin in (Union, UnionType):
        # A member without a shape stays what it is: as `Any` it would let everything pass.
        members = [widened(one) if names_a_shape(one) else one for one in parts]
        return reduce(operator.or_, members)
    if origin in (tuple, list, dict, Mapping, Sequence):
        return origin[tuple(one if one is ... else widened(one) for one in parts)]
    return annotation


def checked(made: Any) -> Any:
    """A function, or a class by its fields, with its shapes checked at every call."""
    if isinstance(made, type):
        if "__init__" in made.__dict__ and hasattr(made, "__dataclass_fields__"):
            made.__init__ = checked(made.__init__)
        return made
    annotations = getattr(made, "__annotations__", {})
    if not any(map(names_a_shape, annotations.values())) or hasattr(made, "__wrapped__"):
        return made

    @cache  # of most functions, a session that runs a part of the tests calls none
    def wrapped() -> Callable[..., Any]:
        widely = FunctionType(
            made.__code__, made.__globals__, made.__name__, made.__defaults__, made.__closure__
        )
        widely.__kwdefaults__, widely.__qualname__ = made.__kwdefaults__, made.__qualname__
        widely.__annotations__ = {name: widened(one) for name, one in annotations.items()}
        return jaxtyped(widely, typechecker=beartyped)

    @wraps(made)
    def checking(*arguments: Any, **options: Any) -> Any:
        return wrapped()(*arguments, **options)

    return checking


def apart(path: str) -> str:
    """Where compiled code with these checks lies, of which code without them knows nothing."""
    return f"{path.removesuffix('.pyc')}.{STATE}.pyc" if path.endswith(".pyc") else path


class Checking(SourceFileLoader):
    """Loads a module with `checked` as the innermost decorator of functions and methods."""

    def source_to_code(self, data, path, *, _optimize=-1):
        """Compiled source; what is defined inside a function is left as it is."""
        tree = ast.parse(data, path)
        made = [node for node in tree.body if isinstance(node, ast.ClassDef | ast.FunctionDef)]
        for node in made:
            if isinstance(node, ast.ClassDef):
                made += [one for one in node.body if isinstance(one, ast.FunctionDef)]
            name = ast.copy_location(ast.Name("shapes_checked_", ast.Load()), node)
            # Fields are known after `dataclass`; of functions, `jit` must see the checked one.
            node.decorator_list.insert(
                0 if isinstance(node, ast.ClassDef) else len(node.decorator_list), name
            )
        return compile(tree, path, "exec", dont_inherit=True, optimize=_optimize)

    def get_data(self, path):
        """Source, or compiled code with the checks in it."""
        return super().get_data(apart(path))

    def set_data(self, path, data, **options):
        """Keep compiled code with the checks in it."""
        super().set_data(apart(path), data, **options)

    def exec_module(self, module):
        """Execute the module with the decorator at hand."""
        module.__dict__["shapes_checked_"] = checked
        super().exec_module(module)


class Finder(MetaPathFinder):
    """Finds the package's modules before others do."""

    def find_spec(self, fullname, path=None, target=None):
        """Where a module of the package lies, to be loaded with checks."""
        if fullname.partition(".")[0] != PACKAGE:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = Checking(spec.loader.name, spec.loader.path)
        return spec


def check_shapes() -> None:
    """Check every module of the package that is imported from here on."""
    sys.meta_path.insert(0, Finder())
