"""Time response of several modes with one joint to a sampled or callable input."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from diffrax import AbstractSolver, AbstractStepSizeController
from jaxtyping import Array, Float

from jbw.errors import ConfigError
from jbw.oscillator.checks import (
    check_bounded,
    check_input,
    check_options,
    check_settled,
    initial_state,
    warn_of_guesses,
    warn_of_long_steps,
    warn_of_negative_stiffness,
    warn_of_unbounded_law,
)
from jbw.oscillator.damper import Damper
from jbw.oscillator.deepening import deep_enough
from jbw.oscillator.hold import HeldInput, Hold, held
from jbw.oscillator.modes.adjoint import Trajectory, modal_solve
from jbw.oscillator.modes.step import ModalState, modal_stepping
from jbw.oscillator.modes.structure import Structure, admitted, require_sampled
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.periodic import steady_period
from jbw.oscillator.solver import StockScheme, sampled_input, solve_stock


class StructureResponse(eqx.Module):
    """Motion of a structure at the samples; sample 0 is the initial state.

    Attributes:
        t: Time [s].
        q: Modal coordinates [m].
        dq: Their velocities [m/s].
        x: Relative displacement of the joint, sum h_i q_i [m].
        z: Force of all laws with a memory, the hysteretic ones [N/kg].
        y: Outputs, sum c_i q_i [m].
        v: Velocities of the outputs [m/s].
        a: Accelerations of the outputs [m/s^2].
        residual: For a periodic record, what the state still changes over one period relative to
            its largest value in it; 0 otherwise [-].
        guesses: How often a law's memory was too short [-].
    """

    t: Float[Array, " time"]
    q: Float[Array, "*batch mode time"]
    dq: Float[Array, "*batch mode time"]
    x: Float[Array, "*batch time"]
    z: Float[Array, "*batch time"]
    y: Float[Array, "*channel time"]
    v: Float[Array, "*channel time"]
    a: Float[Array, "*channel time"]
    residual: Float[Array, "*batch"]
    guesses: Float[Array, "*batch"]


class ModalOptions(NamedTuple):
    """Arguments of `simulate` that are no arrays; `exact_step` where our own step is admitted."""

    hold: Hold
    substeps: int
    periodic: bool
    num_samples: int | None
    exact_step: bool
    solver: AbstractSolver
    controller: AbstractStepSizeController


def simulate_structure(
    structure: Structure, u: Any, fs: Scalar, initial: tuple, options: ModalOptions
) -> StructureResponse:
    """Response of a structure; `jbw.simulate` documents its arguments."""
    substeps, num_samples = options.substeps, options.num_samples
    check_options(fs, options.hold, substeps, num_samples, callable(u))  # pyright: ignore[reportArgumentType]
    stated_structure, structure = structure, admitted(structure)
    require_sampled(structure, fs, substeps)
    q, v, memory = initial_state(structure, initial)
    warn_of_unbounded_law(structure)
    warn_of_negative_stiffness(structure)
    if isinstance(u, HeldInput):
        options = options._replace(hold=u.hold, periodic=u.periodic)
        num_samples = u.samples.shape[-1]
    elif not callable(u):
        u = jnp.asarray(u, float)
        check_input(u, num_samples)
        num_samples = u.shape[-1]
    # Dampers need a second prediction of the velocity, which the joint's kernel does not make.
    exact_step = options.exact_step and not callable(u)
    exact_step = exact_step and all(
        law.stepped and not isinstance(law, Damper) for law in structure.laws
    )
    options = options._replace(num_samples=num_samples, exact_step=exact_step)
    start = _per_mode(q, structure), _per_mode(v, structure), memory

    def solved(structure: Structure, start: Any) -> StructureResponse:
        args = jax.tree.map(lambda x: jnp.asarray(x, float), (structure, fs, start))
        return _simulate_lanes(options, args[0], u, *args[1:])

    response = deep_enough(solved, structure, start)
    check_settled(response.residual)
    check_bounded(stated_structure, response.x)
    warn_of_guesses(response.guesses)
    if exact_step:
        speed = jnp.einsum("i,...it->...t", jnp.asarray(structure.h, float), response.dq)
        warn_of_long_steps(fs, substeps, response.x, speed)
    return response


@eqx.filter_jit
def _simulate_lanes(
    options: ModalOptions, structure: Structure, u: Any, fs: Scalar, initial: ModalState
) -> StructureResponse:
    """Response to every record of a batch of inputs."""
    if not callable(u):
        u = held(u, options.hold, periodic=options.periodic)
    if callable(u) or not u.gain.shape:
        return _simulate(options, structure, u, fs, initial)
    lead = u.gain.shape
    simulate_record = partial(_simulate, options, structure)
    records = jax.tree.map(lambda x: x.reshape(-1, *x.shape[len(lead) :]), u)
    lanes = jax.vmap(lambda record: simulate_record(record, fs, initial))(records)
    unflat = jax.tree.map(lambda x: x.reshape(*lead, *x.shape[1:]), lanes)
    return eqx.tree_at(lambda r: r.t, unflat, lanes.t[0])


def _per_mode(part: Any, structure: Structure) -> tuple[Array, ...]:
    """A start of every mode; one number is that of each."""
    num = jnp.shape(structure.omega_n)
    part = jnp.asarray(part, float)
    if part.ndim and part.shape != num:
        raise ConfigError(
            f"Argument `initial` must hold one number a mode, {num[0]}, but has {part.shape}."
        )
    return tuple(jnp.broadcast_to(part, num))


def _simulate(
    options: ModalOptions, structure: Structure, u: Any, fs: Scalar, initial: ModalState
) -> StructureResponse:
    """One structure under one input."""
    num_samples = options.num_samples or 0
    t = jnp.arange(num_samples) / fs
    if callable(u):
        u_sampled = jnp.asarray(jax.vmap(u)(t))
        trajectory_from = partial(_stock, options, structure, lambda tau: u(tau / fs), fs)
    else:
        u_sampled = u.u
        if options.exact_step:
            steps = modal_stepping(structure, u, fs, options.substeps)

            def trajectory_from(initial: ModalState) -> Trajectory:
                return jax.tree.map(lambda x: x[:: options.substeps], modal_solve(steps, initial))
        else:
            trajectory_from = partial(_stock, options, structure, partial(sampled_input, u), fs)
    residual = jnp.zeros(())
    if options.periodic:
        omega_n = tuple(structure.omega_n)  # pyright: ignore[reportArgumentType]
        memory_units = tuple(law.memory_unit(omega_n[0]) for law in structure.laws)
        unit = omega_n, tuple(jnp.ones_like(w) for w in omega_n), memory_units
        (q, dq, memory), residual = steady_period(trajectory_from, initial, unit)  # pyright: ignore[reportArgumentType]
    else:
        q, dq, memory = trajectory_from(initial)
    return _response_of(structure, t, u_sampled, (q, dq, memory), residual)


def _response_of(structure, t, u, trajectory, residual) -> StructureResponse:
    """Motion of the modes, the joint and the outputs along a trajectory."""
    q, dq, memory = jnp.stack(trajectory[0]), jnp.stack(trajectory[1]), trajectory[2]
    x, v = structure.h @ q, structure.h @ dq
    z, r, guesses = jnp.zeros_like(x), jnp.zeros_like(x), jnp.zeros(())
    for law, law_memory in zip(structure.laws, memory, strict=True):
        force = law.force(x, v, law_memory)
        z = z + force if law.remembers else z
        r = r + force - law.stiffness() * x
        counts = jnp.broadcast_to(jnp.asarray(law.guesses(law_memory), float), x.shape)
        guesses = guesses + counts[-1] - counts[0]
    ddq = _accelerations(structure, q, dq, r, u)
    c = structure.c
    return StructureResponse(t, q, dq, x, z, c @ q, c @ dq, c @ ddq, residual, guesses)


def _accelerations(structure: Structure, q, dq, r, u) -> Array:
    """Modal accelerations under the joint's remainder r and the input u [m/s^2]."""
    omega, zeta, p, b = (
        jnp.asarray(x).reshape(-1, *(1,) * (q.ndim - 1))
        for x in (structure.omega_n, structure.zeta, structure.p, structure.b)
    )
    return b * u - 2.0 * zeta * omega * dq - omega**2 * q - p * r


def oscillate_modes(structure: Structure, u: Scalar, state: Any) -> Any:
    """Rates of (q, q', memories) [per s], for every law."""
    q, v, memory = (*(jnp.stack(part) for part in state[:2]), state[2])
    x, dx = structure.h @ q, structure.h @ v
    pairs = list(zip(structure.laws, memory, strict=True))
    r = sum(
        (law.force(x, dx, law_memory) - law.stiffness() * x for law, law_memory in pairs), 0.0 * x
    )
    rates = tuple(law.rate(x, dx, law_memory) for law, law_memory in pairs)
    return state[1], tuple(_accelerations(structure, q, v, r, u)), rates


def _stock(options: ModalOptions, structure: Structure, u: Callable, fs: Scalar, initial: Any):
    """Trajectory through a stock solver; a periodic one goes on to the next period's start."""
    num = (options.num_samples or 0) + options.periodic
    scheme = StockScheme(options.solver, options.controller, options.substeps)
    return solve_stock(structure, u, num, fs, initial, scheme, oscillate_modes)
