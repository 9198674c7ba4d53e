r"""Defaults of every law, from its force, its rate and its move alone.

Exact for no law, right for all whose force is continuous and odd and whose rate is proportional to
the velocity.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from jbw.oscillator.kinks import Ends, StepPath, kink_impulse, signed
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.steady.waveform import crest, exponentials, synthesis
from jbw.quantities import must_be
from jbw.report.messages import joint as messages

Law = Any  # a `jbw.oscillator.law.Law`, whose methods call these functions
Memory = Any

_MOVE_STEPS = 8  # along a monotone path
_LOOP_POINTS = 128  # moves of half a cycle
_PERIOD_POINTS = 512


def slope(law: Law, y: Scalar, memory: Memory, direction: Scalar) -> Scalar:
    """Slope dF/dy of a motion in a direction [1/s^2]."""
    like = jnp.broadcast_shapes(
        *(jnp.shape(x) for x in jax.tree.leaves((law, y, memory, direction)))
    )
    sign = signed(1.0, direction)
    y, sign, memory, rate = jax.tree.map(
        lambda x: jnp.broadcast_to(x, like).astype(float),
        (y, sign, memory, law.rate(y, sign, memory)),
    )
    _, rise = jax.jvp(
        lambda y, memory: jnp.asarray(law.force(y, sign, memory), float),
        (y, memory),
        (sign, rate),
    )
    return sign * rise


def move_by_rates(law: Law, y: Scalar, memory: Memory, dy: Scalar) -> Memory:
    """Memory after a monotone move by Runge and Kutta's rule of order 4 in eight steps."""
    step = dy / _MOVE_STEPS

    def moved(memory: Memory, slope: Memory, part: float) -> Memory:
        return jax.tree.map(lambda m, s: m + part * s, memory, slope)

    for index in range(_MOVE_STEPS if jax.tree.leaves(memory) else 0):
        here = y + index * step
        k_1 = law.rate(here, step, memory)
        k_2 = law.rate(here + 0.5 * step, step, moved(memory, k_1, 0.5))
        k_3 = law.rate(here + 0.5 * step, step, moved(memory, k_2, 0.5))
        k_4 = law.rate(here + step, step, moved(memory, k_3, 1.0))
        memory = jax.tree.map(
            lambda m, a, b, c, d: m + (a + 2.0 * b + 2.0 * c + d) / 6.0,
            memory, k_1, k_2, k_3, k_4,
        )  # fmt: skip
    return memory


def remainder_by_rates(
    law: Law, h: Scalar, y: Scalar, v: Scalar, memory: Memory
) -> tuple[Scalar, Scalar]:
    """Remainder F - K y and h times its rate, from the law's force and rate."""
    stiffness, rate = law.stiffness(), law.rate(y, v, memory)
    force, rise = jax.jvp(
        lambda y, memory: law.force(y, v, memory),
        (y, memory),
        (h * v, jax.tree.map(lambda x: h * x, rate)),
    )
    return force - stiffness * y, rise - stiffness * h * v


def bend_by_rates(
    law: Law, h: Scalar, state: tuple[Scalar, Scalar, Memory], a: Scalar, branch: Any
) -> Scalar:
    """Half of h^2 times the second derivative of the remainder, at an acceleration."""
    y, v, memory = state
    rate = jax.tree.map(lambda x: jnp.asarray(x, float), law.rate(y, v, memory))
    _, bend = jax.jvp(
        lambda y, v, memory: law.remainder(h, y, v, memory, branch)[1], state, (v, a, rate)
    )
    return 0.5 * h * bend


def turn_by_slopes(
    law: Law, y: Scalar, memory: Memory, ends: Ends, quartic: Scalar
) -> tuple[Memory, Scalar, Scalar]:
    """Two moves through a turning point, and the impulse of the slope's jump there."""
    path = StepPath.through(ends, quartic)
    top = y + path.before
    memory_at_top = law.move(y, memory, path.before)
    jump = slope(law, top, memory_at_top, path.after) - slope(law, top, memory_at_top, path.before)
    impulse = kink_impulse(1.0 - path.fraction, jnp.where(path.turns, jump * path.bend, 0.0), 0.0)
    return law.move(top, memory_at_top, path.after), impulse.v, impulse.y


def loop_by_moves(law: Law, y_peak: Scalar) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Equivalent stiffness and damping by the trapezium rule on half a cycle from the tip."""
    y_peak = jnp.asarray(y_peak, float)
    at_zero = y_peak == 0.0
    peak, stiffness = jnp.where(at_zero, 1.0, y_peak), law.stiffness()
    theta = jnp.linspace(0.0, jnp.pi, _LOOP_POINTS + 1)

    def remainder(y: Array, memory: Memory) -> Array:
        return law.force(y, 0.0 * y, memory) - stiffness * y

    def onward(memory: Memory, pair: Array) -> tuple[Memory, Array]:
        before, after = peak * pair[0], peak * pair[1]
        memory = law.move(before, memory, after - before)
        return memory, remainder(after, memory)

    like = jnp.broadcast_shapes(*(jnp.shape(x) for x in jax.tree.leaves((law, peak))))
    tip = jax.tree.map(lambda x: jnp.broadcast_to(x, like).astype(float), law.at_tip(peak))
    pairs = jnp.stack([jnp.cos(theta[:-1]), jnp.cos(theta[1:])], 1)
    _, rest = jax.lax.scan(onward, tip, pairs)
    force = jnp.concatenate([jnp.broadcast_to(remainder(peak, tip), like)[None], rest])
    weights = jnp.ones(theta.size).at[jnp.array([0, -1])].set(0.5) * 2.0 / _LOOP_POINTS
    real, imaginary = (
        jnp.where(at_zero, 0.0, jnp.tensordot(weights * wave, force, 1) / peak)
        for wave in (jnp.cos(theta), -jnp.sin(theta))
    )
    return stiffness + real, imaginary


def harmonics_by_moves(
    law: Law, q: Complex[Array, " harmonic"], max_turns: int
) -> Complex[Array, " harmonic"]:
    """Odd harmonics of the remainder on a uniform grid of half a period from the crest."""
    points = max(_PERIOD_POINTS, 32 * q.shape[0]) // 2
    theta = crest(q) + np.pi * np.arange(2 * points) / points
    r = law.force_over_period(q, theta, max_turns) - law.stiffness() * synthesis(q, theta)
    return 2.0 / points * (r[:points] @ exponentials(theta[:points], q.shape[0]).conj())


def force_by_moves(
    law: Law, q: Complex[Array, " harmonic"], theta: Float[Array, " time"]
) -> Float[Array, " time"]:
    """Force in the second of two periods, whose first sets the memory."""
    y, rise = synthesis(q, theta), synthesis(q, theta, 1)

    def onward(carry: tuple, point: tuple) -> tuple[tuple, Array]:
        (y, memory), (y_next, rise) = carry, point
        memory = law.move(y, memory, y_next - y)
        return (y_next, memory), law.force(y_next, rise, memory)

    start = jax.tree.map(lambda x: jnp.asarray(x, y.dtype), (0.0, law.at_rest()))
    settled, _ = jax.lax.scan(onward, start, (y, rise))
    return jax.lax.scan(onward, settled, (y, rise))[1]


def no_force(law: Law) -> str | None:
    """A warning of a parameter below its least value, or None; concrete values only."""
    parameters = law.parameters()
    for quantity in law.table:
        least = float(np.min(np.asarray(parameters[quantity.name])))
        if (must := must_be(quantity, least)) is not None:
            return messages.no_known_force(quantity.name, law.name, must, least)
    return None
