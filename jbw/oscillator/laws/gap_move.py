r"""A monotone move of a joint with a gap: unloading, travel through the gap, contact.

A force Z unloads to zero over the travel $D_0 = \log(1 + (\gamma - \delta)|Z|/\alpha) /
(\gamma - \delta)$; then the gap is crossed, and the element loads on the other side.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool

from jbw.oscillator.kinks import signed
from jbw.oscillator.parameters import Scalar

Backlash = Any  # the law: an element behind a gap
Memory = tuple[Scalar, Scalar]  # force Z [N/kg] and position s in the gap [m]
_SERIES = 1e-3  # argument of log(1 + x) / x below which a series is used; its error is 2e-16


class Moved(NamedTuple):
    """A move in one direction: the internal state at its end, and the kinks of the force.

    Attributes:
        memory: Z and s at the end.
        released: Whether Z unloaded to zero.
        release: Travel until Z is zero [m].
        met: Whether the far contact was made.
        meeting: Travel until the far contact [m].
    """

    memory: Memory
    released: Bool[Array, "..."]
    release: Scalar
    met: Bool[Array, "..."]
    meeting: Scalar


def moved(law: Backlash, memory: Memory, dy: Scalar) -> Moved:
    """Return the state and the kinks of a joint with a gap, after a monotone move."""
    z, s = memory
    side = signed(1.0, dy)
    loaded = side * z < 0.0  # the force acts against the move
    length = jnp.abs(dy)
    release = jnp.where(loaded, unloading(law, jnp.where(loaded, jnp.abs(z), 0.0)), 0.0)
    released = loaded & (length > release)
    rest = jnp.where(loaded, jnp.maximum(length - release, 0.0), length)
    free = jnp.where(side * z > 0.0, 0.0, jnp.maximum(law.gap - side * s, 0.0))
    travel = jnp.minimum(rest, free)
    unloads = loaded & ~released
    meets = (free > 0.0) & (rest > free) & ~unloads
    # Travel of the element: the whole move if it unloads, else the move less the travel through the
    # gap.
    way = jnp.where(unloads, dy, side * jnp.maximum(rest - free, 0.0))
    z_1 = law.element.move(0.0, jnp.where(released, 0.0, z), way)
    z_1 = jnp.where(unloads & (z * z_1 < 0.0), 0.0, z_1)
    s_1 = jnp.where(unloads | (side * z > 0.0), s, s + side * travel)
    s_1 = jnp.where(meets, side * law.gap, s_1)
    return Moved((z_1, s_1), released, release, meets, release + free)


def unloading(law: Backlash, size: Scalar) -> Scalar:
    """Return the travel D_0 over which a force of magnitude `size` falls to zero [m]."""
    w = size / law.gap_stiffness
    x = (law.gap_opening - law.gap_softening) * w
    near = jnp.abs(x) < _SERIES
    far = jnp.where(near, 1.0, x)
    series = 1.0 - x * (1 / 2 - x * (1 / 3 - x * (1 / 4 - x * (1 / 5 - x / 6))))
    return w * jnp.where(near, series, jnp.log1p(far) / far)
