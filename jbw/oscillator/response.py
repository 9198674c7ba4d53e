"""The response of an oscillator over time, to a sampled input or a function of time."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, TypedDict, Unpack, overload

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
from jaxtyping import Array, ArrayLike, Float

from jbw.oscillator.adjoint import Trajectory, solve
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
from jbw.oscillator.deepening import deep_enough
from jbw.oscillator.hold import HeldInput, Hold, held
from jbw.oscillator.law import Memory, count_guesses
from jbw.oscillator.modes.response import ModalOptions, StructureResponse, simulate_structure
from jbw.oscillator.modes.structure import Structure
from jbw.oscillator.oscillator import Joint, Oscillator, as_oscillator
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.periodic import steady_period
from jbw.oscillator.solver import StockScheme, sampled_input, solve_stock, stepping
from jbw.oscillator.step import State

Input = Float[Array | np.ndarray, "... time"] | HeldInput | Callable[[Array], ArrayLike]
# the input in the form that a simulation uses
_Input = Float[Array, "... time"] | HeldInput | Callable[[Array], ArrayLike]


class SimulateOptions(TypedDict, total=False):
    """The keyword arguments of `simulate`, for both kinds of joint."""

    hold: Hold
    initial: tuple[Scalar | Memory, ...]
    substeps: int
    periodic: bool
    num_samples: int | None
    solver: AbstractSolver | None
    controller: AbstractStepSizeController | None


class Response(eqx.Module):
    """The motion at the samples; sample 0 is the initial state.

    Attributes:
        t: Time [s].
        y: Displacement [m].
        v: Velocity [m/s].
        z: Force per unit mass of all laws with a memory, the hysteretic laws [N/kg].
        a: Acceleration [m/s^2].
        residual: For a periodic record, the remaining change of the state over one period, relative
            to its largest value; otherwise 0 [-].
        guesses: How often a law's memory was too short, so that its force may have been wrong for a
            time; 0 except for laws that remember many reversals [-].

    Examples:
        A tone of 1 N/kg at resonance moves a linear oscillator by 1 / (2 zeta omega_n^2):

        >>> import jbw; jbw.enable_x64()
        >>> import numpy as np
        >>> linear = jbw.Oscillator(omega_n=2 * np.pi * 16, zeta=0.01)
        >>> u = np.sin(2 * np.pi * np.arange(64) / 64)  # one period
        >>> motion = jbw.simulate(linear, u, fs=1024.0, hold="band_limited", periodic=True)
        >>> print(f"{1e3 * motion.y.max():.3f} mm, {motion.v.max():.4f} m/s")
        4.947 mm, 0.4974 m/s
    """

    t: Float[Array, " time"]
    y: Float[Array, "... time"]
    v: Float[Array, "... time"]
    z: Float[Array, "... time"]
    a: Float[Array, "... time"]
    residual: Float[Array, "..."]
    guesses: Float[Array, "..."]


@overload
def simulate(
    joint: Structure, u: Input, fs: float, **options: Unpack[SimulateOptions]
) -> StructureResponse: ...
@overload
def simulate(joint: Joint, u: Input, fs: float, **options: Unpack[SimulateOptions]) -> Response: ...
def simulate(
    joint: Joint | Structure,
    u: Input,
    fs: float,
    *,
    hold: Hold = "first",
    initial: tuple[Scalar | Memory, ...] = (0.0, 0.0),
    substeps: int = 1,
    periodic: bool = False,
    num_samples: int | None = None,
    solver: AbstractSolver | None = None,
    controller: AbstractStepSizeController | None = None,
) -> Response | StructureResponse:
    r"""Return the response of an oscillator to N samples of input, at the same N samples.

    $$\ddot y + 2\zeta\omega_n\dot y + k y + \sum F = u$$

    A sampled input is integrated by jbw's own step with the laws' exact moves (order 4 with
    Bouc-Wen's at nu = 1). The default is one step per sample; two are advised where gradients are
    taken. In all other cases a stock diffrax solver is used: the given one with `substeps` equal
    steps per sample or under an adaptive `controller`, or else Dopri8, adaptive to 1e-9. Leaves of
    the joint, of `initial` and of `u` before the time axis broadcast. The result is differentiable
    in the joint, `u` and `initial`, and works under jit, vmap, grad and jvp.

    A trajectory that diverges (possible where delta < |gamma|, or under a restoring force that
    softens without bound) is nan or inf from there on; an eager call raises.

    Args:
        joint: A `BoucWen`, an `Oscillator` with any laws, or a `Structure` of several modes.
        u: Input per unit mass at the samples [N/kg], or a function of time [s]. A `HeldInput` has
            its own polynomials, gain, `hold` and `periodic`, which are then used.
        fs: Sampling rate [Hz].
        hold: Input between the samples: "first" (lines), "zero" (u[n] on [n, n + 1)) or
            "band_limited" (local quintics through FFT slopes and curvatures).
        initial: (y [m], v [m/s]) at t = 0; if `periodic`, the first guess. If the laws do not start
            at rest, their memories follow: Z alone for Bouc-Wen, or a tuple with the memory of
            every law in the form of `Oscillator.at_rest`. For a `Structure`, (q, q') with one
            number per mode.
        substeps: Integration steps per sample interval.
        periodic: Whether u is one period of a steady test; then the steady state is returned.
        num_samples: Number of samples; needed for a callable input, otherwise the length of u.
        solver: Stock diffrax solver; None selects one as described above.
        controller: Diffrax step-size controller for a stock solver.

    Returns:
        The response at t = n / fs.

    Raises:
        ConfigError: An invalid option, or a float32 session.
        DataError: An input that is not finite or has no time axis.
        ModelError: An initial z that the joint cannot hold, a diverging trajectory, or a periodic
            record whose steady state was not found.

    Reference:
        Eqs. (1), (2).

    Examples:
        The logarithmic decrement of a free decay is 2 pi zeta:

        >>> import jbw; jbw.enable_x64()
        >>> import numpy as np
        >>> linear = jbw.Oscillator(omega_n=2 * np.pi * 16, zeta=0.01)
        >>> decay = jbw.simulate(linear, np.zeros(2048), fs=1024.0, initial=(1e-3, 0.0))
        >>> print(np.log(decay.y[0] / decay.y[64]).round(4))  # a period has 64 samples
        0.0628
    """
    if isinstance(joint, Structure):
        default = ConstantStepSize() if solver else PIDController(rtol=1e-9, atol=1e-12)
        stock = solver or Dopri8(), controller or default
        modal = ModalOptions(hold, substeps, periodic, num_samples, solver is None, *stock)
        return simulate_structure(joint, u, fs, initial, modal)
    oscillator = as_oscillator(joint)
    check_options(fs, hold, substeps, num_samples, callable(u))
    start = initial_state(oscillator, initial)
    warn_of_unbounded_law(oscillator)
    warn_of_negative_stiffness(oscillator)
    if isinstance(u, HeldInput):
        hold, periodic, num_samples = u.hold, u.periodic, u.samples.shape[-1]
    elif not callable(u):
        u = jnp.asarray(u, float)
        check_input(u, num_samples)
        num_samples = u.shape[-1]
    options = _Options(hold, substeps, periodic, num_samples or 0, solver, controller)

    def solved(oscillator: Oscillator, start: State) -> Response:
        args = jax.tree.map(lambda x: jnp.asarray(x, float), (oscillator, fs, start))
        return _simulate_batch(options, args[0], u, *args[1:])

    response = deep_enough(solved, oscillator, start)
    check_settled(response.residual)
    check_bounded(joint, response.y)
    warn_of_guesses(response.guesses)
    if solver is None and _is_stepped(oscillator) and not callable(u):
        warn_of_long_steps(fs, substeps, response.y, response.v)
    return response


class _Options(NamedTuple):
    """The options of `simulate` that are not arrays."""

    hold: Hold
    substeps: int
    periodic: bool
    num_samples: int
    solver: AbstractSolver | None
    controller: AbstractStepSizeController | None


@eqx.filter_jit
def _simulate_batch(
    options: _Options, joint: Oscillator, u: _Input, fs: Scalar, initial: State
) -> Response:
    """Simulate all combinations of joint, input and initial state in a batch."""
    source = u if callable(u) else held(u, options.hold, periodic=options.periodic)
    lead = () if callable(source) else source.gain.shape
    # An internal state may be an array (the sliders of `iwan5`), whose axes are not batch axes.
    starts, tree = jax.tree.flatten(initial)
    rest_shapes = [jnp.shape(leaf) for leaf in jax.tree.leaves((0.0, 0.0, joint.at_rest()))]
    shapes = [jnp.shape(leaf) for leaf in jax.tree.leaves(joint)]
    shapes += [x.shape[: x.ndim - len(rest)] for x, rest in zip(starts, rest_shapes, strict=True)]
    batch = jnp.broadcast_shapes(*shapes, lead)
    if not batch:
        return _simulate(options, joint, source, fs, initial)

    def lanes(leaf, *rest):
        return jnp.broadcast_to(leaf, (*batch, *rest)).reshape(-1, *rest)

    if lead:
        source = jax.tree.map(lambda x: lanes(x, *x.shape[len(lead) :]), source)

    def simulate_lane(joint, initial, record):
        return _simulate(options, joint, record if lead else source, fs, initial)

    joint = jax.tree.map(lanes, joint)
    starts = [lanes(x, *rest) for x, rest in zip(starts, rest_shapes, strict=True)]
    initial = jax.tree.unflatten(tree, starts)
    response = jax.vmap(simulate_lane)(joint, initial, source if lead else joint.omega_n)
    unflat = jax.tree.map(lambda x: x.reshape(*batch, *x.shape[1:]), response)
    return eqx.tree_at(lambda r: r.t, unflat, response.t[0])


def _is_stepped(joint: Oscillator) -> bool:
    """Return whether the exact step supports all laws."""
    return all(law.stepped for law in joint.laws)


def _simulate(
    options: _Options, joint: Oscillator, u: HeldInput | Callable, fs: Scalar, initial: State
) -> Response:
    """Return the response of one oscillator to one input."""
    # Times are computed inside the program, because a constant array would be compiled into it.
    t = jnp.arange(options.num_samples) / fs
    if callable(u):
        u_sampled = jnp.asarray(jax.vmap(u)(t))
        trajectory_from = partial(_stock, options, joint, lambda tau: u(tau / fs), fs)
    else:
        u_sampled = u.u
        if options.solver is None and _is_stepped(joint):
            steps = stepping(joint, fs * options.substeps, u.gain, u.pieces(options.substeps))
            trajectory_from = partial(solve, options.substeps, steps)
        else:
            trajectory_from = partial(_stock, options, joint, partial(sampled_input, u), fs)
    if options.periodic:
        memory_units = tuple(law.memory_unit(joint.omega_n) for law in joint.laws)
        unit = joint.omega_n, jnp.ones_like(joint.omega_n), memory_units
        (y, v, memory), residual = steady_period(
            trajectory_from, initial, unit, one_by_one=any(law.depth for law in joint.laws)
        )
    else:
        (y, v, memory), residual = trajectory_from(initial), jnp.zeros(())
    z, memoryless_force, guesses = jnp.zeros_like(y), jnp.zeros_like(y), jnp.zeros(())
    for law, law_memory in zip(joint.laws, memory, strict=True):
        force = law.force(y, v, law_memory)
        z, memoryless_force = (
            (z + force, memoryless_force) if law.remembers else (z, memoryless_force + force)
        )
        counts = jnp.broadcast_to(jnp.asarray(count_guesses(law, law_memory), float), y.shape)
        guesses = guesses + counts[-1] - counts[0]
    a = u_sampled - 2.0 * joint.zeta * joint.omega_n * v - joint.k * y - z - memoryless_force
    return Response(t, y, v, z, a, residual, guesses)


def _stock(
    options: _Options, joint: Oscillator, u: Callable, fs: Scalar, initial: State
) -> Trajectory:
    """Solve with a standard solver; a periodic trajectory includes the start of the next period."""
    default = ConstantStepSize() if options.solver else PIDController(rtol=1e-9, atol=1e-12)
    scheme = StockScheme(
        options.solver or Dopri8(), options.controller or default, options.substeps
    )
    num_samples = options.num_samples + 1 if options.periodic else options.num_samples
    return solve_stock(joint, u, num_samples, fs, initial, scheme)  # pyright: ignore[reportReturnType]


class MotionApart(NamedTuple):
    """The motion at the outputs of uncoupled modes: y, v and a as in a `Response`."""

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
    r"""Simulate uncoupled modes as separate oscillators, and add the motions at each output.

    $$y_o = \sum_i c_{oi}\, q_i, \qquad q_i \ \text{of oscillator}\ i\ \text{under}\ b_i u$$

    The options are those of `jbw.simulate`.
    """
    pairs = zip(oscillators, b, strict=True)
    motions = [simulate(oscillator, u.times(b_i), fs, **options) for oscillator, b_i in pairs]
    y, v, a = (
        c @ jnp.stack(rows) for rows in zip(*((q.y, q.v, q.a) for q in motions), strict=True)
    )
    return MotionApart(y, v, a, jnp.sum(jnp.stack([q.guesses for q in motions])))
