"""Time response of the bolted joint's oscillator to a sampled or callable input."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import (
    AbstractSolver,
    AbstractStepSizeController,
    ConstantStepSize,
    Dopri8,
    PIDController,
)
from jaxtyping import Array, Float

from jbw.oscillator.adjoint import Trajectory, solve
from jbw.oscillator.admission import (
    check_bounded,
    check_input,
    check_options,
    check_settled,
    check_state,
)
from jbw.oscillator.exact_step import State
from jbw.oscillator.parameters import BoucWen, Scalar
from jbw.oscillator.periodic import steady_period
from jbw.oscillator.reconstruction import input_polynomials
from jbw.oscillator.solver import sampled_input, stepping
from jbw.oscillator.stock import solve_stock

Input = Float[Array, "... time"] | Callable[[Scalar], Scalar]


class Response(eqx.Module):
    """Motion at the samples; sample 0 is the initial state.

    Attributes:
        t: Time [s].
        y: Displacement [m].
        v: Velocity [m/s].
        z: Hysteretic force per unit mass [N/kg].
        a: Acceleration [m/s^2].
        residual: For a periodic record, what the state still changes over one period relative to
            its largest value in it; 0 otherwise [-].
    """

    t: Float[Array, " time"]
    y: Float[Array, "... time"]
    v: Float[Array, "... time"]
    z: Float[Array, "... time"]
    a: Float[Array, "... time"]
    residual: Float[Array, "..."]


def simulate(
    joint: BoucWen,
    u: Input,
    fs: float,
    *,
    hold: str = "first",
    initial: tuple[Scalar, Scalar, Scalar] = (0.0, 0.0, 0.0),
    substeps: int = 1,
    periodic: bool = False,
    num_samples: int | None = None,
    solver: AbstractSolver | None = None,
    controller: AbstractStepSizeController | None = None,
) -> Response:
    r"""Response of the oscillator, N samples in and N samples out.

    $$\ddot y + 2\zeta\omega_n\dot y + k y + Z = u$$

    A sampled input at nu = 1 goes through the hysteresis-exact step (order 4, one step a sample
    unless `substeps` says more; two are advised where gradients are taken). Everything else goes
    through a stock diffrax solver: the given one with `substeps` equal steps a sample or under an
    adaptive `controller`, or else Dopri8, adaptive to 1e-9. Leaves of the joint, of `initial` and
    of `u` before the time axis broadcast. Differentiable in the joint, `u` and `initial`; works
    under jit, vmap, grad and jvp.

    A trajectory that diverges (possible where delta < |gamma|) is nan or inf from there on; the
    eager call raises.

    Args:
        joint: Bouc-Wen parameters.
        u: Input per unit mass at the samples [N/kg], or a function of time [s].
        fs: Sampling rate [Hz].
        hold: Input between the samples: "first" (lines), "zero" (u[n] on [n, n + 1)) or
            "band_limited" (local quintics through FFT slopes and curvatures).
        initial: (y [m], v [m/s], z [N/kg]) at t = 0; the first guess when `periodic`.
        substeps: Integration steps per sample interval.
        periodic: Whether u is one period of a steady test: the steady state is returned.
        num_samples: Number of samples; needed for a callable input, otherwise the length of u.
        solver: Stock diffrax solver; None chooses.
        controller: Diffrax step-size controller for a stock solver.

    Returns:
        The response at t = n / fs.

    Raises:
        ConfigError: An option that cannot be meant, or a float32 session.
        DataError: An input that is not finite or has no time axis.
        ModelError: An initial z that the joint cannot hold, a diverging trajectory, or a periodic
            record whose steady state was not found.

    Reference:
        Eqs. (1), (2).
    """
    check_options(fs, hold, substeps, num_samples, callable(u))
    check_state(joint, initial)
    if not callable(u):
        u = jnp.asarray(u, float)
        check_input(u, num_samples)
    route = _Route(fs, hold, substeps, periodic, num_samples, solver, controller)
    response = _broadcast(partial(_simulate, route), joint, u, tuple(initial))
    check_bounded(joint, response.y)
    check_settled(response.residual)
    return response


class _Route(NamedTuple):
    """The options of `simulate` that are no arrays."""

    fs: Scalar
    hold: str
    substeps: int
    periodic: bool
    num_samples: int | None
    solver: AbstractSolver | None
    controller: AbstractStepSizeController | None


def _broadcast(one: Callable, joint: BoucWen, u: Input, initial: State) -> Response:
    """`one` over the common batch shape of the joint, the input and the initial state."""
    joint, initial = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), (joint, initial))
    shapes = [leaf.shape for leaf in jax.tree.leaves((joint, initial))]
    lead = () if callable(u) else u.shape[:-1]
    batch = jnp.broadcast_shapes(*shapes, lead)
    if not batch:
        return one(joint, u, initial)

    def lanes(leaf):
        return jnp.broadcast_to(leaf, batch).reshape(-1)

    joint, initial = jax.tree.map(lanes, (joint, initial))
    axis = None
    if lead:
        u = jnp.broadcast_to(u, (*batch, u.shape[-1])).reshape(-1, u.shape[-1])
        axis = 0
    if callable(u):
        response = jax.vmap(lambda joint, initial: one(joint, u, initial))(joint, initial)
    else:
        response = jax.vmap(one, in_axes=(0, axis, 0))(joint, u, initial)
    motion = (response.y, response.v, response.z, response.a)
    return Response(
        response.t[0],
        *(x.reshape(*batch, -1) for x in motion),
        response.residual.reshape(batch),
    )


def _simulate(route: _Route, joint: BoucWen, u: Input, initial: State) -> Response:
    """One oscillator under one input."""
    num_samples = route.num_samples if callable(u) else u.shape[-1]
    t = jnp.asarray(np.arange(num_samples) / route.fs)
    if callable(u):
        trajectory_from = partial(_stock, route, joint, lambda tau: u(tau / route.fs), num_samples)
        u_sampled = jax.vmap(u)(t)
    else:
        polynomials = input_polynomials(u, route.hold, periodic=route.periodic)
        u_sampled = u
        if route.solver is None and joint.nu == 1.0:
            steps = stepping(joint, polynomials, route.fs, route.substeps)
            trajectory_from = partial(solve, route.substeps, steps)
        else:
            held = partial(sampled_input, polynomials)
            trajectory_from = partial(_stock, route, joint, held, num_samples)
    if route.periodic:
        (y, v, z), residual = steady_period(trajectory_from, initial, joint.omega_n)
    else:
        (y, v, z), residual = trajectory_from(initial), jnp.zeros(())
    a = u_sampled - 2.0 * joint.zeta * joint.omega_n * v - joint.k * y - z
    return Response(t, y, v, z, a, residual)


def _stock(
    route: _Route, joint: BoucWen, u: Callable, num_samples: int, initial: State
) -> Trajectory:
    """Trajectory through a stock solver; a periodic one goes on to the next period's start."""
    default = ConstantStepSize() if route.solver else PIDController(rtol=1e-9, atol=1e-12)
    return solve_stock(
        joint,
        u,
        num_samples + 1 if route.periodic else num_samples,
        route.fs,
        initial,
        route.substeps,
        route.solver or Dopri8(),
        route.controller or default,
    )
