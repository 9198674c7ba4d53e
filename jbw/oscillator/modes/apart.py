r"""Uncoupled modes: each is an oscillator by itself, and the outputs are sums over them.

$$y_o = \sum_i c_{oi}\, q_i, \qquad q_i \ \text{of oscillator}\ i\ \text{under}\ b_i u$$
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jbw.oscillator.hold import HeldInput
from jbw.oscillator.oscillator import Oscillator
from jbw.oscillator.response import simulate


class MotionApart(NamedTuple):
    """Motion of the outputs, as `jbw.simulate` has it of one oscillator."""

    y: Float[Array, "*point time"]
    v: Float[Array, "*point time"]
    a: Float[Array, "*point time"]
    guesses: Float[Array, ""]


def simulate_apart(
    oscillators: Sequence[Oscillator],
    b: Sequence[Any],
    c: Float[Array, "*point mode"],
    u: HeldInput,
    fs: float,
    **options: Any,
) -> MotionApart:
    """Outputs c of modes that the input u moves by b each; options as `jbw.simulate` has them."""
    pairs = zip(oscillators, b, strict=True)
    motions = [simulate(oscillator, u.times(b_i), fs, **options) for oscillator, b_i in pairs]
    y, v, a = (
        c @ jnp.stack(rows) for rows in zip(*((q.y, q.v, q.a) for q in motions), strict=True)
    )
    return MotionApart(y, v, a, jnp.sum(jnp.stack([q.guesses for q in motions])))
