r"""Time integration of the oscillator by jbw's own step, or by standard solvers.

Time is counted in samples, $\tau = t f_s$, so that no rounding of 1/fs accumulates over a record.
`HysteresisExact` steps with the laws' own moves; stock solvers integrate `oscillate`.
"""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.oscillator.hold import HeldInput
from jbw.oscillator.law import packed
from jbw.oscillator.oscillator import Oscillator
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.step import ExactStep, Push, State, added, advance, exact_step

# The constants of a time step, and the effect of the input in every substep.
Pushed = tuple[Any, Any]
# An adaptive solver fails if it needs more than this number of steps per sample, on average.
_MAX_STEPS_PER_SAMPLE = 64


class Stepping(eqx.Module):
    r"""The constants and the input for the exact time steps of one record.

    $$p = g \sum_j W_j c_j$$

    Attributes:
        step: Constants of the step.
        on_y: Effect of each power of the input's polynomial on y in a substep, g W_j [s^2].
        on_v: Effect of each power on v [s].
        gain: Gain g of the input.
        pieces: Coefficients c_j of the input in every substep, one row per power.
    """

    step: ExactStep
    on_y: tuple[Scalar, ...]
    on_v: tuple[Scalar, ...]
    gain: Scalar
    pieces: tuple[Float[Array, " substep"], ...]

    @property
    def num_steps(self) -> int:
        """The number of substeps of the record."""
        return self.pieces[0].shape[0]

    def push(self, powers: tuple[Scalar, ...]) -> Push:
        """Return the effect of an input polynomial on y [m] and v [m/s], and the input [N/kg]."""
        start = self.gain * powers[0]
        # The time loop is one native call only if it contains no small dot products.
        on_y, on_v = (
            added(weight * power for weight, power in zip(weights, powers, strict=True))
            for weights in (self.on_y, self.on_v)
        )
        return (on_y, on_v, start, *([self.gain * added(powers)] if self._is_damped else []))

    def onward(self, state: State, powers: tuple[Scalar, ...]) -> State:
        """Return the state after a substep, from the input's polynomial in the substep."""
        return advance(self.step, state, self.push(powers), kinks="met")

    def pushed(self) -> Pushed:
        """Return the constants of a step, and the effect of the input in all substeps at once."""
        count = len(self.pieces)
        weights = [
            jnp.stack(self.on_y), jnp.stack(self.on_v), self.gain * np.eye(1, count)[0],
            *([self.gain * np.ones(count)] if self._is_damped else []),
        ]  # fmt: skip
        return self.step, tuple(jnp.stack(weights) @ jnp.stack(self.pieces))

    @property
    def _is_damped(self) -> bool:
        """Whether a law needs the input at the end of a substep, as velocity-dependent laws do."""
        return any(law.feels_rate for law in self.step.laws)


def stepping(
    oscillator: Oscillator, rate: Scalar, gain: Scalar, pieces: tuple[Any, ...]
) -> Stepping:
    """Return the time steps of an oscillator, `rate` of them per second.

    The input is the gain times polynomials with the coefficients `pieces`, one row per power.
    """
    step, *both = exact_step(oscillator, 1.0 / rate)
    on_y, on_v = (tuple(gain * moments[j] for j in range(len(pieces))) for moments in both)
    return Stepping(step, on_y, on_v, gain, pieces)


def sampled_input(held: HeldInput, tau: Scalar) -> Scalar:
    """Return the input [N/kg] at the time tau, in samples."""
    num_powers, num_intervals = held.polynomials.shape
    interval = jnp.clip(jnp.floor(tau).astype(jnp.int32), 0, num_intervals - 1)
    s = tau - interval
    value = held.polynomials[-1, interval]
    for power in range(num_powers - 2, -1, -1):
        value = value * s + held.polynomials[power, interval]
    return held.gain * value


def oscillate(oscillator: Oscillator, u: Scalar, state: State) -> State:
    r"""Return the time derivatives of (y, v, internal states) of an oscillator [per s].

    $$\dot v = u - 2\zeta\omega_n v - k y - \sum F$$

    Reference:
        Eqs. (1), (39).
    """
    y, v, memory = state
    damping = 2.0 * oscillator.zeta * oscillator.omega_n
    dv = u - damping * v - oscillator.k * y - oscillator.force(y, v, memory)
    rates = (
        law.rate(y, v, law_memory) for law, law_memory in zip(oscillator.laws, memory, strict=True)
    )
    return v, dv, tuple(rates)


class HysteresisExact(diffrax.AbstractSolver):
    """A diffrax solver that takes exact steps under a sampled input.

    It takes a `Stepping` as `args`, which contains the laws and the input. The n-th step uses the
    n-th push, and the vector field is never evaluated. Use it with `diffrax.ConstantStepSize`.
    """

    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Callable[..., diffrax.LocalLinearInterpolation]] = (
        diffrax.LocalLinearInterpolation
    )

    def order(self, terms) -> int:
        """Return the global order of the solver."""
        return 4

    def init(self, terms, t0, t1, y0, args):
        """Return the number of the first substep."""
        return jnp.zeros((), jnp.int32)

    def step(self, terms, t0, t1, y0, args: Stepping, *progress):
        """Advance by one substep; diffrax expects the other returned values."""
        substep, _ = progress
        push = args.push(tuple(piece[substep] for piece in args.pieces))
        # The state is a flat tuple, because springs have an empty internal state.
        laws = args.step.laws
        at_rest = packed(laws, (0.0, 0.0, tuple(law.at_rest() for law in laws)))
        state = jax.tree.unflatten(jax.tree.structure(at_rest), y0)
        y1 = tuple(jax.tree.leaves(advance(args.step, state, push, kinks="met")))
        dense_info = dict(y0=y0, y1=y1)
        return y1, None, dense_info, substep + 1, diffrax.RESULTS.successful

    def func(self, terms, t0, y0, args):
        """Return the vector field of the diffrax terms at a state."""
        return terms.vf(t0, y0, args)


class StockScheme(NamedTuple):
    """The settings of a standard solver: method, step-size controller, substeps per sample."""

    solver: diffrax.AbstractSolver
    controller: diffrax.AbstractStepSizeController
    substeps: int


def solve_stock(
    oscillator: Any,
    u: Callable[[Scalar], Scalar],
    num_samples: int,
    fs: Scalar,
    initial: Any,
    scheme: StockScheme,
    field: Callable[[Any, Scalar, Any], Any] = oscillate,
) -> Any:
    """Integrate with a standard solver; return states at the samples, inf where it failed.

    Time is counted in samples. `field` gives the time derivative of the oscillator's state under an
    input. Only an adaptive solver can fail.
    """
    leaves, tree = jax.tree.flatten(initial)
    solver, controller, substeps = scheme

    def rate(tau, leaves, oscillator):
        rates = field(oscillator, u(tau), jax.tree.unflatten(tree, leaves))
        return tuple(x / fs for x in jax.tree.leaves(rates))

    constant = isinstance(controller, diffrax.ConstantStepSize)
    num_steps = (num_samples - 1) * substeps
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rate),
        solver,
        t0=0.0,
        t1=float(num_samples - 1),
        dt0=1.0 / substeps,
        y0=tuple(leaves),
        args=oscillator,
        saveat=diffrax.SaveAt(t0=True, steps=substeps)
        if constant
        else diffrax.SaveAt(ts=jnp.arange(num_samples, dtype=float)),
        stepsize_controller=controller,
        adjoint=diffrax.DirectAdjoint(),
        max_steps=num_steps if constant else _MAX_STEPS_PER_SAMPLE * num_samples,
        throw=False,
    )
    return jax.tree.unflatten(tree, [x[:num_samples] for x in solution.ys])  # pyright: ignore
