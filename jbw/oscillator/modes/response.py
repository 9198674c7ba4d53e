"""The response over time of several modes with joints, and the work of the joints."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver, AbstractStepSizeController
from jaxtyping import Array, Float
from numpy.polynomial import Polynomial

from jbw.errors import ConfigError
from jbw.oscillator.checks import (
    check_bounded,
    check_input,
    check_options,
    check_settled,
    initial_state,
    warn_of_guesses,
    warn_of_long_steps,
    warn_of_unbounded_law,
)
from jbw.oscillator.deepening import deep_enough
from jbw.oscillator.hold import HeldInput, Hold, held
from jbw.oscillator.law import count_guesses, laws_in, map_laws
from jbw.oscillator.modes.adjoint import Trajectory, modal_solve
from jbw.oscillator.modes.step import ModalState, ModalStepping, modal_stepping
from jbw.oscillator.modes.structure import (
    Structure,
    admitted,
    by_joint,
    first_frequency,
    require_sampled,
    warn_of_stiff_joints,
)
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.periodic import steady_period
from jbw.oscillator.solver import StockScheme, sampled_input, solve_stock
from jbw.oscillator.step import added, remainders


class StructureResponse(eqx.Module):
    """The motion of a structure of several modes at the samples; sample 0 is the initial state.

    The axis of joints exists if the structure's `h` has one row per joint.

    Attributes:
        t: Time [s].
        q: Modal coordinates [m].
        dq: Modal velocities [m/s].
        x: Relative displacement of every joint, sum h_i q_i [m].
        z: Force of all laws of a joint with a memory, the hysteretic laws [N/kg].
        r: Remainder of all laws of a joint, their force minus K x [N/kg].
        work: Work of r along x over the record or period: lost and stored energy of a joint [J/kg].
        y: Outputs, sum c_i q_i [m].
        v: Velocities of the outputs [m/s].
        a: Accelerations of the outputs [m/s^2].
        residual: For a periodic record, the remaining change of the state over one period, relative
            to its largest value; otherwise 0 [-].
        guesses: How often a law's memory was too short [-].
    """

    t: Float[Array, " time"]
    q: Float[Array, "*batch mode time"]
    dq: Float[Array, "*batch mode time"]
    x: Float[Array, "*batch_joint time"]
    z: Float[Array, "*batch_joint time"]
    r: Float[Array, "*batch_joint time"]
    work: Float[Array, "*batch_joint"]
    y: Float[Array, "*channel time"]
    v: Float[Array, "*channel time"]
    a: Float[Array, "*channel time"]
    residual: Float[Array, "*batch"]
    guesses: Float[Array, "*batch"]


class ModalOptions(NamedTuple):
    """The options of `simulate` for a structure of several modes."""

    hold: Hold
    substeps: int
    periodic: bool
    num_samples: int | None
    exact_step: bool  # whether jbw's own exact time step may replace the standard solver
    solver: AbstractSolver
    controller: AbstractStepSizeController


def simulate_structure(
    structure: Structure, u: Any, fs: Scalar, initial: tuple, options: ModalOptions
) -> StructureResponse:
    """Return the response of a structure; `jbw.simulate` documents its arguments."""
    substeps, num_samples = options.substeps, options.num_samples
    check_options(fs, options.hold, substeps, num_samples, callable(u))  # pyright: ignore[reportArgumentType]
    stated_structure, structure = structure, admitted(structure)
    require_sampled(structure, fs, substeps)
    q, v, memory = initial_state(structure, initial)
    warn_of_unbounded_law(structure)
    warn_of_stiff_joints(structure)
    if isinstance(u, HeldInput):
        options = options._replace(hold=u.hold, periodic=u.periodic)
        num_samples = u.samples.shape[-1]
    elif not callable(u):
        u = jnp.asarray(u, float)
        check_input(u, num_samples)
        num_samples = u.shape[-1]
    # With a velocity-dependent force, v must be predicted twice, which a joint's step does not do.
    exact_step = options.exact_step and not callable(u)
    exact_step = exact_step and all(
        law.stepped and not law.feels_rate for law in laws_in(structure.laws)
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
        warn_of_long_steps(fs, substeps, response.x, structure.h @ response.dq)
    return response


@eqx.filter_jit
def _simulate_lanes(
    options: ModalOptions, structure: Structure, u: Any, fs: Scalar, initial: ModalState
) -> StructureResponse:
    """Return the structure's response to every record of a batch of inputs."""
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
    """Return an initial value for each mode; a single number applies to all modes."""
    num = jnp.shape(structure.omega_n)
    part = jnp.asarray(part, float)
    if part.ndim and part.shape != num:
        raise ConfigError(
            f"Argument `initial` must have one number per mode, {num[0]}, but has {part.shape}."
        )
    return tuple(jnp.broadcast_to(part, num))


def _simulate(
    options: ModalOptions, structure: Structure, u: Any, fs: Scalar, initial: ModalState
) -> StructureResponse:
    """Return the response of one structure to one input."""
    is_one_joint = jnp.ndim(structure.h) == 1
    if is_one_joint:
        structure, initial = by_joint(structure), (*initial[:2], (initial[2],))
    t = jnp.arange(options.num_samples or 0) / fs
    if callable(u):
        u_sampled = jnp.asarray(jax.vmap(u)(t))
        solve = partial(_stock, options, structure, lambda tau: u(tau / fs), fs)
    else:
        u_sampled = u.u
        if options.exact_step:
            rate, pieces = fs * options.substeps, u.pieces(options.substeps)
            solve = partial(_stepped, options, modal_stepping(structure, rate, u.gain, pieces))
        else:
            solve = partial(_stock, options, structure, partial(sampled_input, u), fs)
    residual = jnp.zeros(())
    if options.periodic:
        omega_n = tuple(structure.omega_n)  # pyright: ignore[reportArgumentType]
        unit_frequency = first_frequency(structure)
        memory_units = map_laws(lambda law: law.memory_unit(unit_frequency), structure.laws)
        unit = omega_n, tuple(jnp.ones_like(w) for w in omega_n), memory_units
        states, residual = steady_period(lambda start: solve(start)[0], initial, unit)
        _, work_of = solve(jax.tree.map(lambda x: x[0], states))
    else:
        states, work_of = solve(initial)
    response = _response_of(structure, t, u_sampled, states, residual, work_of(structure))
    if not is_one_joint:
        return response
    one_joint = {name: getattr(response, name)[0] for name in ("x", "z", "r", "work")}
    return replace(response, **one_joint)


# The states at the samples, and a function for the work of every joint of a structure.
Solved = tuple[Trajectory, Callable[[Structure], Array]]


def _stepped(options: ModalOptions, steps: ModalStepping, initial: ModalState) -> Solved:
    """Simulate the motion by jbw's exact time step; return the states at the samples."""
    states, kicks = modal_solve(steps, initial)
    samples = jax.tree.map(lambda x: x[:: options.substeps], states)
    return (samples, lambda structure: work_of_joints(structure, steps, states, kicks))


def _response_of(structure, t, u, states, residual, work) -> StructureResponse:
    """Return the motion of modes, joints and outputs from the states over time."""
    q, dq, memories = jnp.stack(states[0]), jnp.stack(states[1]), states[2]
    x, v = structure.h @ q, structure.h @ dq
    z, r, guesses = [], [], jnp.zeros(())
    for j, (laws, memory) in enumerate(zip(structure.laws, memories, strict=True)):
        z_j, r_j = jnp.zeros_like(x[j]), jnp.zeros_like(x[j])
        for law, law_memory in zip(laws, memory, strict=True):
            force = law.force(x[j], v[j], law_memory)
            z_j = z_j + force if law.remembers else z_j
            r_j = r_j + force - law.stiffness() * x[j]
            counts = jnp.broadcast_to(jnp.asarray(count_guesses(law, law_memory), float), t.shape)
            guesses = guesses + counts[-1] - counts[0]
        z.append(z_j)
        r.append(r_j)
    z, r, c = jnp.stack(z), jnp.stack(r), structure.c
    ddq = accelerations(structure, q, dq, r, u)
    return StructureResponse(t, q, dq, x, z, r, work, c @ q, c @ dq, c @ ddq, residual, guesses)


def remainder_of(laws: Any, x: Scalar, dx: Scalar, memory: Any) -> Any:
    """Return the nonlinear force of a joint's laws, their force minus that of their stiffness."""
    pairs = zip(laws, memory, strict=True)
    return sum((law.force(x, dx, held) - law.stiffness() * x for law, held in pairs), 0.0 * x)


def output_of(structure: Any, c: Array, order: int, state: ModalState, u: Scalar) -> Scalar:
    """Return displacement, velocity or acceleration (`order` 0, 1, 2) of an output in one state.

    The `Structure` must have an axis of joints; the output's weights c are one number per mode.
    """
    q, v, memories = state
    if order < 2:
        return added(c[i] * x for i, x in enumerate(v if order else q))
    modes, h, p = range(len(q)), structure.h, structure.p
    pull: list[Any] = [0.0] * len(q)
    for j, (laws, memory) in enumerate(zip(structure.laws, memories, strict=True)):
        x, dx = (added(h[j, i] * part[i] for i in modes) for part in (q, v))
        r = remainder_of(laws, x, dx, memory)
        pull = [pull[i] + p[i, j] * r for i in modes]
    omega_n, zeta, b = structure.omega_n, structure.zeta, structure.b
    return added(
        c[i] * (b[i] * u - 2.0 * zeta[i] * omega_n[i] * v[i] - omega_n[i] ** 2 * q[i] - pull[i])
        for i in modes
    )


def oscillate_modes(structure: Structure, u: Scalar, state: Any) -> Any:
    """Return the time derivatives of (q, q', internal states) and of each joint's work [per s]."""
    (q, v, memories), _ = state
    q, v = jnp.stack(q), jnp.stack(v)
    x, dx = structure.h @ q, structure.h @ v

    def of_joint(laws: Any, x: Array, dx: Array, memory: Any) -> tuple[Array, Any]:
        rates = (law.rate(x, dx, held) for law, held in zip(laws, memory, strict=True))
        return remainder_of(laws, x, dx, memory), tuple(rates)

    joints = zip(structure.laws, x, dx, memories, strict=True)
    forces, rates = zip(*(of_joint(*joint) for joint in joints), strict=True)
    r = jnp.stack(forces)
    ddq = accelerations(structure, q, v, r, u)
    return (state[0][1], tuple(ddq), rates), tuple(r * dx)


def _stock(
    options: ModalOptions, structure: Structure, u: Callable, fs: Scalar, initial: ModalState
) -> Solved:
    """Simulate by a standard solver; a periodic motion includes the start of the next period."""
    num = (options.num_samples or 0) + options.periodic
    scheme = StockScheme(options.solver, options.controller, options.substeps)
    start = initial, tuple(jnp.zeros(()) for _ in structure.laws)
    states, works = solve_stock(structure, u, num, fs, start, scheme, oscillate_modes)
    return (states, lambda structure: jnp.stack([work[-1] for work in works]))


def _hermite(orders: tuple[int, int]) -> list[Polynomial]:
    """Return the Hermite polynomials on [0, 1], each with one end derivative of 1, the others 0.

    `orders` are the numbers of derivatives at the start and at the end.
    """
    size = sum(orders)
    rows = [
        [Polynomial.basis(power).deriv(order)(at) if order else Polynomial.basis(power)(at)
         for power in range(size)]
        for at, num in zip((0.0, 1.0), orders, strict=True)
        for order in range(num)
    ]  # fmt: skip
    return [Polynomial(column) for column in np.linalg.inv(np.array(rows, float)).T]


def _weights() -> np.ndarray:
    r"""Return the integrals $\int_0^1 R_k X_m' ds$ that give a step's work from its end values.

    R_k and X_m are the Hermite polynomials of the cubic (r, r') and of the quintic (x, x', x'').
    """
    r, x = _hermite((2, 2)), _hermite((3, 3))
    products = [[(polynomial * other.deriv()).integ() for other in x] for polynomial in r]
    table = np.array([[integral(1.0) - integral(0.0) for integral in row] for row in products])
    # Only the rise of x counts, because its value at the start does no work.
    return np.concatenate([table[:, 1:3], table[:, 3:]], axis=1)


# Rows: r, r' at the start and at the end. Columns: x', x'' at the start, rise, x', x'' at the end.
_WEIGHTS = _weights()


def work_of_joints(
    structure: Structure, stepping: ModalStepping, states: ModalState, kicks: Any
) -> Float[Array, " joint"]:
    r"""Return the work of each joint's force F - K x, $W_j = \int r_j \dot x_j dt$ [J/kg].

    Within a step r is the cubic H through r and its rate, and x is the quintic through x, v and a.
    The kicks (impulses) give the error of H at kinks,

    $$\int (r - H)\,v\,dt = -v_1 k_v + a_1 k_y$$

    Args:
        structure: Modes and joints, with an axis of joints.
        stepping: Constants and input of the steps.
        states: States at the start and after every step.
        kicks: Every joint's impulses on y and v in every step.
    """
    q, v = jnp.stack(states[0]), jnp.stack(states[1])
    gain, dt = stepping.gain, stepping.step.joints[0].dt
    u = gain * stepping.pieces[0], gain * sum(stepping.pieces)
    x, dx = structure.h @ q, structure.h @ v
    parts = [
        remainders(laws, dt, (x[j], dx[j], memory), _branches(laws, dx[j], memory))  # pyright: ignore
        for j, (laws, memory) in enumerate(zip(structure.laws, states[2], strict=True))
    ]
    r, rate = (jnp.stack(part) for part in zip(*parts, strict=True))
    start, end = (
        structure.h @ accelerations(structure, q[:, place], v[:, place], r[:, place], input_there)
        for place, input_there in zip((slice(-1), slice(1, None)), u, strict=True)
    )
    at = jnp.stack([r[:, :-1], rate[:, :-1], r[:, 1:], rate[:, 1:]])
    way = jnp.stack([dt * dx[:, :-1], dt**2 * start, jnp.diff(x), dt * dx[:, 1:], dt**2 * end])
    kick_y, kick_v = (jnp.stack(kick)[:, 1:] for kick in zip(*kicks, strict=True))
    smooth = jnp.einsum("kjt,km,mjt->j", at, _WEIGHTS, way)
    return smooth + jnp.sum(end * kick_y - dx[:, 1:] * kick_v, axis=-1)


def _branches(laws: Any, v: Array, memory: Any) -> tuple[Any, ...]:
    return tuple(law.branch(v, law_memory) for law, law_memory in zip(laws, memory, strict=True))


def accelerations(structure: Structure, q: Array, dq: Array, r: Array, u: Any) -> Array:
    """Return modal accelerations under the joints' forces r = F - K x and the input u [m/s^2]."""
    omega, zeta, b = (
        jnp.asarray(x).reshape(-1, *(1,) * (q.ndim - 1))
        for x in (structure.omega_n, structure.zeta, structure.b)
    )
    return (
        b * u
        - 2.0 * zeta * omega * dq
        - omega**2 * q
        - jnp.tensordot(jnp.asarray(structure.p), r, 1)
    )
