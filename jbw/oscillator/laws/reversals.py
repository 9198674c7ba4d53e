r"""The reversals that a Masing law remembers: a shift register, the latest one first.

A branch begins at a reversal $(y_0, F_0)$. The oldest entry is where the virgin curve begins, the
one before it where that curve was left for the first time. A branch closes, so that it is forgotten
and the one it interrupted goes on, at the reversal $y_1$ before its own; the first branch after the
virgin curve at the mirror image of its own reversal. Closures are nested: a monotone move passes
them in order, any number of them.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax.lax import dynamic_slice, stop_gradient
from jaxtyping import Array, Bool

from jbw.oscillator.kinks import kept
from jbw.oscillator.parameters import Scalar

SIZE = 10  # unless a law says more
# A closure met to rounding is met: of the displacements that it is found from.
_ROUNDING = 1e-14

# A tuple of scalars, or one array in a time loop, where a shuffle must cost little.
Entries = Any


class Stack(NamedTuple):
    """The reversals, and what is counted of them.

    Attributes:
        count: Number of reversals held, the beginning of the virgin curve included.
        lost: Whether reversals were given up for want of places, and not passed since.
        missed: How often the motion came back to them: the branch from there on may be a guess.
        y: Displacements of the reversals [m].
        f: Forces there [N/kg].
    """

    count: Scalar
    lost: Scalar
    missed: Scalar
    y: Entries
    f: Entries

    @classmethod
    def of(cls, places: Any) -> "Stack":
        """From all numbers in a row, a tuple or an array."""
        size = (len(places) - 3) // 2
        return cls(places[0], places[1], places[2], places[3 : 3 + size], places[3 + size :])

    @property
    def size(self) -> int:
        """Reversals that there is room for."""
        return len(self.y)

    def row(self) -> Any:
        """All numbers in a row."""
        counts = self.count, self.lost, self.missed
        if isinstance(self.y, tuple):
            return (*counts, *self.y, *self.f)
        return jnp.concatenate([jnp.stack(counts), self.y, self.f])


class Branch(NamedTuple):
    """Memory of a Masing law: the present branch and the force on it, and the reversals behind it.

    Attributes:
        sense: Direction of motion, 1 or -1; 0 before the first motion.
        stretch: The branch is the virgin curve stretched by this: 1 for that curve itself, else 2.
        y: Displacement at which the branch begins [m].
        f: Force there [N/kg].
        closure: Displacement at which it closes; out of reach for the virgin curve [m].
        force: Force now [N/kg].
        slope: Slope of the force now, less that of rest [1/s^2].
        stack: The reversals in a row, `Stack.row`; in a time loop one array, as it seldom changes.
    """

    sense: Scalar
    stretch: Scalar
    y: Scalar
    f: Scalar
    closure: Scalar
    force: Scalar
    slope: Scalar
    stack: Any


_OUT_OF_REACH = 1e3  # m


def nothing_remembered(size: int = SIZE) -> Branch:
    """Nothing remembered, with room for so many reversals."""
    return Branch(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, (0.0,) * (3 + 2 * size))


def with_room(memory: Branch, size: int) -> Branch:
    """A memory with room for more reversals; those that were given up are not found again."""
    stack = Stack.of(memory.stack)
    more = tuple(0.0 * stack.count for _ in range(size - stack.size))
    wider = stack._replace(y=(*stack.y, *more), f=(*stack.f, *more))
    return memory._replace(stack=wider.row())


def branch_of(sense: Scalar, stack: Stack) -> Branch:
    """The branch that the reversals leave, before its force is known."""
    none = 0.0 * stack.count
    place = jnp.where(stack.count > 1.5, _closing_place(stack, 0), sense * _OUT_OF_REACH)
    virgin = stack.count < 1.5
    stretch = stop_gradient(jnp.where(virgin, jnp.minimum(stack.count, 1.0), 2.0))
    return Branch(sense, stretch, stack.y[0], stack.f[0], place, none, none, stack.row())


def _closing_place(stack: Stack, first: int) -> Scalar:
    """Displacement at which the branch from an entry closes, where one lies behind it [m]."""
    mirrored = 2.0 * stack.y[first + 1] - stack.y[first]
    return jnp.where(stack.count - first > 2.5, stack.y[first + 1], mirrored)


def closes(sense: Scalar, y: Scalar, begin: Scalar, closure: Scalar) -> Bool[Array, "..."]:
    """Whether a motion to y closes a branch."""
    rounding = _ROUNDING * (jnp.abs(y) + jnp.abs(begin))
    return jnp.asarray(sense * (y - closure) >= -rounding)


def headed(sense: Scalar, stack: Stack, y: Scalar, f: Scalar, dy: Scalar) -> tuple[Scalar, Stack]:
    """Sense and reversals at (y, f) after turning into the next move, if that is the other way."""
    turned = jnp.asarray((sense * dy < 0.0) | ((sense == 0.0) & (dy != 0.0)))
    full = turned & jnp.asarray(stack.count > stack.size - 0.5)
    count = stack.count + jnp.where(full, -1.0, jnp.where(turned, 1.0, 0.0))
    pushed = Stack(
        stop_gradient(count),
        stop_gradient(jnp.where(full, 1.0, stack.lost)),
        stack.missed,
        _pushed(stack.y, y, turned, full),
        _pushed(stack.f, f, turned, full),
    )
    sense = jnp.where(dy == 0.0, sense, jnp.where(dy < 0.0, -1.0, 1.0))
    return stop_gradient(sense), pushed


def _pushed(
    entries: Entries, value: Scalar, turned: Bool[Array, "..."], full: Bool[Array, "..."]
) -> Entries:
    """Entries with one more in front.

    A full register keeps its two oldest, by which the virgin curve is found again, and gives up
    the pair before them.
    """
    if not isinstance(entries, tuple):
        front, none = jnp.asarray(value)[None], jnp.zeros(1)
        moved = jnp.concatenate([front, entries[:-1]])
        shortened = jnp.concatenate([front, entries[:-4], entries[-2:], none])
        return jnp.where(full, shortened, jnp.where(turned, moved, entries))
    moved = (value, *entries[:-1])
    shortened = (value, *entries[:-4], *entries[-2:], 0.0 * value)
    return tuple(
        jnp.where(full, b, jnp.where(turned, a, x))
        for a, b, x in zip(moved, shortened, entries, strict=True)
    )


def closed(sense: Scalar, stack: Stack, y: Scalar) -> tuple[Stack, Scalar, Scalar]:
    """Reversals after a move to y has passed its closures, how many that took, and the last place.

    The entries that remain are the same, moved to the front.
    """
    popped, last, going = jnp.zeros_like(stack.count), stack.y[0], jnp.asarray(True)
    for first in range(0, stack.size - 1, 2):
        place, pair = _closing_place(stack, first), stack.count - first > 2.5
        going = going & (stack.count - first > 1.5) & closes(sense, y, stack.y[first], place)
        popped = popped + jnp.where(going, jnp.where(pair, 2.0, 1.0), 0.0)
        last = jnp.where(going, place, last)
    popped, last = kept((stop_gradient(popped), last))
    count = stop_gradient(stack.count - popped)
    # With three entries left the place that closes the branch is given up, with two it is passed.
    edge = (stack.lost > 0.5) & (popped > 0.5) & (count < 3.5)
    passed = edge & (count < 2.5)
    after = Stack(
        count,
        stop_gradient(jnp.where(passed, 0.0, stack.lost)),
        stop_gradient(stack.missed + jnp.where(edge, 1.0, 0.0)),
        forward(stack.y, popped),
        forward(stack.f, popped),
    )
    return after, popped, last


def forward(entries: Entries, places: Scalar) -> Entries:
    """Entries moved to the front by a number of places, in steps of powers of two."""
    if not isinstance(entries, tuple):
        padded = jnp.concatenate([entries, jnp.zeros(len(entries))])
        return dynamic_slice(padded, (jnp.asarray(places, int),), (len(entries),))
    for step in (2**power for power in reversed(range(len(entries).bit_length()))):
        far = places > step - 0.5
        places = places - jnp.where(far, float(step), 0.0)
        moved = (*entries[step:], *(0.0 * x for x in entries[:step]))
        entries = tuple(jnp.where(far, a, b) for a, b in zip(moved, entries, strict=True))
    return entries
