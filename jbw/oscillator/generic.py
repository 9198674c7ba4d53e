r"""Default methods of a law, computed from its force and the rate of its internal state.

They are exact for no law, but valid for every law with an odd force and a memory whose rate is
proportional to the velocity.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Complex, Float

from jbw.oscillator.kinks import Ends, StepPath, kink_impulse, signed
from jbw.oscillator.parameters import SLOW, Scalar
from jbw.oscillator.steady.waveform import crest, exponentials, synthesis
from jbw.quantities import must_be
from jbw.report.messages import joint as messages

Law = Any  # a `jbw.oscillator.law.Law`; the functions of this module are its methods
Memory = Any

_MOVE_STEPS = 8  # Runge-Kutta steps per monotone move
_LOOP_POINTS = 128  # number of moves along half a hysteresis loop
_PERIOD_POINTS = 512


@lru_cache(maxsize=1024)
def feels_rate(force: Callable[..., Any], form: Any, shapes: tuple) -> bool:
    """Return whether the force of a law of the given pytree structure depends on the speed.

    A force that depends only on the sign of v has no such slope: it is equal in fast and slow
    motion.
    """
    is_felt = False

    @jax.custom_jvp
    def watched(value: Array) -> Array:
        return value

    def rule(primals: tuple, tangents: tuple) -> tuple[Any, Any]:
        nonlocal is_felt
        is_felt = not isinstance(tangents[0], SymbolicZero)
        return primals[0], tangents[0]

    watched.defjvp(rule, symbolic_zeros=True)

    def changed(v: Array) -> Array:
        law = jax.tree.unflatten(form, [jnp.ones(shape) for shape in shapes])
        return watched(jnp.asarray(force(law, 1.0, v, _memory_at_rest(law))))

    jax.eval_shape(lambda v: jax.jvp(changed, (v,), (v,)), jnp.ones(()))
    return is_felt


def _memory_at_rest(law: Law) -> Memory:
    return jax.tree.map(lambda x: jnp.asarray(x, float), law.at_rest())


def drag(law: Law, y: Scalar, v: Scalar, memory: Memory) -> Scalar:
    """Return the slope dF/dv of a law's force [1/s]."""
    return jax.jvp(lambda v: law.force(y, v, memory), (v,), (jnp.ones_like(v),))[1]


def drag_at_rest(law: Law) -> Scalar:
    """Return the slope dF/dv of a law's force before any motion [1/s]."""
    none = jnp.zeros(jnp.broadcast_shapes(*(jnp.shape(leaf) for leaf in jax.tree.leaves(law))))
    return drag(law, none, none, _memory_at_rest(law))


def slope(law: Law, y: Scalar, memory: Memory, direction: Scalar) -> Scalar:
    """Return the slope dF/dy of a law's force for motion in a given direction [1/s^2]."""
    like = jnp.broadcast_shapes(
        *(jnp.shape(x) for x in jax.tree.leaves((law, y, memory, direction)))
    )
    sign = signed(1.0, direction)
    y, sign, memory, rate = jax.tree.map(
        lambda x: jnp.broadcast_to(x, like).astype(float),
        (y, sign, memory, law.rate(y, sign, memory)),
    )
    _, rise = jax.jvp(
        lambda y, memory: jnp.asarray(law.force(y, SLOW * sign, memory), float),
        (y, memory),
        (sign, rate),
    )
    return sign * rise


def move_by_rates(law: Law, y: Scalar, memory: Memory, dy: Scalar) -> Memory:
    """Return the internal state after a monotone move, by eight Runge-Kutta steps of order 4."""
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
    """Return the nonlinear force r = F - K y, and its rate times the time step h."""
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
    """Return h^2/2 times the second time derivative of r = F - K y, at an acceleration a."""
    y, v, memory = state
    rate = jax.tree.map(lambda x: jnp.asarray(x, float), law.rate(y, v, memory))
    _, bend = jax.jvp(
        lambda y, v, memory: law.remainder(h, y, v, memory, branch)[1], state, (v, a, rate)
    )
    return 0.5 * h * bend


def turn_by_slopes(
    law: Law, y: Scalar, memory: Memory, ends: Ends, quartic: Scalar
) -> tuple[Memory, Scalar, Scalar]:
    """Return the internal state after a reversal, and the changes of v and y due to the kink."""
    path = StepPath.through(ends, quartic)
    top = y + path.before
    memory_at_top = law.move(y, memory, path.before)
    jump = slope(law, top, memory_at_top, path.after) - slope(law, top, memory_at_top, path.before)
    impulse = kink_impulse(1.0 - path.fraction, jnp.where(path.turns, jump * path.bend, 0.0), 0.0)
    return law.move(top, memory_at_top, path.after), impulse.v, impulse.y


def loop_by_moves(
    law: Law, y_peak: Scalar, omega: Scalar
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Return the equivalent stiffness and damping of a loop, by the trapezoidal rule."""
    y_peak = jnp.asarray(y_peak, float)
    at_zero = y_peak == 0.0
    peak, stiffness = jnp.where(at_zero, 1.0, y_peak), law.stiffness()
    theta = jnp.linspace(0.0, jnp.pi, _LOOP_POINTS + 1)

    def remainder(y: Array, v: Any, memory: Memory) -> Array:
        return law.force(y, v, memory) - stiffness * y

    def onward(memory: Memory, point: Array) -> tuple[Memory, Array]:
        before, after, v = peak * point[0], peak * point[1], omega * peak * point[2]
        memory = law.move(before, memory, after - before)
        return memory, remainder(after, v, memory)

    like = jnp.broadcast_shapes(*(jnp.shape(x) for x in jax.tree.leaves((law, peak, omega))))
    tip = jax.tree.map(lambda x: jnp.broadcast_to(x, like).astype(float), law.at_tip(peak))
    points = jnp.stack([jnp.cos(theta[:-1]), jnp.cos(theta[1:]), -jnp.sin(theta[1:])], 1)
    _, rest = jax.lax.scan(onward, tip, points)
    first = jnp.broadcast_to(remainder(peak, 0.0 * peak, tip), like)
    force = jnp.concatenate([first[None], rest])
    weak = omega * drag_at_rest(law) if law.feels_rate else 0.0
    weights = jnp.ones(theta.size).at[jnp.array([0, -1])].set(0.5) * 2.0 / _LOOP_POINTS
    real, imaginary = (
        jnp.where(at_zero, limit, jnp.tensordot(weights * wave, force, 1) / peak)
        for wave, limit in ((jnp.cos(theta), 0.0), (-jnp.sin(theta), weak))
    )
    return stiffness + real, imaginary


def harmonics_by_moves(
    law: Law, q: Complex[Array, " harmonic"], max_turns: int, omega: Scalar
) -> Complex[Array, " harmonic"]:
    """Return the odd harmonics of the force's nonlinear part, from a grid over half a period."""
    points = max(_PERIOD_POINTS, 32 * q.shape[0]) // 2
    theta = crest(q) + np.pi * np.arange(2 * points) / points
    r = law.force_over_period(q, theta, max_turns, omega) - law.stiffness() * synthesis(q, theta)
    return 2.0 / points * (r[:points] @ exponentials(theta[:points], q.shape[0]).conj())


def force_by_moves(
    law: Law, q: Complex[Array, " harmonic"], theta: Float[Array, " time"], omega: Scalar
) -> Float[Array, " time"]:
    """Return the steady force in a motion's second period, because the first sets the memory."""
    y, v = synthesis(q, theta), omega * synthesis(q, theta, 1)

    def onward(carry: tuple, point: tuple) -> tuple[tuple, Array]:
        (y, memory), (y_next, v_next) = carry, point
        memory = law.move(y, memory, y_next - y)
        return (y_next, memory), law.force(y_next, v_next, memory)

    start = jax.tree.map(lambda x: jnp.asarray(x, y.dtype), (0.0, law.at_rest()))
    settled, _ = jax.lax.scan(onward, start, (y, v))
    return jax.lax.scan(onward, settled, (y, v))[1]


def no_force(law: Law) -> str | None:
    """Return a warning if a parameter is below its smallest allowed value."""
    parameters = law.parameters()
    for quantity in law.table:
        least = float(np.min(np.asarray(parameters[quantity.name])))
        if (must := must_be(quantity, least)) is not None:
            return messages.no_known_force(quantity.name, law.name, must, least)
    return None
