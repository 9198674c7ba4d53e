"""What every public function checks when called with concrete numbers; tracers are trusted."""

from typing import Any

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import ArrayLike

from jbw.errors import ConfigError, ModelError


def is_concrete(*values: object) -> bool:
    """Whether none of the values (arrays or records) is being traced by a transformation."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))


def require_closed_form(joint: Any) -> None:
    """Raise unless nu = 1, the exponent whose hysteresis has a closed form.

    Args:
        joint: Bouc-Wen parameters; `nu` is static, so it is checked under tracing too.

    Raises:
        ModelError: `nu` is not 1.
    """
    if joint.nu != 1.0:
        raise ModelError(
            f"Parameter `nu` must be 1 for the closed-form hysteresis, but nu = {joint.nu:g}.",
            remedy="Integrate `hysteresis_rate`, which holds for every nu, or set nu = 1.",
        )


def require_finite(joint: Any, **arguments: ArrayLike) -> None:
    """Raise where a parameter of the joint or an argument is NaN or infinite; trust tracers.

    Args:
        joint: Bouc-Wen parameters.
        **arguments: The other arguments by name.

    Raises:
        ModelError: A parameter or an argument is not finite.
    """
    for kind, group in (("Parameter", parameters(joint)), ("Argument", arguments)):
        for name, value in group.items():
            if is_concrete(value) and not np.all(np.isfinite(np.asarray(value))):
                raise ModelError(f"{kind} `{name}` must be finite, but it is {_first_bad(value)}.")


def parameters(joint: Any) -> dict[str, ArrayLike]:
    """Parameters by name, those of a record's restoring force as `restoring.lambda_3`.

    Args:
        joint: Bouc-Wen parameters, or an oscillator of any laws.
    """
    if hasattr(joint, "parameters"):
        return joint.parameters()
    leaves = jax.tree_util.tree_leaves_with_path(joint)
    return {jax.tree_util.keystr(path).removeprefix("."): leaf for path, leaf in leaves}


def require_at_least(name: str, value: ArrayLike, bound: float, *, open_end: bool = False) -> None:
    """Raise where a concrete argument lies below its bound.

    Args:
        name: Name of the argument.
        value: Its value; trusted when traced.
        bound: The smallest value allowed.
        open_end: Whether the bound itself is excluded.

    Raises:
        ConfigError: The argument is below the bound, or on it where that is excluded.
    """
    if not is_concrete(value):
        return
    least = float(np.min(np.asarray(value)))
    if least < bound or (open_end and least == bound):
        relation = "greater than" if open_end else "at least"
        raise ConfigError(f"Argument `{name}` must be {relation} {bound:g}, but it is {least:g}.")


def _first_bad(value: ArrayLike) -> str:
    flat = np.ravel(np.asarray(value))
    return str(flat[~np.isfinite(flat)][0])


def require_none(joint: Any, function: str) -> None:
    """Raise where a restoring force stands beside the joint of a formula that has no place for it.

    Args:
        joint: Bouc-Wen parameters.
        function: Name of the function that holds the formula.

    Raises:
        ModelError: There is such a force.
    """
    if joint.restoring is not None:
        raise ModelError(
            f"Parameter `restoring` must be None for `{function}`, but it is a force of kind "
            f"{type(joint.restoring).__name__}.",
            why="Its formula knows the hysteretic force and a linear spring only.",
            remedy="Use `steady_state` or `simulate`, which hold for every restoring force.",
        )
