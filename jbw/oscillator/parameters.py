"""Types of the parameters."""

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Scalar = Float[Array, "..."] | float
Restoring = Callable[[Scalar], Scalar]


@runtime_checkable
class Hysteresis(Protocol):
    """Whatever holds the parameters of Eq. (2): the record `BoucWen`, or the law alone."""

    alpha: Any
    delta: Any
    gamma: Any
    nu: Any


def batched(function: Callable[..., Any], *arguments: Any) -> Any:
    """Apply a function of scalar leaves over the broadcast shape of all leaves.

    Args:
        function: Of the arguments with 0-d leaves; returns arrays.
        *arguments: Records or arrays, whose leaves broadcast.

    Returns:
        Its results, with the broadcast shape in front.
    """
    leaves, structure = jax.tree.flatten(arguments)
    leaves = jnp.broadcast_arrays(*(jnp.asarray(leaf, float) for leaf in leaves))
    shape = leaves[0].shape
    flat = jax.tree.unflatten(structure, [leaf.ravel() for leaf in leaves])
    results = jax.vmap(function)(*flat)
    return jax.tree.map(lambda x: x.reshape(*shape, *x.shape[1:]), results)
