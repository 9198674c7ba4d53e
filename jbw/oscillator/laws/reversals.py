r"""The reversals that a Masing law remembers: a shift register of scalars, the latest one first.

A branch begins at a reversal $(y_0, F_0)$. The oldest entry is where the virgin curve begins, the
one before it where that curve was left for the first time. A branch closes, so that it is forgotten
and the one it interrupted goes on, at the reversal $y_1$ before its own; the first branch after the
virgin curve at the mirror image of its own reversal. Closures are nested: a monotone move passes
them in order, any number of them.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float

from jbw.oscillator.parameters import Scalar

SIZE = 10  # even: forgotten reversals go in pairs
# A closure met to rounding is met: of the displacements that it is found from.
_ROUNDING = 1e-14

Entries = tuple[Scalar, ...]


class Reversals(NamedTuple):
    """Memory of a Masing law.

    Attributes:
        sense: Direction of motion, 1 or -1; 0 before the first motion.
        count: Number of reversals held, the beginning of the virgin curve included.
        lost: Whether reversals were given up for want of places, and not passed since.
        missed: How often such a reversal was then passed: the branch from there on is a guess.
        force: Force now [N/kg].
        slope: Slope of the force now, less that of rest [1/s^2].
        y: Displacements of the reversals [m].
        f: Forces there [N/kg].
    """

    sense: Scalar
    count: Scalar
    lost: Scalar
    missed: Scalar
    force: Scalar
    slope: Scalar
    y: Entries
    f: Entries

    @property
    def stretch(self) -> Scalar:
        """The branch is the virgin curve stretched by this: by 2 except for that curve itself."""
        return jnp.where(self.count < 1.5, 1.0, 2.0)


def at_rest() -> Reversals:
    """Nothing remembered."""
    none = (0.0,) * SIZE
    return Reversals(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, none, none)


def closing_place(memory: Reversals, first: int = 0) -> Scalar:
    """Displacement at which the branch from an entry closes, if the virgin curve lies behind [m]."""
    mirrored = 2.0 * memory.y[first + 1] - memory.y[first]
    return jnp.where(memory.count - first > 2.5, memory.y[first + 1], mirrored)


def closes(memory: Reversals, y: Scalar, first: int = 0) -> Bool[Array, "..."]:
    """Whether a motion to y closes the branch from an entry."""
    place = closing_place(memory, first)
    rounding = _ROUNDING * (jnp.abs(y) + jnp.abs(memory.y[first]))
    reached = memory.sense * (y - place) >= -rounding
    return jnp.asarray(reached & (memory.count - first > 1.5))


def headed(memory: Reversals, y: Scalar, dy: Scalar) -> Reversals:
    """Memory at y after turning into the direction of the next move, if that is another one."""
    turned = (memory.sense * dy < 0.0) | ((memory.sense == 0.0) & (dy != 0.0))
    full = turned & (memory.count > SIZE - 0.5)
    sense = jnp.where(dy == 0.0, memory.sense, jnp.where(dy < 0.0, -1.0, 1.0))
    return memory._replace(
        sense=stop_gradient(sense),
        count=stop_gradient(memory.count + jnp.where(full, -1.0, jnp.where(turned, 1.0, 0.0))),
        lost=stop_gradient(jnp.where(full, 1.0, memory.lost)),
        y=_pushed(memory.y, y, turned, full),
        f=_pushed(memory.f, memory.force, turned, full),
    )


def _pushed(
    entries: Entries, value: Scalar, turned: Bool[Array, "..."], full: Bool[Array, "..."]
) -> Entries:
    """Entries with one more in front.

    A full register keeps its two oldest, by which the virgin curve is found again, and gives up
    the pair before them.
    """
    kept = (*entries[: SIZE - 4], *entries[SIZE - 2 :], *entries[SIZE - 2 :])
    entries = tuple(jnp.where(full, a, b) for a, b in zip(kept, entries, strict=True))
    moved = (value, *entries[:-1])
    return tuple(jnp.where(turned, a, b) for a, b in zip(moved, entries, strict=True))


def closed(memory: Reversals, y: Scalar) -> tuple[Reversals, Scalar, Scalar]:
    """Memory after a move to y has passed its closures, how many entries that took, and the last.

    The entries that remain are the same, moved to the front.
    """
    popped, last, going = jnp.zeros_like(memory.count), memory.y[0], jnp.asarray(True)
    for first in range(0, SIZE - 1, 2):
        going = going & closes(memory, y, first)
        pair = memory.count - first > 2.5
        popped = popped + jnp.where(going, jnp.where(pair, 2.0, 1.0), 0.0)
        last = jnp.where(going, closing_place(memory, first), last)
    popped, count = stop_gradient((popped, memory.count - popped))
    # Down to the first reversal, or from one of the lost pair's side: the branch is a guess.
    bare = (memory.lost > 0.5) & (popped > 0.5) & (count < 2.5)
    after = memory._replace(
        count=count,
        lost=stop_gradient(jnp.where(bare, 0.0, memory.lost)),
        missed=stop_gradient(memory.missed + jnp.where(bare, 1.0, 0.0)),
        y=forward(memory.y, popped),
        f=forward(memory.f, popped),
    )
    return after, popped, last


def forward(entries: Entries, places: Scalar) -> Entries:
    """Entries moved to the front by a number of places, in steps of powers of two."""
    for step in (8, 4, 2, 1):
        far = places > step - 0.5
        places = places - jnp.where(far, float(step), 0.0)
        moved = (*entries[step:], *(0.0 * x for x in entries[:step]))
        entries = tuple(jnp.where(far, a, b) for a, b in zip(moved, entries, strict=True))
    return entries


def places_moved(before: Reversals, after: Reversals) -> tuple[Float[Array, "..."], Scalar]:
    """By how many places a step has moved its old entries to the front, and whether it gave up two.

    After the first place, which may hold a new entry: y_i after is y_(i + places) before.
    """
    full = (before.count > SIZE - 0.5) & (after.y[1] == before.y[0]) & (after.count < SIZE - 0.5)
    places = jnp.where(full, -1.0, before.count - after.count)
    return jnp.asarray(places), jnp.where(full, 1.0, 0.0)
