r"""The Bouc-Wen law, $dZ/dt = \alpha v - \gamma |v| |Z|^{\nu-1} Z - \delta v |Z|^\nu$."""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

import jbw.oscillator.laws.periodic_path as periodic_path
from jbw.errors import ModelError
from jbw.oscillator.checks import require_closed_form
from jbw.oscillator.kinks import Ends, signed
from jbw.oscillator.law import Bounds, Conversion, Coordinates, Law, Loop, Monomial, Scales
from jbw.oscillator.laws.conversions import conversions
from jbw.oscillator.laws.hysteresis import hysteresis_map, hysteresis_rate, steady_loop
from jbw.oscillator.laws.kinked_step import kinked_step
from jbw.oscillator.laws.piecewise_map import smooth_move
from jbw.oscillator.parameters import MOST_SOFTENING, SLOW, Scalar
from jbw.quantities import BOUC_WEN, Quantity
from jbw.report.messages import joint as messages

_ALPHA, _DELTA, _GAMMA = BOUC_WEN

# Prior range of alpha as a share of the whole stiffness: from almost none to nearly all.
SHARE = (0.0005, 0.9)
# Under a prescribed displacement, the joint may have all of the stiffness. A loop of large
# amplitude is then softer than a loop of small amplitude.
FORCED_SHARE = (0.01, MOST_SOFTENING)
REACH = 4.0  # upper prior bound of alpha delta and alpha gamma, relative to the fitted value

# Small motion determines only two products: alpha delta (softening) and alpha gamma (losses).
_PRODUCTS = Coordinates(
    "products",
    forward=(
        Monomial(_ALPHA, {"share": 1, "omega_n": 2}),
        Monomial(_DELTA, {"softening": 1, "share": -1}),
        Monomial(_GAMMA, {"opening": 1, "share": -1}),
    ),
    inverse=(
        Monomial(
            Quantity("softening", "α δ / ωₙ²", "1/m", "softening, alpha * delta / omega_n^2"),
            {"alpha": 1, "delta": 1, "omega_n": -2},
        ),
        Monomial(
            Quantity("opening", "α γ / ωₙ²", "1/m", "opening, alpha * gamma / omega_n^2"),
            {"alpha": 1, "gamma": 1, "omega_n": -2},
        ),
        Monomial(
            Quantity(
                "share",
                "α / ωₙ²",
                "1",
                "joint's share of the stiffness, alpha / omega_n^2",
                is_share=True,
            ),
            {"alpha": 1, "omega_n": -2},
        ),
    ),
)


class BoucWenLaw(Law):
    r"""The Bouc-Wen hysteresis law of Teloli et al., whose internal state is the force Z.

    $$\dot Z = \alpha\dot y - \gamma|\dot y||Z|^{\nu-1}Z - \delta\dot y|Z|^\nu$$

    Attributes:
        alpha: Stiffness [1/s^2].
        delta: Softening [1/m for nu = 1].
        gamma: Opening of the loop [1/m for nu = 1].
        nu: Smoothness exponent [-]; static. Only nu = 1 has a closed form.

    Reference:
        Eq. (2).
    """

    name: ClassVar[str] = "bouc_wen"
    table: ClassVar[tuple[Quantity, ...]] = BOUC_WEN
    same_as: ClassVar[str] = messages.SAME_EXPONENT
    products: ClassVar[tuple[Monomial, ...]] = (
        Monomial(
            Quantity("alpha_delta", "α δ", "1/(m s^2)", "softening, alpha * delta"),
            {"alpha": 1, "delta": 1},
        ),
        Monomial(
            Quantity("alpha_gamma", "α γ", "1/(m s^2)", "opening, alpha * gamma"),
            {"alpha": 1, "gamma": 1},
        ),
    )
    coordinates: ClassVar[Mapping[str, Coordinates]] = {"products": _PRODUCTS}
    # Range of each parameter in a plan, as a fraction of a quantity, if none is stated.
    usual: ClassVar[Mapping[str, tuple[str, tuple[float, float]]]] = {
        "alpha": ("omega_n^2", (0.01, 0.1)),
        "gamma": ("delta", (0.05, 0.3)),
    }

    alpha: Scalar
    delta: Scalar
    gamma: Scalar
    nu: float = eqx.field(default=1.0, static=True)

    @classmethod
    def of_weak_motion(cls, softening: float, opening: float, alpha: float) -> Self:
        """Build the law from alpha and its small-motion products alpha delta and alpha gamma."""
        return cls(alpha, softening / alpha, opening / alpha)

    def weak_motion(self) -> tuple[Scalar, Scalar]:
        """Return the small-motion products: alpha delta for softening, alpha gamma for losses."""
        return self.alpha * self.delta, self.alpha * self.gamma

    def slip(self, y: Scalar) -> Scalar:
        """Return delta y at a displacement y [m]; the motion is small if delta y is far below 1."""
        return jnp.abs(self.delta) * y

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        r"""Return prior bounds with which delta Y (softening) and gamma Y (opening) are around one.

        alpha is bounded as a share of omega_n^2. A negative delta, with which the joint hardens, is
        bounded by the growth of its force, $(e^{|\delta| Y} - 1) / |\delta| Y$ = 3.2 times that of
        a spring.
        """
        share = FORCED_SHARE if scales.forced else SHARE
        return {
            "alpha": (share[0] * scales.omega_n**2, share[1] * scales.omega_n**2),
            "delta": (-2.0 / scales.y_peak, 20.0 / scales.y_peak),
            "gamma": (0.0, 20.0 / scales.y_peak),
        }

    @classmethod
    def coordinate_bounds(
        cls, coordinates: str, bounds: Bounds, theta: Mapping[str, float], stated: Bounds
    ) -> Bounds:
        """Return prior bounds of alpha delta and alpha gamma: four times the larger fitted value.

        The lower bound is 0 unless delta or gamma may be negative.
        """
        fitted = cls.coordinates[coordinates].from_parameters(theta)
        largest = REACH * max(abs(fitted["softening"]), abs(fitted["opening"]))
        square = theta["omega_n"] ** 2
        alpha = stated.get("alpha")
        return {
            "softening": (-largest if bounds["delta"][0] < 0 else 0.0, largest),
            "opening": (-largest if bounds["gamma"][0] < 0 else 0.0, largest),
            "share": SHARE if alpha is None else (alpha[0] / square, alpha[1] / square),
        }

    @classmethod
    def caution(cls, bounds: Bounds, y_peak: float) -> str | None:
        """Return a warning if the prior includes delta + gamma < 0, where Z has no bound."""
        lowest = bounds["gamma"][0] + bounds["delta"][0]
        return None if lowest >= 0 else messages.prior_unbounded(lowest)

    def stiffness(self) -> Scalar:
        """Return alpha, the stiffness of the fully stuck joint [1/s^2]."""
        return self.alpha

    def at_rest(self) -> Scalar:
        """Return the internal state at rest, Z = 0 [N/kg]."""
        return 0.0

    def force(self, y: Scalar, v: Scalar, memory: Scalar) -> Scalar:
        """Return the hysteretic force Z [N/kg]."""
        return memory

    def rate(self, y: Scalar, v: Scalar, memory: Scalar) -> Scalar:
        """Return the time derivative of the hysteretic force Z [N/kg/s]."""
        return hysteresis_rate(self, v, memory)

    def move(self, y: Scalar, memory: Scalar, dy: Scalar) -> Scalar:
        """Return the hysteretic force Z after a monotone move; exact for nu = 1."""
        return hysteresis_map(self, memory, dy) if self.nu == 1.0 else super().move(y, memory, dy)

    @property
    def stepped(self) -> bool:
        """Whether the exact time step supports the law: only with nu = 1."""
        return self.nu == 1.0

    def branch(self, v: Scalar, memory: Scalar) -> Scalar:
        """Return the constant c of dZ/dy = alpha - c Z, gamma sgn(v) + delta sgn(Z) [1/m]."""
        return signed(self.gamma, v) + signed(self.delta, memory)

    def remainder(
        self, h: Scalar, y: Scalar, v: Scalar, memory: Scalar, branch: Scalar
    ) -> tuple[Scalar, Scalar]:
        """Return the force Z - alpha y, and its rate -c v Z times the time step h."""
        return memory - self.alpha * y, -h * branch * v * memory

    def bend(
        self, h: Scalar, y: Scalar, v: Scalar, a: Scalar, memory: Scalar, branch: Scalar
    ) -> Scalar:
        """Return h^2/2 times the second time derivative of Z - alpha y, with the time step h."""
        slope = self.alpha - branch * memory
        return -0.5 * h**2 * branch * (a * memory + v**2 * slope)

    def glide(
        self, y: Scalar, memory: Scalar, dy: Scalar, branch: Scalar
    ) -> tuple[Scalar, Bool[Array, "..."]]:
        """Return Z after a step, and True if Z passed zero or the step was too long."""
        moved = smooth_move(self.alpha, branch, memory, dy)
        # pyright: ignore[reportReturnType]
        return moved, (memory * moved <= 0.0) | (jnp.abs(branch * dy) > 1.0)  # pyright: ignore[reportReturnType]

    def turn(
        self, h: Scalar, y: Scalar, memory: Scalar, ends: Ends, quartic: Scalar
    ) -> tuple[Scalar, Scalar, Scalar]:
        """Return Z after a step with a reversal or a zero of Z, and both kinks' effects on v and y.

        The derivatives are coded by hand.
        """
        return kinked_step((self.alpha, self.delta, self.gamma), memory, ends, quartic)

    def shift(self, y: Scalar, memory: Scalar, dy: Scalar, branch: Scalar) -> Scalar:
        """Return Z after a small displacement dy, by the tangent of Z(y)."""
        return memory + (self.alpha - branch * memory) * dy

    def scaled(self, length: Scalar, stiffness: Scalar) -> "BoucWenLaw":
        """Return the law in other units of displacement and stiffness."""
        return BoucWenLaw(self.alpha / stiffness, self.delta * length, self.gamma * length, self.nu)

    def harmonics(
        self, q: Complex[Array, " harmonic"], max_turns: int, omega: Scalar = SLOW
    ) -> Complex[Array, " harmonic"]:
        """Return the odd harmonics of Z - alpha y along a periodic motion."""
        # pyright: ignore[reportReturnType]
        return self.alpha * periodic_path.relaxed_force(q, self.delta, self.gamma, max_turns)  # pyright: ignore[reportReturnType]

    def force_over_period(
        self,
        q: Complex[Array, " harmonic"],
        theta: Float[Array, " time"],
        max_turns: int,
        omega: Scalar = SLOW,
    ) -> Float[Array, " time"]:
        """Return the exact steady force at given angles of a periodic motion [N/kg]."""
        args = self.delta, self.gamma, max_turns
        # pyright: ignore[reportReturnType]
        return self.alpha * periodic_path.force_over_period(q, theta, *args)  # pyright: ignore[reportReturnType]

    def check_periodic(self) -> None:
        """Raise unless nu = 1, the only exponent with a closed form of the periodic force."""
        require_closed_form(self)

    def admits(self, memory: Scalar) -> None:
        """Raise if an initial Z exceeds alpha/(delta + |gamma|), above which it diverges."""
        softening = np.maximum(np.asarray(self.delta) + np.abs(np.asarray(self.gamma)), 0.0)
        limit = np.maximum(np.asarray(self.alpha), 0.0)
        if self.nu == 1.0 and np.any(np.abs(memory) * softening > limit):
            raise ModelError(
                f"Initial z = {memory} N/kg is above the largest force of the joint, "
                f"alpha/(delta + |gamma|) = {limit / softening} N/kg.",
                remedy="Start from a smaller |z|, or from rest (z = 0).",
            )

    def doubts(self) -> str | None:
        """Return a warning if Z grows without bound for these parameters."""
        alpha, delta, gamma = (np.asarray(x) for x in (self.alpha, self.delta, self.gamma))
        linear = (delta == 0.0) & (gamma == 0.0)
        conditions = {
            "alpha > 0": alpha > 0.0,
            "delta + gamma > 0": (delta + gamma > 0.0) | linear,
            "gamma >= 0": gamma >= 0.0,
        }
        broken = [name for name, holds in conditions.items() if not np.all(holds)]
        if not broken:
            return None
        return messages.may_diverge(
            tuple(conditions),
            broken,
            {"alpha": self.alpha, "delta": self.delta, "gamma": self.gamma},
        )

    def at_tip(self, y_peak: Scalar) -> Scalar:
        """Return Z at the tip y = Y of the steady hysteresis loop; in closed form for nu = 1."""
        return steady_loop(self, y_peak).z_max if self.nu == 1.0 else super().at_tip(y_peak)

    def loop(self, y_peak: Scalar, omega: Scalar = SLOW) -> Loop:
        """Return the loop's equivalent stiffness and damping; in closed form for nu = 1."""
        if self.nu != 1.0:
            return super().loop(y_peak, omega)
        loop = steady_loop(self, y_peak)
        return Loop(loop.k_eq, loop.c_eq_omega)

    def convert(self, omega_n: float, zeta: float, mass: float) -> dict[str, Conversion]:
        """Return this law in the conventions of Baber-Noori (OpenSees) and of the benchmark."""
        nu = {"nu": self.nu, "restoring": None}
        return conversions(
            SimpleNamespace(omega_n=omega_n, zeta=zeta, **self.parameters(), **nu), mass
        )
