r"""The interface of a joint's force law, with default methods.

A law is one force across the joint, per unit modal mass. It is a record whose leaves are its
parameters, with a table that describes them and a few methods. `jbw.oscillator.laws` is the
register of laws. One `Oscillator` may have several laws in parallel.

The oscillator solves the linear part exactly, including the laws' stiffness at rest K. A law enters
the time step only through its remainder $r = F - K y$, which is small and has few kinks. The
methods `branch`, `remainder`, `glide`, `turn` and `shift` describe it there; their defaults need
only `move`, `force` and `rate`. A law may also offer `follow`, a cheaper `move` for the many short
displacements along a record.
"""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Complex, Float

from jbw.errors import ConfigError
from jbw.oscillator import generic
from jbw.oscillator.kinks import Ends
from jbw.oscillator.parameters import SLOW, Scalar
from jbw.oscillator.parameters import Bounds as Bounds
from jbw.oscillator.parameters import Conversion as Conversion
from jbw.oscillator.parameters import Coordinates as Coordinates
from jbw.oscillator.parameters import Loop as Loop
from jbw.oscillator.parameters import Monomial as Monomial
from jbw.oscillator.parameters import Scales as Scales
from jbw.oscillator.parameters import Threshold as Threshold
from jbw.oscillator.steady.waveform import orders
from jbw.quantities import Quantity

Branch = Any  # pytree of the quantities that are constant between two kinks of the force
Memory = Any  # pytree of internal states: z of Bouc-Wen, forces of sliders, () for a spring


class Law(eqx.Module):
    r"""A force F across the joint, per unit modal mass; the fields are its parameters.

    A law defines `table`, `prior`, `force` and, if it has a memory, `at_rest` and `rate`. All other
    methods have generic defaults here; a law may override them by exact methods.

    Attributes:
        name: Name in a campaign, `[joint] laws = ["bouc_wen"]`; a class variable.
        table: Every parameter's name, symbol, unit, meaning and least value; a class variable.
        fields: Field name by parameter name, where the two differ; a class variable.
        products: Products of parameters that small motion determines; a class variable.
        coordinates: Alternative parametrisations for sampling, by name; a class variable. A law
            with alternatives defines their `coordinate_bounds` about a fit, as `BoucWenLaw` does.
        degrades: Whether every cycle changes the joint permanently; a class variable. Tip, loop and
            periodic force are then those of `undamaged()`, which such a law offers.
        is_even: Whether the force is `k_2` times y^2, which moves the mean; a class variable.
        stepped: Whether the time step supports the law; otherwise a stock solver integrates `rate`.
        depth: Number of reversals in the memory, 0 for most laws; few steps change it; see
            `Masing`.
        same_as: Why no motion distinguishes the law from others with the same text; a class
            variable.
    """

    name: ClassVar[str]
    table: ClassVar[tuple[Quantity, ...]]
    fields: ClassVar[Mapping[str, str]] = {}
    products: ClassVar[tuple[Monomial, ...]] = ()
    coordinates: ClassVar[Mapping[str, Coordinates]] = {}
    usual: ClassVar[Mapping[str, tuple[str, tuple[float, float]]]] = {}
    degrades: ClassVar[bool] = False
    is_even: ClassVar[bool] = False
    stepped: ClassVar[bool] = True
    depth: ClassVar[int] = 0
    same_as: ClassVar[str] = ""

    # -- methods of the law class ------------------------------------------------------------------
    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the names of the parameters of the law class."""
        return tuple(quantity.name for quantity in cls.table)

    @classmethod
    def build(cls, theta: Mapping[str, Any]) -> Self:
        """Return the law from its parameters or coordinates; `theta` may have other entries too."""
        names = cls.names()
        for coordinates in () if theta.keys() >= set(names) else cls.coordinates.values():
            if set(coordinates.names) <= theta.keys():
                theta = coordinates.to_parameters(theta)
        return cls(**{cls.fields.get(name, name): theta[name] for name in names})

    def parameters(self) -> dict[str, Any]:
        """Return the law's parameter values by name, the inverse of `build`."""
        return {name: getattr(self, self.fields.get(name, name)) for name in self.names()}

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        """Return wide prior bounds of the parameters from scales of the motion, not from a fit."""
        raise ConfigError(
            f"The law `{cls.name}` must have a `prior` to be identified, but has none.",
            remedy="Define `prior(scales)`, which returns bounds of every parameter in the law's "
            "`table`.",
        )

    @classmethod
    def caution(cls, bounds: Bounds, y_peak: float) -> str | None:
        """Return a warning if the law may diverge within its prior bounds."""
        return None

    # -- methods of a law with given parameters ----------------------------------------------------
    def at_rest(self) -> Memory:
        """Return the law's memory (internal state) before any motion."""
        return ()

    def force(self, y: Scalar, v: Scalar, memory: Memory) -> Scalar:
        """Return the law's force F [N/kg], which adds to the spring forces of the oscillator."""
        raise NotImplementedError

    def rate(self, y: Scalar, v: Scalar, memory: Memory) -> Memory:
        """Return the time derivative of the internal state, for most laws proportional to v."""
        return ()

    def stiffness(self) -> Scalar:
        """Return the law's stiffness: the slope dF/dy at rest, part of omega_n^2 [1/s^2]."""
        rest = jax.tree.map(lambda x: jnp.asarray(x, float), self.at_rest())
        return generic.slope(self, jnp.zeros(()), rest, jnp.ones(()))

    def move(self, y: Scalar, memory: Memory, dy: Scalar) -> Memory:
        """Return the internal state after a monotone motion from y to y + dy (Runge-Kutta steps).

        The rate must be proportional to v.
        """
        return generic.move_by_rates(self, y, memory, dy)

    def at_tip(self, y_peak: Scalar) -> Memory:
        """Return the internal state at the tip y = Y of the steady loop."""
        memory = self.move(0.0 * y_peak, self.at_rest(), y_peak)
        memory = self.move(y_peak, memory, -2.0 * y_peak)
        return self.move(-y_peak, memory, 2.0 * y_peak)

    @property
    def feels_rate(self) -> bool:
        """Whether the force depends on the magnitude of the velocity, not only on its sign."""
        leaves, form = jax.tree.flatten(self)
        return generic.feels_rate(type(self).force, form, tuple(jnp.shape(leaf) for leaf in leaves))

    def loop(self, y_peak: Scalar, omega: Scalar = SLOW) -> Loop:
        """Return the equivalent stiffness and damping of the steady loop at a frequency [rad/s].

        The trapezium rule is applied to half a cycle of moves from the tip; the other half mirrors
        it. The error is about 1e-4 where the force has kinks. At Y = 0 the result is the limit of
        small motion. Only rate-dependent laws depend on the frequency omega; the default is slow
        motion.
        """
        return Loop(*generic.loop_by_moves(self, y_peak, omega))

    def powers_of_length(self) -> dict[str, Scalar]:
        """Return an exponent of length for each parameter, to add to the exponent in its unit.

        Such powers belong to values stated at a fixed displacement: a stiffness loss at 1 mm that
        grows with the power q of the displacement scales with the power -q of the unit of length.
        """
        return {}

    def thresholds(self) -> tuple[Threshold, ...]:
        """Return the displacements that a motion must exceed to determine all parameters."""
        return ()

    # -- through a time step of length h ---------------------------------------------------------
    def branch(self, v: Scalar, memory: Memory) -> Branch:
        """Return the quantities that are constant until the law's next kink, such as signs."""
        return ()

    def remainder(
        self, h: Scalar, y: Scalar, v: Scalar, memory: Memory, branch: Branch
    ) -> tuple[Scalar, Scalar]:
        """Return the nonlinear force r = F - K y [N/kg], and its rate times the time step h."""
        return generic.remainder_by_rates(self, h, y, v, memory)

    def bend(
        self, h: Scalar, y: Scalar, v: Scalar, a: Scalar, memory: Memory, branch: Branch
    ) -> Scalar:
        """Return h^2/2 times the second time derivative of F - K y between kinks, for a step h."""
        return generic.bend_by_rates(self, h, (y, v, memory), a, branch)

    def glide(
        self, y: Scalar, memory: Memory, dy: Scalar, branch: Branch
    ) -> tuple[Memory, Bool[Array, "..."] | bool]:
        """Return the internal state after a step without reversal, and whether it met a kink."""
        # A law must report every kink here, such as yield; otherwise the step is only accurate to
        # first order in h.
        return self.move(y, memory, dy), False

    def turn(
        self, h: Scalar, y: Scalar, memory: Memory, ends: Ends, quartic: Scalar
    ) -> tuple[Memory, Scalar, Scalar]:
        """Return the state after a step that may reverse, and the changes of v and y due to kinks.

        Args:
            h: Length of the step [s].
            y: Displacement at the start [m].
            memory: Memory at the start.
            ends: Slopes h v of the step's cubic path at its start and end, and its rise [m].
            quartic: Quartic term of the path [m].

        Returns:
            Memory at the end, the impulse on v over h and that on y over h^2 [m/s^2].
        """
        return generic.turn_by_slopes(self, y, memory, ends, quartic)

    def shift(self, y: Scalar, memory: Memory, dy: Scalar, branch: Branch) -> Memory:
        """Return the internal state after a small correction dy of a step's final displacement."""
        return self.move(y, memory, dy)

    # -- along a periodic motion -----------------------------------------------------------------
    def scaled(self, length: Scalar, stiffness: Scalar) -> "Law":
        """Return the law in other units: displacement l, stiffness kappa, time kappa^(-1/2)."""
        return ScaledLaw(self, length, stiffness)

    def harmonics(
        self, q: Complex[Array, " harmonic"], max_turns: int, omega: Scalar = SLOW
    ) -> Complex[Array, " harmonic"]:
        """Return the odd harmonics of F - K y along a periodic motion with harmonics q.

        They come from moves over two periods, on a uniform grid from the crest. The first period
        sets the memory, which is exact for laws that forget all but their last turning points. With
        kinks the error falls with the square of the number of points.
        """
        return generic.harmonics_by_moves(self, q, max_turns, omega)

    def force_over_period(
        self,
        q: Complex[Array, " harmonic"],
        theta: Float[Array, " time"],
        max_turns: int,
        omega: Scalar = SLOW,
    ) -> Float[Array, " time"]:
        """Return the steady force [N/kg] at given rising phase angles of a periodic motion."""
        return generic.force_by_moves(self, q, theta, omega)

    # -- for other programs ------------------------------------------------------------------------
    def convert(self, omega_n: float, zeta: float, mass: float) -> Mapping[str, Conversion]:
        """Return the law for a modal mass [kg] in the conventions of other programs."""
        return {}

    # -- checks of the law ------------------------------------------------------------------------
    def check_periodic(self) -> None:
        """Raise a ModelError if the law does not support `harmonics`; do nothing by default."""

    def doubts(self) -> str | None:
        """Return a warning if the force may diverge for these parameters."""
        return generic.no_force(self)

    def memory_unit(self, omega_n: Scalar) -> Memory:
        """Return factors that convert the internal state to velocities; zero for a counter.

        By default every entry is a force [N/kg] and its factor is 1 / omega_n.
        """
        return jax.tree.map(lambda _: 1.0 / omega_n, self.at_rest())

    @property
    def remembers(self) -> bool:
        """Whether the law has an internal state."""
        return bool(jax.tree.leaves(self.at_rest()))

    @property
    def kinked(self) -> bool:
        """Whether the law may have kinks within a step, so that `glide` and `turn` are called."""
        return self.remembers


def laws_in(laws: Any) -> list[Law]:
    """Return all laws as one list, from one joint (a tuple of laws) or several (a tuple each)."""
    return jax.tree.leaves(laws, is_leaf=_is_law)


def map_laws(function: Callable[..., Any], laws: Any, *others: Any) -> Any:
    """Apply a function to every law, together with the entries of other pytrees for this law."""
    return jax.tree.map(function, laws, *others, is_leaf=_is_law)


def feels_rate(kind: type[Law]) -> bool:
    """Return whether the force of a law class depends on the magnitude of the velocity."""
    return kind.build(dict.fromkeys(kind.names(), 1.0)).feels_rate


def packed(laws: Any, state: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
    """Return a state (y, v, memories) for the time loop, with all load reversals in one array."""
    y, v, memories = state
    return y, v, map_laws(lambda law, m: law.packed(m) if law.depth else m, laws, memories)


def unpacked(laws: Any, state: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
    """Return a state (y, v, memories) of the time loop with its load reversals as scalars."""
    y, v, memories = state
    return y, v, map_laws(lambda law, m: law.unpacked(m) if law.depth else m, laws, memories)


def count_guesses(law: Law, memory: Memory) -> Scalar:
    """Return the number of times that the law remembered too few load reversals.

    The force may be wrong at these times.
    """
    return law.guesses(memory) if law.depth else 0.0  # pyright: ignore[reportAttributeAccessIssue]


def _is_law(value: Any) -> bool:
    return isinstance(value, Law)


class ScaledLaw(Law):
    r"""A law in other units, $F(\ell q, \ell\sqrt\kappa\,\dot q)/(\kappa\ell)$, to find harmonics.

    Attributes:
        law: The law F in its own units.
        length: Unit l of displacement; at l = 0 the force is its limit, the slope of F at rest.
        unit: Unit kappa of stiffness.
    """

    name: ClassVar[str] = "scaled"
    table: ClassVar[tuple[Quantity, ...]] = ()

    law: Law
    length: Scalar
    unit: Scalar

    def stiffness(self) -> Scalar:
        """Return the scaled stiffness K / kappa."""
        return self.law.stiffness() / self.unit

    def at_rest(self) -> Memory:
        """Return the internal state before any motion."""
        return self.law.at_rest()

    def force(self, y: Scalar, v: Scalar, memory: Memory) -> Scalar:
        """Return the scaled force F(l q) / (kappa l)."""
        speed = self.length * jnp.sqrt(self.unit) * v
        return self.law.force(self.length * y, speed, memory) / (self.unit * self.length)

    def rate(self, y: Scalar, v: Scalar, memory: Memory) -> Memory:
        """Return the rate of the original law's internal state at the unscaled displacement l q."""
        return self.law.rate(self.length * y, self.length * v, memory)

    def move(self, y: Scalar, memory: Memory, dy: Scalar) -> Memory:
        """Return the original law's internal state after a move of the unscaled displacement."""
        return self.law.move(self.length * y, memory, self.length * dy)

    def loop(self, y_peak: Scalar, omega: Scalar = SLOW) -> Loop:
        """Return the original law's loop at the unscaled amplitude l Y, divided by kappa."""
        loop = self.law.loop(self.length * y_peak, omega * jnp.sqrt(self.unit))
        return Loop(loop.stiffness / self.unit, loop.damping / self.unit)

    def scaled(self, length: Scalar, stiffness: Scalar) -> "ScaledLaw":
        """Return the law in new units, which are stated relative to the law's present units."""
        return ScaledLaw(self.law, self.length * length, self.unit * stiffness)

    def harmonics(
        self, q: Complex[Array, " harmonic"], max_turns: int, omega: Scalar = SLOW
    ) -> Complex[Array, " harmonic"]:
        """Return the scaled harmonics along l q, at the frequency omega sqrt(kappa)."""
        at_rest = self.length == 0.0
        length = jnp.where(at_rest, 1.0, self.length)
        omega = omega * jnp.sqrt(self.unit)
        harmonics = self.law.harmonics(length * q, max_turns, omega) / length
        rest_slope = Law.stiffness(self.law) - self.law.stiffness()
        if self.law.feels_rate:
            rest_slope = rest_slope + 1j * omega * orders(q.shape[0]) * generic.drag_at_rest(
                self.law
            )
        return jnp.where(at_rest, rest_slope * q, harmonics) / self.unit
