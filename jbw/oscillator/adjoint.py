r"""Derivatives of the hysteresis-exact solve: one function for forward and reverse mode.

The primal is the diffrax solve, its states saved at every substep. The tangent needs no second
solve: the derivatives of all steps at the saved states are independent of each other and are
taken for many steps at once; only the recurrence $\dot x_{n+1} = J_n \dot x_n + b_n$ with its
3 x 3 matrices is sequential. It is linear in the tangents, so JAX transposes it for `jax.grad`.
"""

from functools import partial

import diffrax
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jbw.oscillator.exact_step import ExactStep, Push, State, advance
from jbw.oscillator.solver import HysteresisExact, Stepping

Trajectory = tuple[Float[Array, " time"], Float[Array, " time"], Float[Array, " time"]]
# Steps that are differentiated at once: the intermediate arrays stay in the cache, and
# the memory of a gradient does not grow with the record.
_CHUNK = 128


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def solve(substeps: int, stepping: Stepping, initial: State) -> Trajectory:
    """States after every substep, differentiable in the stepping and the initial state.

    Args:
        substeps: Substeps per sample interval; they only set the unit of time.
        stepping: Constants of the step and the input's pushes.
        initial: (y, v, z) at the first sample.

    Returns:
        y [m], v [m/s], z [N/kg], `initial` first and then after every substep.
    """
    num_steps = stepping.push[0].shape[0]
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(_unused_field),
        HysteresisExact(),
        t0=0.0,
        t1=num_steps / substeps,
        dt0=1.0 / substeps,
        y0=initial,
        args=stepping,
        saveat=diffrax.SaveAt(t0=True, steps=True),
        adjoint=diffrax.ForwardMode(),
        max_steps=num_steps,
        throw=False,
    )
    return tuple(x[: num_steps + 1] for x in solution.ys)  # pyright: ignore


def _unused_field(tau, state, stepping):
    """Stands where diffrax wants a vector field; `HysteresisExact` steps by its `args` alone."""
    return state


@solve.defjvp
def _solve_jvp(substeps, primals, tangents):
    stepping, initial = primals
    trajectory = solve(substeps, stepping, initial)
    return trajectory, _tangent(stepping, trajectory, *tangents)


def _tangent(
    stepping: Stepping, trajectory: Trajectory, stepping_dot: Stepping, initial_dot: State
) -> Trajectory:
    """Tangent of the trajectory: chunks of steps one after another."""
    num_steps = trajectory[0].shape[0] - 1
    size = min(_CHUNK, num_steps)

    def chunks(x):
        return jnp.pad(x, (0, -num_steps % size)).reshape(-1, size)

    starts = tuple(chunks(x[:-1]) for x in trajectory)
    push, push_dot = (tuple(chunks(p) for p in s.push) for s in (stepping, stepping_dot))
    # One copy a lane: transposed, the lanes are summed once and not in every chunk.
    step_dot = jax.tree.map(lambda x: jnp.broadcast_to(x, (size,)), stepping_dot.step)

    @jax.checkpoint
    def chunk(x_dot, inputs):
        starts, push, push_dot = inputs
        linearised = jax.vmap(partial(_linearised, stepping.step))
        return jax.lax.scan(_recurrence, x_dot, linearised(starts, push, step_dot, push_dot))

    _, ys = jax.lax.scan(chunk, initial_dot, (starts, push, push_dot))

    def joined(first, following):
        return jnp.concatenate([jnp.asarray(first)[None], following.reshape(-1)[:num_steps]])

    y, v, z = (joined(*pair) for pair in zip(initial_dot, ys, strict=True))
    return y, v, z


def _linearised(
    step: ExactStep, start: State, push: Push, step_dot: ExactStep, push_dot: Push
) -> tuple[tuple[State, State, State], State]:
    """Columns of the matrix J_n, and the offset b_n, of one step."""

    def stepped(step, start, push):
        return advance(step, start, push, branch=False)

    none, unit = jnp.zeros_like(start[0]), jnp.ones_like(start[0])
    _, by_state = jax.linearize(lambda start: stepped(step, start, push), start)
    _, offset = jax.jvp(
        lambda step, push: stepped(step, start, push), (step, push), (step_dot, push_dot)
    )
    return (
        by_state((unit, none, none)),
        by_state((none, unit, none)),
        by_state((none, none, unit)),
    ), offset


def _recurrence(x_dot: State, inputs) -> tuple[State, State]:
    """One step of the tangent recurrence; matrices come column by column."""
    columns, offset = inputs
    y, v, z = (
        offset[i] + sum(column[i] * x for column, x in zip(columns, x_dot, strict=True))
        for i in range(3)
    )
    return (y, v, z), (y, v, z)
