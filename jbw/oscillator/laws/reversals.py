r"""The load reversals that a Masing law remembers, oldest first.

A branch begins at the last reversal $(y_n, F_n)$. The first entry is where the virgin curve begins,
the second where that curve was left for the first time. A branch closes at the reversal before its
own; it is then forgotten, and the branch that it interrupted continues. The first branch after the
virgin curve closes at the mirror image of its own reversal. Closures are nested: a monotone move
passes any number of them in order. The remaining reversals keep their places.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool

from jbw.kept_programs import returned
from jbw.oscillator.kinks import barrier
from jbw.oscillator.parameters import Scalar

SIZE = 10  # default number of load reversals that are remembered
# A loop counts as closed this far before its closing displacement, relative to the displacements.
_ROUNDING = 1e-14

# Entries of a stack: a tuple of scalars, or in a time loop one array, which is faster to copy.
Entries = Any


@returned
class Stack(NamedTuple):
    """The remembered load reversals with their counts.

    Attributes:
        count: Number of remembered reversals, including the beginning of the virgin curve.
        lost: Whether reversals were dropped for lack of places, and not passed since.
        missed: How often the motion returned to dropped reversals: the branch from there may be
            wrong.
        y: Displacements of the reversals [m].
        f: Forces at the reversals [N/kg].
    """

    count: Scalar
    lost: Scalar
    missed: Scalar
    y: Entries
    f: Entries


@returned
class Branch(NamedTuple):
    """The internal state of a Masing law: branch, force, and earlier load reversals.

    Attributes:
        sense: Direction of motion, 1 or -1; 0 before the first motion.
        stretch: Factor by which the virgin curve is stretched: 1 for the virgin curve itself, else
            2.
        y: Displacement at which the branch begins [m].
        f: Force at the beginning of the branch [N/kg].
        closure: Displacement at which the branch closes; out of reach for the virgin curve [m].
        force: Present force [N/kg].
        slope: Present slope of the force, minus that at rest [1/s^2].
        stack: Reversals; in a time loop as arrays, because they seldom change.
    """

    sense: Scalar
    stretch: Scalar
    y: Scalar
    f: Scalar
    closure: Scalar
    force: Scalar
    slope: Scalar
    stack: Stack


_OUT_OF_REACH = 1e3  # displacement [m] that no motion reaches


def nothing_remembered(size: int = SIZE) -> Branch:
    """Return the state before any motion, with storage for `size` load reversals."""
    none = (0.0,) * size
    return Branch(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, Stack(0.0, 0.0, 0.0, none, none))


def with_room(memory: Branch, size: int) -> Branch:
    """Return a state with storage for `size` load reversals; dropped reversals stay lost."""
    stack = memory.stack
    more = tuple(0.0 * stack.count for _ in range(size - len(stack.y)))
    return memory._replace(stack=stack._replace(y=(*stack.y, *more), f=(*stack.f, *more)))


def branch_of(sense: Scalar, stack: Stack) -> Branch:
    """Return the branch after the last load reversal; its present force and slope are zero."""
    none, last = 0.0 * stack.count, stack.count - 1.0
    behind = _closing_place(stack.y, stack.count)
    closure = jnp.where(stack.count > 1.5, behind, sense * _OUT_OF_REACH)
    stretch = stop_gradient(jnp.where(stack.count < 1.5, jnp.minimum(stack.count, 1.0), 2.0))
    return Branch(
        sense, stretch, _at(stack.y, last), _at(stack.f, last), closure, none, none, stack
    )


def closes(sense: Scalar, y: Scalar, begin: Scalar, closure: Scalar) -> Bool[Array, "..."]:
    """Return whether a motion to y closes a hysteresis loop."""
    rounding = _ROUNDING * (jnp.abs(y) + jnp.abs(begin))
    return jnp.asarray(sense * (y - closure) >= -rounding)


def headed(sense: Scalar, stack: Stack, y: Scalar, f: Scalar, dy: Scalar) -> tuple[Scalar, Stack]:
    """Return direction and load reversals at (y, f); a turn of the motion adds a load reversal."""
    turned = jnp.asarray((sense * dy < 0.0) | ((sense == 0.0) & (dy != 0.0)))
    full = turned & jnp.asarray(stack.count > len(stack.y) - 0.5)
    place = jnp.where(turned, stack.count - jnp.where(full, 2.0, 0.0), -1.0)
    pushed = Stack(
        stop_gradient(jnp.where(turned, place + 1.0, stack.count)),
        stop_gradient(jnp.where(full, 1.0, stack.lost)),
        stack.missed,
        _replaced(_shortened(stack.y, full), lambda i: i == place, y),
        _replaced(_shortened(stack.f, full), lambda i: i == place, f),
    )
    sense = jnp.where(dy == 0.0, sense, jnp.where(dy < 0.0, -1.0, 1.0))
    return stop_gradient(sense), pushed


def closed(sense: Scalar, stack: Stack, y: Scalar) -> tuple[Stack, Scalar, Scalar]:
    """Return the load reversals left after a move to y, and number and place of closed loops."""
    fixed_sense, fixed, end = stop_gradient((sense, stack, y))

    def going_on(count: Scalar) -> tuple[Scalar, Bool[Array, "..."]]:
        begin, place = _at(fixed.y, count - 1.0), _closing_place(fixed.y, count)
        return count, jnp.asarray(count > 1.5) & closes(fixed_sense, end, begin, place)

    def forget(at: tuple) -> tuple:
        count, going = at
        return going_on(count - jnp.where(going, jnp.where(count > 2.5, 2.0, 1.0), 0.0))

    shape = jnp.broadcast_shapes(*(jnp.shape(x) for x in (sense, stack.count, y, *stack.y)))
    begun = going_on(jnp.broadcast_to(fixed.count, shape))
    count, _ = barrier(jax.lax.while_loop(lambda at: jnp.any(at[1]), forget, begun))
    popped = fixed.count - count
    in_pairs = popped == 2.0 * jnp.floor(0.5 * popped)
    place = jnp.where(in_pairs, _at(stack.y, count), _mirrored(stack.y))
    # If at most three reversals remain on a stack that was full before, the reversal that closes
    # the branch was dropped from it.
    edge = (stack.lost > 0.5) & (popped > 0.5) & (count < 3.5)
    after = Stack(
        count,
        stop_gradient(jnp.where(edge & (count < 2.5), 0.0, stack.lost)),
        stop_gradient(stack.missed + jnp.where(edge, 1.0, 0.0)),
        _replaced(stack.y, lambda i: i >= count, 0.0),
        _replaced(stack.f, lambda i: i >= count, 0.0),
    )
    return after, popped, place


def _closing_place(y: Entries, count: Scalar) -> Scalar:
    """Return the displacement at which the last of `count` branches closes [m]."""
    return jnp.where(count > 2.5, _at(y, count - 2.0), _mirrored(y))


def _mirrored(entries: Entries) -> Scalar:
    """Return the displacement of the second load reversal, mirrored about the first [m].

    The first branch after the virgin curve closes there.
    """
    return 2.0 * entries[0] - entries[1]


def _at(entries: Entries, place: Scalar) -> Scalar:
    """Return a stack's entry at an index, or any entry if the stack does not use the index."""
    if not isinstance(entries, tuple):
        place = jnp.asarray(place, jnp.int32)
        return jax.lax.dynamic_index_in_dim(entries, place, keepdims=False)
    chosen = entries[0]
    for i, entry in enumerate(entries[1:], 1):
        chosen = jnp.where(place > i - 0.5, entry, chosen)
    return chosen


def _replaced(entries: Entries, chosen: Callable[[Any], Any], value: Scalar) -> Entries:
    if not isinstance(entries, tuple):
        return jnp.where(chosen(jnp.arange(len(entries))), value, entries)
    return tuple(jnp.where(chosen(i), value, entry) for i, entry in enumerate(entries))


def _shortened(entries: Entries, full: Bool[Array, "..."]) -> Entries:
    """Return a full stack without its second-oldest pair of load reversals.

    It keeps the two oldest entries, which determine the virgin curve, and drops the next pair.
    """
    if not isinstance(entries, tuple):
        shorter = jnp.concatenate([entries[:2], entries[4:], jnp.zeros(2)])
        return jnp.where(full, shorter, entries)
    shorter = (*entries[:2], *entries[4:], 0.0, 0.0)
    return tuple(jnp.where(full, a, b) for a, b in zip(shorter, entries, strict=True))
