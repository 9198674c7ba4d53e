r"""The protocol of a joint's law, and the defaults of every law.

A law is one force across the joint, per unit modal mass. It is a record whose leaves are its
parameters, a table that names them, and a few functions; `jbw.oscillator.laws` holds the register.
Several laws may stand beside each other in one `Oscillator`.

The oscillator solves the linear part with the stuck stiffness K exactly; a law acts there through
its remainder $r = F - K y$, small and with few kinks. How it goes through a time step is said by
`branch`, `remainder`, `glide`, `turn`, `shift`, whose defaults need `move`, `force` and `rate`.
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

Branch = Any  # a pytree, what holds between two kinks
Memory = Any  # a pytree of scalars: z of Bouc-Wen, the sliders' forces, () of a spring


class Law(eqx.Module):
    r"""One force F across the joint, per unit modal mass; its leaves are its parameters.

    A law defines `table`, `prior`, `force` and, with a memory, `at_rest` and `rate`. The rest has a
    generic default here, to be overridden by exact methods.

    Attributes:
        name: Name in a campaign, `[joint] laws = ["bouc_wen"]`; a class variable.
        table: Every parameter's name, symbol, unit, meaning and least value; a class variable.
        fields: Fields that hold parameters of other names, by these; a class variable.
        products: Products of them that weak motion identifies; a class variable.
        coordinates: Other parameters to sample in, by name; a class variable. A law that has some
            defines their `coordinate_bounds` about a fit, as `BoucWenLaw` does.
        degrades: Whether every cycle changes the joint for good; a class variable. Tip, loop and
            periodic force are then those of `undamaged`.
        is_even: Whether the force is `k_2` times y^2, which moves the mean; a class variable.
        stepped: Whether the time step supports the law; otherwise a stock solver integrates `rate`.
        depth: Reversals that the memory holds, which few steps change; see `Masing`.
        same_as: Why no motion tells the law from others with the same words; a class variable.
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

    # -- of the kind of law ------------------------------------------------------------------------
    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the names of the parameters."""
        return tuple(quantity.name for quantity in cls.table)

    @classmethod
    def build(cls, theta: Mapping[str, Any]) -> Self:
        """Return the law from a dictionary of its parameters, which may hold others too."""
        return cls(**{cls.fields.get(name, name): theta[name] for name in cls.names()})

    @classmethod
    def of(cls, theta: Mapping[str, Any]) -> Self:
        """Return the law from a dictionary of its parameters or of any of its other coordinates."""
        for coordinates in cls.coordinates.values():
            if set(coordinates.names) <= theta.keys():
                return cls.build(coordinates.to_parameters(theta))
        return cls.build(theta)

    def parameters(self) -> dict[str, Any]:
        """Return the values of the parameters by name, the inverse of `build`."""
        return {name: getattr(self, self.fields.get(name, name)) for name in self.names()}

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        """Return wide bounds of the parameters from scales alone, never from a fit of this law."""
        raise ConfigError(
            f"The law `{cls.name}` must have a `prior` to be identified, but has none.",
            remedy="Define `prior(scales)`, bounds of every parameter of its `table`.",
        )

    @classmethod
    def caution(cls, bounds: Bounds, y_peak: float) -> str | None:
        """Return a warning about bounds within which the law misbehaves, or None."""
        return None

    # -- of one law --------------------------------------------------------------------------------
    def at_rest(self) -> Memory:
        """Return the memory before any motion."""
        return ()

    def force(self, y: Scalar, v: Scalar, memory: Memory) -> Scalar:
        """Return the force F, on the side of the springs [N/kg]."""
        raise NotImplementedError

    def rate(self, y: Scalar, v: Scalar, memory: Memory) -> Memory:
        """Return the memory's rate; a rate-independent law's is proportional to the velocity v."""
        return ()

    def stiffness(self) -> Scalar:
        """Return the slope dF/dy at rest, which omega_n^2 includes [1/s^2]."""
        rest = jax.tree.map(lambda x: jnp.asarray(x, float), self.at_rest())
        return generic.slope(self, jnp.zeros(()), rest, jnp.ones(()))

    def move(self, y: Scalar, memory: Memory, dy: Scalar) -> Memory:
        """Return the memory after a monotone move from y (Runge-Kutta; rates proportional to v)."""
        return generic.move_by_rates(self, y, memory, dy)

    def follow(self, y: Scalar, memory: Memory, dy: Scalar) -> Memory:
        """`move` as one of many moves along a record, where the exact one would be costly."""
        return self.move(y, memory, dy)

    def undamaged(self) -> "Law":
        """Return the law before any cycle has changed it; itself where none does."""
        return self

    def at_tip(self, y_peak: Scalar) -> Memory:
        """Return the memory at y = Y on the steady loop between -Y and Y; the second time there."""
        memory = self.move(0.0 * y_peak, self.at_rest(), y_peak)
        memory = self.move(y_peak, memory, -2.0 * y_peak)
        return self.move(-y_peak, memory, 2.0 * y_peak)

    @property
    def feels_rate(self) -> bool:
        """Whether the force depends on the size of the velocity, and not on its sign alone."""
        return generic.feels_rate(self)

    def loop(self, y_peak: Scalar, omega: Scalar = SLOW) -> Loop:
        """Return equivalent stiffness and damping of the steady loop of frequency omega [rad/s].

        The trapezium rule on half a cycle of moves from the tip, of which the other half is the
        mirror; good to about 1e-4 where the force has kinks. At Y = 0 the limit of weak motion.
        Only a law that feels the rate depends on omega, which is that of slow motion by default.
        """
        return Loop(*generic.loop_by_moves(self, y_peak, omega))

    def powers_of_length(self) -> dict[str, Scalar]:
        """Return by name the powers of length that parameters and products have beyond their units.

        Of what is stated at a fixed displacement: a stiffness lost at 1 mm by the power q of the
        displacement has the power -q of the unit of length.
        """
        return {}

    def thresholds(self) -> tuple[Threshold, ...]:
        """Return the displacements that a motion must exceed to identify all parameters."""
        return ()

    # -- through a time step of length h ---------------------------------------------------------
    def branch(self, v: Scalar, memory: Memory) -> Branch:
        """Return the quantities that are constant until the next kink, such as signs."""
        return ()

    def remainder(
        self, h: Scalar, y: Scalar, v: Scalar, memory: Memory, branch: Branch
    ) -> tuple[Scalar, Scalar]:
        """Return the remainder r = F - K y [N/kg] and h times its rate."""
        return generic.remainder_by_rates(self, h, y, v, memory)

    def bend(
        self, h: Scalar, y: Scalar, v: Scalar, a: Scalar, memory: Memory, branch: Branch
    ) -> Scalar:
        """Return half of h^2 times the remainder's second derivative on the branch."""
        return generic.bend_by_rates(self, h, (y, v, memory), a, branch)

    def glide(
        self, y: Scalar, memory: Memory, dy: Scalar, branch: Branch
    ) -> tuple[Memory, Bool[Array, "..."] | bool]:
        """Return the memory after a step without a turn; True if a kink requires `turn`."""
        # A kink that is not reported here, such as a yield, leaves the step first order in h.
        return self.move(y, memory, dy), False

    def turn(
        self, h: Scalar, y: Scalar, memory: Memory, ends: Ends, quartic: Scalar
    ) -> tuple[Memory, Scalar, Scalar]:
        """Return the memory after a step that may turn, and its kinks' impulses on the motion.

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
        """Return the memory after the corrector's small change of y, on the branch at the end."""
        return self.move(y, memory, dy)

    # -- along a periodic motion -----------------------------------------------------------------
    def scaled(self, length: Scalar, stiffness: Scalar) -> "Law":
        """Return the law in units of displacement l, stiffness kappa and time kappa^(-1/2)."""
        return ScaledLaw(self, length, stiffness)

    def harmonics(
        self, q: Complex[Array, " harmonic"], max_turns: int, omega: Scalar = SLOW
    ) -> Complex[Array, " harmonic"]:
        """Return the odd harmonics of the remainder r along the motion, by moves over two periods.

        On a uniform grid from the crest; the first period sets the memory, which is exact for laws
        that forget all but their last turns. With kinks the error falls with the square of points.
        """
        return generic.harmonics_by_moves(self, q, max_turns, omega)

    def force_over_period(
        self,
        q: Complex[Array, " harmonic"],
        theta: Float[Array, " time"],
        max_turns: int,
        omega: Scalar = SLOW,
    ) -> Float[Array, " time"]:
        """Return the steady force at rising angles of a period by moves over two periods [N/kg]."""
        return generic.force_by_moves(self, q, theta, omega)

    # -- for other programs ------------------------------------------------------------------------
    def convert(self, omega_n: float, zeta: float, mass: float) -> Mapping[str, Conversion]:
        """Return the oscillator of this law alone, of a modal mass [kg], in other conventions."""
        return {}

    # -- at the doors ------------------------------------------------------------------------------
    def check_periodic(self) -> None:
        """Raise a ModelError where `harmonics` do not hold."""

    def doubts(self) -> str | None:
        """Warn of parameters for which the force may diverge, else return None; concrete only."""
        return generic.no_force(self)

    def memory_unit(self, omega_n: Scalar) -> Memory:
        """Return factors from memory to velocity; by default as for forces, zero for counters."""
        return jax.tree.map(lambda _: 1.0 / omega_n, self.at_rest())

    @property
    def remembers(self) -> bool:
        """Whether the law has a memory."""
        return bool(jax.tree.leaves(self.at_rest()))

    @property
    def kinked(self) -> bool:
        """Whether a step may meet a kink of the law, so that `glide` and `turn` are called."""
        return self.remembers


def laws_in(laws: Any) -> list[Law]:
    """Return all laws of one joint, a tuple of them, or of several, a tuple a joint."""
    return jax.tree.leaves(laws, is_leaf=_is_law)


def map_laws(function: Callable[..., Any], laws: Any, *others: Any) -> Any:
    """Apply a function to every law and its counterparts in other trees, such as memories."""
    return jax.tree.map(function, laws, *others, is_leaf=_is_law)


def feels_rate(kind: type[Law]) -> bool:
    """Return whether the force of a kind of law depends on the size of the velocity."""
    return kind.build(dict.fromkeys(kind.names(), 1.0)).feels_rate


def pack_memories(laws: Any, memories: Any) -> Any:
    """Return memories in the layout of the time loop, with reversals in arrays."""
    return map_laws(lambda law, memory: law.packed(memory) if law.depth else memory, laws, memories)


def unpack_memories(laws: Any, memories: Any) -> Any:
    """Return memories of scalars from the layout of the time loop."""
    return map_laws(
        lambda law, memory: law.unpacked(memory) if law.depth else memory, laws, memories
    )


def count_guesses(law: Law, memory: Memory) -> Scalar:
    """Return how often the memory was too short, so that the force may be a guess."""
    return law.guesses(memory) if law.depth else 0.0  # pyright: ignore[reportAttributeAccessIssue]


def _is_law(value: Any) -> bool:
    return isinstance(value, Law)


class ScaledLaw(Law):
    r"""A law in other units, $F(\ell q, \ell\sqrt\kappa\,\dot q)/(\kappa\ell)$, for the balance.

    Attributes:
        law: F.
        length: Unit l of displacement; at l = 0 the limit, the slope of F at rest.
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
        """Return the memory of the law before any motion."""
        return self.law.at_rest()

    def force(self, y: Scalar, v: Scalar, memory: Memory) -> Scalar:
        """Return the scaled force F(l q) / (kappa l)."""
        speed = self.length * jnp.sqrt(self.unit) * v
        return self.law.force(self.length * y, speed, memory) / (self.unit * self.length)

    def rate(self, y: Scalar, v: Scalar, memory: Memory) -> Memory:
        """Return the rate of the law's memory at l q."""
        return self.law.rate(self.length * y, self.length * v, memory)

    def move(self, y: Scalar, memory: Memory, dy: Scalar) -> Memory:
        """Return the law's memory after a move of l q."""
        return self.law.move(self.length * y, memory, self.length * dy)

    def loop(self, y_peak: Scalar, omega: Scalar = SLOW) -> Loop:
        """Return the law's loop at l Y, over kappa."""
        loop = self.law.loop(self.length * y_peak, omega * jnp.sqrt(self.unit))
        return Loop(loop.stiffness / self.unit, loop.damping / self.unit)

    def scaled(self, length: Scalar, stiffness: Scalar) -> "ScaledLaw":
        """Return the law in new units, on top of its present scaling."""
        return ScaledLaw(self.law, self.length * length, self.unit * stiffness)

    def harmonics(
        self, q: Complex[Array, " harmonic"], max_turns: int, omega: Scalar = SLOW
    ) -> Complex[Array, " harmonic"]:
        """Return those of the law along the motion l q, at the frequency omega sqrt(kappa)."""
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
