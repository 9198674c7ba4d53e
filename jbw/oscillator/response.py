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
    warn_of_long_steps,
    warn_of_unbounded_law,
)
from jbw.oscillator.exact_step import State
from jbw.oscillator.parameters import BoucWen, Scalar
from jbw.oscillator.periodic import steady_period
from jbw.oscillator.reconstruction import input_polynomials
from jbw.oscillator.solver import Stepping, sampled_input, stepping
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

    $$\ddot y + 2\zeta\omega_n\dot y + k y + Z + f(y) = u$$

    f is the joint's restoring force, if it has one. A sampled input at nu = 1 goes through the
    hysteresis-exact step (order 4, one step a sample unless `substeps` says more; two are advised
    where gradients are taken). Everything else goes through a stock diffrax solver: the given one
    with `substeps` equal steps a sample or under an adaptive `controller`, or else Dopri8,
    adaptive to 1e-9. Leaves of the joint, of `initial` and of `u` before the time axis broadcast.
    Differentiable in the joint, `u` and `initial`; works under jit, vmap, grad and jvp.

    A trajectory that diverges (possible where delta < |gamma|, or under a restoring force that
    softens without bound) is nan or inf from there on; the
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
    warn_of_unbounded_law(joint)
    if not callable(u):
        u = jnp.asarray(u, float)
        check_input(u, num_samples)
        num_samples = u.shape[-1]
    options = _Options(hold, substeps, periodic, num_samples or 0, solver, controller)
    joint, fs, start = jax.tree.map(lambda x: jnp.asarray(x, float), (joint, fs, initial))
    response = _simulate_batch(options, joint, u, fs, start)
    check_settled(response.residual)
    check_bounded(joint, response.y)
    if solver is None and joint.nu == 1.0 and not callable(u):
        warn_of_long_steps(fs, substeps, response.y, response.v)
    return response


class _Options(NamedTuple):
    """What is no array among the arguments of `simulate`."""

    hold: str
    substeps: int
    periodic: bool
    num_samples: int
    solver: AbstractSolver | None
    controller: AbstractStepSizeController | None


@eqx.filter_jit
def _simulate_batch(
    options: _Options, joint: BoucWen, u: Input, fs: Scalar, initial: State
) -> Response:
    """Response over the common batch shape of the joint, the input and the initial state."""
    lead = () if callable(u) else u.shape[:-1]
    shapes = [jnp.shape(leaf) for leaf in jax.tree.leaves((joint, initial))]
    batch = jnp.broadcast_shapes(*shapes, lead)
    if not batch:
        return _simulate(options, joint, u, fs, initial)

    def lanes(leaf, *rest):
        return jnp.broadcast_to(leaf, (*batch, *rest)).reshape(-1, *rest)

    if not callable(u) and lead:
        u = lanes(u, u.shape[-1])

    def one(joint, initial, own):
        return _simulate(options, joint, own if lead else u, fs, initial)

    joint, initial = jax.tree.map(lanes, (joint, initial))
    response = jax.vmap(one)(joint, initial, u if lead else joint.omega_n)
    unflat = jax.tree.map(lambda x: x.reshape(*batch, *x.shape[1:]), response)
    return eqx.tree_at(lambda r: r.t, unflat, response.t[0])


def _simulate(options: _Options, joint: BoucWen, u: Input, fs: Scalar, initial: State) -> Response:
    """One oscillator under one input."""
    t = jnp.asarray(np.arange(options.num_samples) / fs)
    if callable(u):
        u_sampled = jnp.asarray(jax.vmap(u)(t))
        trajectory_from = partial(_stock, options, joint, lambda tau: u(tau / fs), fs)
    else:
        u_sampled = u
        polynomials = input_polynomials(u, options.hold, periodic=options.periodic)
        if options.solver is None and joint.nu == 1.0:
            steps = stepping(joint, polynomials, fs, options.substeps)
            trajectory_from = partial(_exact, options.substeps, steps)
        else:
            held = partial(sampled_input, polynomials)
            trajectory_from = partial(_stock, options, joint, held, fs)
    if options.periodic:
        (y, v, z), residual = steady_period(trajectory_from, initial, joint.omega_n)
    else:
        (y, v, z), residual = trajectory_from(initial), jnp.zeros(())
    a = u_sampled - 2.0 * joint.zeta * joint.omega_n * v - joint.k * y - z
    if joint.restoring is not None:
        a = a - joint.restoring(y)
    return Response(t, y, v, z, a, residual)


def _exact(substeps: int, steps: Stepping, initial: State) -> Trajectory:
    """Trajectory by the hysteresis-exact step, at the samples."""
    y, v, z = (x[::substeps] for x in solve(substeps, steps, initial))
    return y, v, z


def _stock(
    options: _Options, joint: BoucWen, u: Callable, fs: Scalar, initial: State
) -> Trajectory:
    """Trajectory through a stock solver; a periodic one goes on to the next period's start."""
    default = ConstantStepSize() if options.solver else PIDController(rtol=1e-9, atol=1e-12)
    return solve_stock(
        joint,
        u,
        options.num_samples + 1 if options.periodic else options.num_samples,
        fs,
        initial,
        options.substeps,
        options.solver or Dopri8(),
        options.controller or default,
    )
