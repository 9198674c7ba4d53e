"""A branch of a time step that is computed only if an oscillator of a batch needs it.

Under `jax.vmap` a condition becomes a selection, which evaluates both sides in every step. Here it
stays a condition: lanes with similar parameters turn within a few steps of each other, and between
these turns no lane pays for the long side.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

_UNSHARED = ContextVar("unshared", default=False)


@contextmanager
def unshared() -> Iterator[None]:
    """Mark a context in which JAX does not distribute a batch over several devices."""
    token = _UNSHARED.set(True)
    try:
        yield
    finally:
        _UNSHARED.reset(token)


def where_rare(met: Bool[Array, ""], rare: Callable[[Any], Any], operands: Any, usual: Any) -> Any:
    """Return `rare(operands)` for steps with a rare event, and `usual` for all others.

    Args:
        met: Whether the step has met the event.
        rare: A pure function of the operands, not evaluated where no lane has met the event.
        operands: A pytree of arrays: everything that `rare` depends on.
        usual: Values for all other steps, with the structure that `rare` returns.
    """
    if not on_one_device():
        return jax.lax.cond(met, rare, lambda _: usual, operands)

    # Derivatives use the plain condition, because a custom batching rule has no derivative.
    condition = jax.custom_jvp(_condition(rare, 0))

    @condition.defjvp
    def _derivative(primals: Any, tangents: Any) -> Any:
        def plain(met: Array, operands: Any, usual: Any) -> Any:
            return jax.lax.cond(met, lambda: rare(operands), lambda: usual)

        return jax.jvp(plain, primals, tangents)

    return condition(met, operands, usual)


def on_one_device() -> bool:
    """Return whether all oscillators of a batch are on one device.

    Where JAX shares lanes among devices by itself, testing whether any lane met an event is a sum
    over the devices in every step, and the time loop is then no native call. Within `jax.shard_map`
    this does not happen, nor where a caller declares `unshared`.
    """
    lanes_unshared = _UNSHARED.get() or bool(jax.sharding.get_abstract_mesh().manual_axes)
    return lanes_unshared or jax.device_count() == 1


def _condition(rare: Callable[[Any], Any], depth: int) -> Callable[..., Any]:
    """Return the condition that `rare` is true for any oscillator of a batch.

    vmap adds an axis.
    """
    rare_of_lanes = rare
    for _ in range(depth):
        rare_of_lanes = jax.vmap(rare_of_lanes)

    @jax.custom_batching.custom_vmap
    def condition(met: Array, operands: Any, usual: Any) -> Any:
        def selected(operands: Any, usual: Any) -> Any:
            return jax.tree.map(
                lambda new, old: jnp.where(
                    jnp.expand_dims(met, tuple(range(met.ndim, new.ndim))), new, old
                ),
                rare_of_lanes(operands),
                usual,
            )

        return jax.lax.cond(jnp.any(met), selected, lambda _, usual: usual, operands, usual)

    @condition.def_vmap
    def _of_lanes(size: int, batched: Any, *arguments: Any) -> tuple[Any, Any]:
        arguments = jax.tree.map(
            lambda x, is_batched: x if is_batched else jnp.broadcast_to(x, (size, *jnp.shape(x))),
            arguments,
            tuple(batched),
        )
        values = _condition(rare, depth + 1)(*arguments)
        return values, jax.tree.map(lambda value: True, values)

    return condition
