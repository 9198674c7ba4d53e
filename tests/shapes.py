"""Array shapes in annotations, checked while tests run: beartype over jaxtyping.

Only annotations that contain an array are checked, for shape and kind of number. Pyright checks
whether it is an array of NumPy or JAX, and every other type. Functions defined within functions are
not checked, since that would be repeated at every call.
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
# State of the code that compiles the checks in.
STATE = f"checked-{zlib.crc32(Path(__file__).read_bytes()):08x}"
# An int is accepted as a float, as by pyright.
beartyped = beartype(conf=BeartypeConf(is_pep484_tower=True))


def names_a_shape(annotation: Any) -> bool:
    """Return whether an annotation contains a shape, at any depth."""
    if isinstance(annotation, type) and issubclass(annotation, AbstractArray):
        return True
    return any(names_a_shape(part) for part in get_args(annotation))


def widened(annotation: Any) -> Any:
    """Return an annotation with NumPy's arrays next to JAX's; without a shape, Any."""
    if not names_a_shape(annotation):
        return Any
    if isinstance(annotation, type) and issubclass(annotation, AbstractArray):
        if annotation.array_type not in (jax.Array, np.ndarray) or annotation.dtype is Key:
            return annotation
        dtype = Real if annotation.dtype is Float else annotation.dtype  # Whole numbers are real.
        dims = annotation.dim_str
        either = dtype[jax.Array, dims] | dtype[np.ndarray, dims]
        bare = all(one.startswith(("*", "...")) for one in dims.split())
        return either | np.generic | complex if bare else either  # A scalar has no dimension.
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin in (Union, UnionType):
        # A member without a shape stays unchanged: as `Any` it would accept everything.
        members = [widened(one) if names_a_shape(one) else one for one in parts]
        return reduce(operator.or_, members)
    if origin in (tuple, list, dict, Mapping, Sequence):
        return origin[tuple(one if one is ... else widened(one) for one in parts)]
    return annotation


def checked(made: Any) -> Any:
    """Return a function, or a class by its fields, with its shapes checked at every call."""
    if isinstance(made, type):
        if "__init__" in made.__dict__ and hasattr(made, "__dataclass_fields__"):
            made.__init__ = checked(made.__init__)
        return made
    annotations = getattr(made, "__annotations__", {})
    if not any(map(names_a_shape, annotations.values())) or hasattr(made, "__wrapped__"):
        return made

    @cache  # A session that runs a part of the tests calls none of most functions.
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
    """Return the path of compiled code with these checks, unknown to code without them."""
    return f"{path.removesuffix('.pyc')}.{STATE}.pyc" if path.endswith(".pyc") else path


class Checking(SourceFileLoader):
    """A loader of modules with `checked` as the innermost decorator of functions and methods."""

    def source_to_code(self, data, path, *, _optimize=-1):
        """Return the compiled source, with decorators except on functions within functions."""
        tree = ast.parse(data, path)
        made = [node for node in tree.body if isinstance(node, ast.ClassDef | ast.FunctionDef)]
        for node in made:
            if isinstance(node, ast.ClassDef):
                made += [one for one in node.body if isinstance(one, ast.FunctionDef)]
            name = ast.copy_location(ast.Name("shapes_checked_", ast.Load()), node)
            # Fields are known only after `dataclass`; for functions, `jit` must see the checked
            # one.
            node.decorator_list.insert(
                0 if isinstance(node, ast.ClassDef) else len(node.decorator_list), name
            )
        return compile(tree, path, "exec", dont_inherit=True, optimize=_optimize)

    def get_data(self, path):
        """Return the source, or compiled code with the checks in it."""
        return super().get_data(apart(path))

    def set_data(self, path, data, **options):
        """Save compiled code with the checks in it."""
        super().set_data(apart(path), data, **options)

    def exec_module(self, module):
        """Execute the module with the decorator in its namespace."""
        module.__dict__["shapes_checked_"] = checked
        super().exec_module(module)


class Finder(MetaPathFinder):
    """A finder of the package's modules that precedes the usual finders."""

    def find_spec(self, fullname, path=None, target=None):
        """Return the specification of a module of the package, with a checking loader."""
        if fullname.partition(".")[0] != PACKAGE:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = Checking(spec.loader.name, spec.loader.path)
        return spec


def check_shapes() -> None:
    """Check every module of the package that is imported from now on."""
    sys.meta_path.insert(0, Finder())
