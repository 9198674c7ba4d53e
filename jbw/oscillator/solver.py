r"""The oscillator under an input, for diffrax: our step, and stock solvers.

Time counts samples, $\tau = t f_s$, so that no rounding of 1/fs accumulates over a record.
`HysteresisExact` steps with the laws' own moves; stock solvers integrate `oscillate`.
"""

from collections.abc import Callable, Iterable
from typing import Any, ClassVar, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.oscillator.hold import HeldInput
from jbw.oscillator.law import pack_memories
from jbw.oscillator.oscillator import Oscillator
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.step import ExactStep, Push, State, added, advance, exact_step

# An adaptive solver may take this many steps a sample on average before it gives up.
_MAX_STEPS_PER_SAMPLE = 64


class Pushed(NamedTuple):
    """Constants of the step, and what the input adds in every substep."""

    step: Any
    push: Any


class Stepping(eqx.Module):
    r"""The constants and input for the hysteresis-exact stepping of a record.

    $$p = g \sum_j W_j c_j$$

    Attributes:
        step: Constants of the step.
        on_y: What each power of the input's polynomial adds to y in a substep, g W_j [s^2].
        on_v: What it adds to v [s].
        gain: Gain g of the input.
        pieces: Coefficients c_j of the input in every substep, a row a power.
    """

    step: ExactStep
    on_y: tuple[Scalar, ...]
    on_v: tuple[Scalar, ...]
    gain: Scalar
    pieces: tuple[Float[Array, " substep"], ...]

    @property
    def num_steps(self) -> int:
        """Number of substeps."""
        return self.pieces[0].shape[0]

    def push(self, substep: Array) -> Push:
        """Change of y [m] and v [m/s] by the input in a substep, and the input there [N/kg]."""
        return self.push_of(tuple(piece[substep] for piece in self.pieces))

    def push_of(self, powers: tuple[Scalar, ...]) -> Push:
        """Return the same by the coefficients of the input in a substep."""
        start = self.gain * powers[0]
        push = weighted(self.on_y, powers), weighted(self.on_v, powers), start
        return (*push, self.gain * added(powers)) if self._is_damped else push

    def pushed(self) -> "Pushed":
        """Return the same of all substeps at once, by one product, as derivatives take it."""
        count = len(self.pieces)
        weights = [
            jnp.stack(self.on_y), jnp.stack(self.on_v), self.gain * np.eye(1, count)[0],
            *([self.gain * np.ones(count)] if self._is_damped else []),
        ]  # fmt: skip
        return Pushed(self.step, tuple(jnp.stack(weights) @ jnp.stack(self.pieces)))

    @property
    def _is_damped(self) -> bool:
        """Whether a law asks for the input at the end of a substep too."""
        return any(law.feels_rate for law in self.step.laws)


def stepping(oscillator: Oscillator, held: HeldInput, fs: Scalar, substeps: int) -> Stepping:
    """Return the step's constants, the input's moments times its gain, and input coefficients."""
    step, moments_y, moments_v = exact_step(oscillator, 1.0 / (fs * substeps))
    pieces = held.pieces(substeps)
    on_y, on_v = (
        tuple(held.gain * moments[j] for j in range(len(pieces)))
        for moments in (moments_y, moments_v)
    )
    return Stepping(step, on_y, on_v, held.gain, pieces)


def weighted(weights: Iterable[Scalar], powers: Iterable[Any]) -> Any:
    """Sum of products, written out: the time loop is one call as long as it has no small dots."""
    return added(weight * power for weight, power in zip(weights, powers, strict=True))


def sampled_input(held: HeldInput, tau: Scalar) -> Scalar:
    """Return the input at time tau [samples], whose interval is found by index [N/kg]."""
    num_powers, num_intervals = held.polynomials.shape
    interval = jnp.clip(jnp.floor(tau).astype(jnp.int32), 0, num_intervals - 1)
    s = tau - interval
    value = held.polynomials[-1, interval]
    for power in range(num_powers - 2, -1, -1):
        value = value * s + held.polynomials[power, interval]
    return held.gain * value


def oscillate(oscillator: Oscillator, u: Scalar, state: State) -> State:
    r"""Return the rates of (y, v, memories) [per s], for every law.

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
    """The step of `exact_step` as a diffrax solver, for a sampled input.

    Takes a `Stepping` as `args`, which holds the laws and the input; the n-th step uses the n-th
    push, and the vector field is never evaluated. For `diffrax.ConstantStepSize`.
    """

    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Callable[..., diffrax.LocalLinearInterpolation]] = (
        diffrax.LocalLinearInterpolation
    )

    def order(self, terms) -> int:
        """Return the global order of the method."""
        return 4

    def init(self, terms, t0, t1, y0, args):
        """Index of the next substep."""
        return jnp.zeros((), jnp.int32)

    def step(self, terms, t0, t1, y0, args: Stepping, *progress):
        """Advance one substep; `progress` is its index and diffrax's jump flag, always False."""
        substep, _ = progress
        push = args.push(substep)
        # As a flat tuple: empty memories, of springs, have no place in the loop's buffers.
        laws = args.step.laws
        memory = pack_memories(laws, tuple(law.at_rest() for law in laws))
        state = jax.tree.unflatten(jax.tree.structure((0.0, 0.0, memory)), y0)
        y1 = tuple(jax.tree.leaves(advance(args.step, state, push, kinks="met")))
        dense_info = dict(y0=y0, y1=y1)
        return y1, None, dense_info, substep + 1, diffrax.RESULTS.successful

    def func(self, terms, t0, y0, args):
        """Return the vector field."""
        return terms.vf(t0, y0, args)


class StockScheme(NamedTuple):
    """How a stock solver integrates: its method, its step sizes, and substeps a sample."""

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
    """Return the states at the samples (inf where an adaptive solver failed); time in samples.

    `field` gives the rates of a state of the oscillator under an input.
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
