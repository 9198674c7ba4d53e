r"""Springs: smooth restoring forces $f(y)$ without memory, per unit mass."""

from collections.abc import Mapping
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from jbw.errors import ModelError
from jbw.oscillator.checks import is_concrete
from jbw.oscillator.kinks import barrier
from jbw.oscillator.law import Bounds, Law, Loop, Scales
from jbw.oscillator.parameters import SLOW, Restoring, Scalar
from jbw.oscillator.steady.waveform import odd_harmonics, synthesis
from jbw.quantities import Quantity
from jbw.report.messages import joint as messages

# Displacements at which a force is tested for oddness [m].
_PROBES = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
# Largest force of a spring at the largest displacement, relative to the linear force, for the
# prior.
MOST_SHARE = 0.3


def bounds_of_power(name: str, power: int, scales: Scales) -> Bounds:
    """Return prior bounds of c in c y^power: the force is up to 0.3 of the linear force.

    The force may have either sign; the forces are compared at the largest motion.
    """
    most = MOST_SHARE * scales.omega_n**2 / scales.y_peak ** (power - 1)
    return {name: (-most, most)}


class Spring(Law):
    """The base class of springs, laws without an internal state and with a smooth force f(y)."""

    def __call__(self, y: Scalar) -> Scalar:
        """Return the force at the displacement y [m]."""
        raise NotImplementedError

    def stiffness(self) -> Scalar:
        """Return zero, because omega_n^2 does not include the spring."""
        return 0.0

    def remainder(
        self, h: Scalar, y: Scalar, v: Scalar, memory: tuple[()], branch: tuple[()]
    ) -> tuple[Scalar, Scalar]:
        """Return the force f(y), and its rate f'(y) v times the time step h."""
        return barrier(jax.jvp(self, (y,), (h * v,)))

    def harmonics(
        self, q: Complex[Array, " harmonic"], max_turns: int, omega: Scalar = SLOW
    ) -> Complex[Array, " harmonic"]:
        """Return the odd harmonics from a uniform grid; exact for polynomials of degree 7."""
        return odd_harmonics(self, q)

    def force_over_period(
        self,
        q: Complex[Array, " harmonic"],
        theta: Float[Array, " time"],
        max_turns: int,
        omega: Scalar = SLOW,
    ) -> Float[Array, " time"]:
        """Return the spring's force at given angles of a periodic motion [N/kg]."""
        return self(synthesis(q, theta))  # pyright: ignore[reportReturnType]

    def loop(self, y_peak: Scalar, omega: Scalar = SLOW) -> Loop:
        """Return the loop of an odd force: no damping, and a stiffness exact up to degree 61."""
        y_peak = jnp.asarray(y_peak, float)
        peak = jnp.where(y_peak == 0.0, 1.0, y_peak)
        cosines = np.cos(np.pi * (np.arange(16) + 0.5) / 32)
        first = sum(c * self(c * peak) for c in cosines) / 8.0
        _, at_rest = jax.jvp(self, (jnp.zeros_like(peak),), (jnp.ones_like(peak),))
        stiffness = jnp.where(y_peak == 0.0, at_rest, first / peak)
        return Loop(stiffness, jnp.zeros_like(stiffness))

    def force(self, y: Scalar, v: Scalar, memory: tuple[()]) -> Scalar:
        """Return the force at the displacement y [N/kg]."""
        return self(y)

    def check_periodic(self) -> None:
        """Raise if the force has an even part, which would cause even harmonics."""
        if (even := self.even_part()) is not None:
            raise ModelError(
                f"Parameter `restoring` must be an odd force for a periodic response, but {even}.",
                why="Odd harmonics over half a period describe only odd motions.",
                remedy="Use None for the even powers of `Polynomial`, or `simulate` with "
                "periodic=True.",
            )

    def even_part(self) -> str | None:
        """Describe the force's even part; None if there is none, or if JAX traces the values."""
        if not is_concrete(self):
            return None
        for y in _PROBES:
            # This test also works for constants inside a jitted function.
            with jax.ensure_compile_time_eval():
                plus, minus = self(y), self(-y)
            if not is_concrete(plus, minus):  # the function contains a traced number
                return None
            plus, minus = np.asarray(plus), np.asarray(minus)
            if not np.all(np.abs(plus + minus) <= 1e-9 * np.abs(plus - minus)):
                return "f(-y) differs from -f(y)"
        return None


class Cubic(Spring):
    r"""Cubic stiffness, $f(y) = \lambda_3\,y^3$ [N/kg].

    As the only law of an oscillator it gives a Duffing oscillator of natural frequency omega_n.

    Attributes:
        lambda_3: Cubic stiffness, positive if it stiffens [1/(m^2 s^2)].

    Examples:
        The resonance of a Duffing oscillator lies at sqrt(omega_n^2 + 3/4 lambda_3 Y^2):

        >>> import jbw; jbw.enable_x64()
        >>> duffing = jbw.Oscillator(omega_n=100.0, zeta=0.01, laws=(jbw.Cubic(2.8e9),))
        >>> print(f"{jbw.backbone(duffing, 1e-3).omega:.2f} rad/s")
        110.00 rad/s
    """

    name: ClassVar[str] = "cubic"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity("cubic", "λ₃", "1/(m^2 s^2)", "cubic stiffness parallel to the joint"),
    )
    fields: ClassVar[Mapping[str, str]] = {"cubic": "lambda_3"}

    lambda_3: Scalar

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        """Return prior bounds of the coefficient, from the linear force."""
        return bounds_of_power("cubic", 3, scales)

    def __call__(self, y: Scalar) -> Scalar:
        """Return the force at the displacement y [m]."""
        return self.lambda_3 * y**3

    def even_part(self) -> None:
        """Return None: the cubic force has no even part."""


class Quintic(Spring):
    r"""Stiffness of the fifth power, $f(y) = k_5\,y^5$ [N/kg], for use with a cubic spring.

    Attributes:
        k_5: Quintic stiffness, positive if it stiffens [1/(m^4 s^2)].
    """

    name: ClassVar[str] = "quintic"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity("quintic", "k₅", "1/(m^4 s^2)", "quintic stiffness parallel to the joint"),
    )
    fields: ClassVar[Mapping[str, str]] = {"quintic": "k_5"}

    k_5: Scalar

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        """Return prior bounds of the coefficient, from the linear force."""
        return bounds_of_power("quintic", 5, scales)

    def __call__(self, y: Scalar) -> Scalar:
        """Return the force at the displacement y [m]."""
        return self.k_5 * y**5

    def even_part(self) -> None:
        """Return None: the quintic force has no even part."""


class Square(Spring):
    r"""Stiffness that differs in tension and compression, $f(y) = k_2\,y^2$ [N/kg].

    The force is even, so the motion has a mean and even harmonics. It is therefore for records,
    which are followed in time, and not for steady responses. A cubic spring about another rest
    position equals this spring, a cubic spring and a part of omega_n^2.

    Attributes:
        k_2: Stiffness gained by displacement, of either sign [1/(m s^2)].
    """

    name: ClassVar[str] = "square"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity("square", "k₂", "1/(m s^2)", "coefficient of the even force k₂ y²"),
    )
    is_even: ClassVar[bool] = True
    fields: ClassVar[Mapping[str, str]] = {"square": "k_2"}

    k_2: Scalar

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        """Return prior bounds of the coefficient, from the linear force."""
        return bounds_of_power("square", 2, scales)

    def __call__(self, y: Scalar) -> Scalar:
        """Return the force at the displacement y [m]."""
        return self.k_2 * y**2

    def loop(self, y_peak: Scalar, omega: Scalar = SLOW) -> Loop:
        """Return zero: an even force causes a mean and even harmonics, but no first harmonic."""
        none = 0.0 * self.k_2 * jnp.asarray(y_peak, float)
        return Loop(none, none)  # pyright: ignore[reportArgumentType]

    def harmonics(
        self, q: Complex[Array, " harmonic"], max_turns: int, omega: Scalar = SLOW
    ) -> Complex[Array, " harmonic"]:
        """Return zeros: an even force has no odd harmonics."""
        return 0.0 * q

    def even_part(self) -> str:
        """Return the description of the even part, here the whole force."""
        return messages.EVEN_SQUARE


class Polynomial(Spring):
    r"""Polynomial stiffness, $f(y) = \sum_{n \ge 2} c_n\,y^n$ [N/kg].

    Attributes:
        coefficients: c_2, c_3, c_4, ... [1/(m^(n-1) s^2)]; None for an absent power. Periodic
            responses have odd harmonics only, and need None (or a plain 0) for even powers.

    Examples:
        The resonance lies at sqrt(omega_n^2 + 3/4 c_3 Y^2 + 5/8 c_5 Y^4):

        >>> import jbw; jbw.enable_x64()
        >>> spring = jbw.Polynomial((None, 2e9, None, 9.6e14))  # c_3 and c_5
        >>> joint = jbw.Oscillator(omega_n=100.0, zeta=0.01, laws=(spring,))
        >>> print(f"{jbw.backbone(joint, 1e-3).omega:.2f} rad/s")
        110.00 rad/s
    """

    name: ClassVar[str] = "polynomial"
    table: ClassVar[tuple[Quantity, ...]] = ()

    coefficients: tuple[Scalar | None, ...] = eqx.field(converter=tuple)

    def parameters(self) -> dict[str, Any]:
        """Return the coefficients by name, c_2, c_3, ..., of the powers that are present."""
        terms = enumerate(self.coefficients, start=2)
        return {f"c_{n}": c for n, c in terms if c is not None}

    def __call__(self, y: Scalar) -> Scalar:
        """Return the force at the displacement y [m]."""
        terms = enumerate(self.coefficients, start=2)
        return sum((c * y**n for n, c in terms if c is not None), 0.0 * y)

    def even_part(self) -> str | None:
        """Return a text that lists even powers whose coefficients may not be zero, or None."""
        even = {f"c_{n}": c for n, c in enumerate(self.coefficients, start=2) if n % 2 == 0}
        acting = [
            name
            for name, c in even.items()
            if c is not None and (not is_concrete(c) or np.any(np.asarray(c) != 0.0))
        ]
        return f"its {', '.join(acting)} may act" if acting else None


class Callable(Spring):
    """A law from any function of the displacement.

    Attributes:
        function: Function from y [m] to f(y) [N/kg]; a pytree, whose leaves are parameters.
    """

    name: ClassVar[str] = "callable"
    table: ClassVar[tuple[Quantity, ...]] = ()

    function: Restoring

    def __call__(self, y: Scalar) -> Scalar:
        """Return the force at the displacement y [m]."""
        return self.function(y)


def as_law(force: Restoring) -> Spring:
    """Return a restoring force as a law; return the force unchanged if it is a law already."""
    return force if hasattr(force, "stiffness") else Callable(force)  # pyright: ignore
