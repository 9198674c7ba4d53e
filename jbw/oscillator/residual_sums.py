r"""Sums over the residual of a record, computed in the time loop without storing the response.

$$r_n = d_n - x_n - \sum_k a_k J_{kn}, \qquad
  Q = \sum_n r_n^2, \quad s_k = \sum_n R_{kn} r_n, \quad p = \max_n |x_n|$$

A likelihood with white noise needs only these few numbers, not the response x. Writing 20,000
samples for each of many parameter sets, and reading them again, costs as much as the steps do.
"""

from functools import partial
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jbw.oscillator.adjoint import solve, unused_field
from jbw.oscillator.hold import HeldInput
from jbw.oscillator.law import packed, unpacked
from jbw.oscillator.oscillator import Oscillator
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.solver import HysteresisExact, Stepping, stepping
from jbw.oscillator.step import State


class Compared(eqx.Module):
    """A measured response, and weights R_k for sums over measured minus simulated response.

    All rows of weights begin at the first compared sample.

    Attributes:
        measured: Measured response d [m, m/s or m/s^2].
        directions: Rows J; a known multiple of each is subtracted from the residual.
        parts: These known multiples a.
        rows: Rows R; each sum s_k is the product of one row and the residual.
        order: Measured derivative: 0 for displacement, 1 velocity, 2 acceleration; static.
        first: First compared sample; static.
    """

    measured: Float[Array, " compared"]
    directions: Float[Array, "direction compared"]
    parts: Float[Array, " direction"]
    rows: Float[Array, "row compared"]
    order: int = eqx.field(static=True)
    first: int = eqx.field(static=True, default=0)


class Sums(NamedTuple):
    """The sum Q of squared residuals, the sums s_k with weights R_k, and the peak response p."""

    square: Float[Array, "..."]
    along: Float[Array, "... row"]
    peak: Float[Array, "..."]


# arguments of the time loop: solver steps, joint, samples of the input, and measured response
Task = tuple[Stepping, Oscillator, Float[Array, " time"], Compared]


def residual_sums(
    joint: Oscillator, source: HeldInput, fs: Scalar, substeps: int, compared: Compared
) -> Sums:
    """Return sums over the samples of a record's residual, differentiable in joint and gain.

    Args:
        joint: The oscillator; the exact step must support all of its laws.
        source: The input.
        fs: Sampling rate [Hz].
        substeps: Steps between samples.
        compared: The measured response and its rows.

    Returns:
        The sums; up to rounding those of the response of `jbw.simulate`.
    """
    steps = stepping(joint, fs * substeps, source.gain, source.pieces(substeps))
    return _sums(substeps, (steps, joint, source.u, compared))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _sums(substeps: int, task: Task) -> Sums:
    """Return the sums of residuals over the samples, accumulated in one time loop."""
    stepping, joint, force, compared = task
    rest = _at_rest(joint)
    none = jnp.zeros(())
    # Directions and weights are passed as tuples of arrays, because the loop would otherwise slice
    # an array in every step.
    compared = eqx.tree_at(
        lambda compared: (compared.directions, compared.rows, compared.parts),
        compared,
        tuple(map(tuple, (compared.directions, compared.rows, compared.parts))),
    )
    task = stepping, joint, force, compared
    square, along, peak = none, (none,) * len(compared.rows), none
    totals = _added(task, rest, jnp.zeros((), jnp.int32), (square, along, peak))
    state = packed(joint.laws, rest)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(unused_field),
        _Summing(substeps),
        t0=0.0,
        t1=stepping.num_steps / substeps,
        dt0=1.0 / substeps,
        y0=tuple(jax.tree.leaves((state, totals))),
        args=task,
        saveat=diffrax.SaveAt(t1=True),
        adjoint=diffrax.ForwardMode(),
        max_steps=stepping.num_steps,
        throw=False,
    )
    tree = jax.tree.structure((state, totals))
    # pyright: ignore
    _, (square, along, peak) = jax.tree.unflatten(tree, [x[-1] for x in solution.ys])  # pyright: ignore
    return Sums(square, jnp.stack(along) if along else jnp.zeros(0), peak)


@_sums.defjvp
def _sums_jvp(substeps, primals, tangents):
    return jax.jvp(partial(_of_trajectory, substeps), primals, tangents)


def _of_trajectory(substeps: int, task: Task) -> Sums:
    """Return the sums of residuals from stored states, in a form that can be differentiated."""
    stepping, joint, force, compared = task
    trajectory = solve(substeps, stepping, _at_rest(joint))
    response = response_of(joint, compared.order, trajectory, force)[compared.first :]
    residual = compared.measured - response - compared.parts @ compared.directions
    peak = jnp.max(jnp.abs(response))
    return Sums(jnp.sum(residual**2), compared.rows @ residual, peak)


def _at_rest(joint: Oscillator) -> State:
    none = jnp.zeros(())
    return none, none, jax.tree.map(lambda x: jnp.asarray(x, float), joint.at_rest())


def response_of(joint: Oscillator, order: int, state: Any, u: Any) -> Any:
    """Return displacement, velocity or acceleration (`order` 0, 1, 2) of one or more states."""
    y, v, memory = state
    if order < 2:
        return v if order else y
    return u - 2.0 * joint.zeta * joint.omega_n * v - joint.k * y - joint.force(y, v, memory)


def _added(task: Task, state: State, substep: Array, totals: Any, every: int = 1) -> Any:
    """Add the residual to the sums if a measured sample is compared at the end of this substep."""
    (_, joint, force, compared), (square, along, peak) = task, totals
    n = substep // every
    counts = (substep % every == 0) & (n >= compared.first)
    response = response_of(joint, compared.order, state, force[n])
    i = jnp.maximum(n - compared.first, 0)
    residual = compared.measured[i] - response
    for part, row in zip(compared.parts, compared.directions, strict=True):
        residual = residual - part * row[i]
    residual = jnp.where(counts, residual, 0.0)
    return (
        square + residual * residual,
        tuple(total + row[i] * residual for total, row in zip(along, compared.rows, strict=True)),
        jnp.maximum(peak, jnp.where(counts, jnp.abs(response), 0.0)),
    )


class _Summing(HysteresisExact):
    """A `HysteresisExact` solver that also sums the residual."""

    substeps: int

    def step(self, terms, t0, t1, y0, args: Task, *progress):
        """Advance by one substep, and add the residual at its end to the sums."""
        stepping, joint, _, compared = args
        rest = jax.tree.structure(packed(joint.laws, _at_rest(joint)))
        state, totals = y0[: rest.num_leaves], y0[rest.num_leaves :]
        ends, *_, following, result = super().step(terms, t0, t1, state, stepping, *progress)
        size = len(compared.rows)
        totals = totals[0], totals[1 : 1 + size], totals[1 + size]
        state = unpacked(joint.laws, jax.tree.unflatten(rest, ends))
        totals = _added(args, state, following, totals, self.substeps)
        y1 = (*ends, *jax.tree.leaves(totals))
        return y1, None, dict(y0=y0, y1=y1), following, result
