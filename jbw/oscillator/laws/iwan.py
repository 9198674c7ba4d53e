r"""Masing laws with three virgin curves: a power, Segalman's four parameters, an exponential."""

from typing import Any, ClassVar

import jax.numpy as jnp

from jbw.oscillator.kinks import Corner
from jbw.oscillator.law import Bounds, Conversion, Loop, Monomial, Scales, Threshold
from jbw.oscillator.laws.bouc_wen import FORCED_SHARE, SHARE
from jbw.oscillator.laws.masing import Masing
from jbw.oscillator.laws.powers import PER_REFERENCE, REFERENCE, power, power_loop
from jbw.oscillator.laws.relaxation import exponential_remainder
from jbw.oscillator.parameters import SLOW, Scalar
from jbw.quantities import Quantity

# Prior range of the stiffness loss at the largest displacement, for the usual exponent.
LOSS = (1e-4, 0.3)
_USUAL_EXPONENT = 0.7
SEGALMAN_UNITS = {"K_T": "N/m", "F_S": "N", "chi": "1", "beta": "1", "phi_max": "m"}
EXPONENT = (0.05, 3.0)


class MasingPower(Masing):
    r"""The Masing law whose virgin curve softens by a power, as Iwan's does below macroslip.

    $$F_b = -\kappa\,x\,(x/\mathrm{1\,mm})^q$$

    An elastic part would only move stiffness from the parallel spring into the law. The law has
    none, so that its force is only the part lost to slip, and its stiffness need not be known.

    Attributes:
        loss: Secant stiffness lost at 1 mm, kappa [1/s^2].
        exponent: Exponent q of the loss; the energy per cycle grows with Y^(2+q) [-].
    """

    name: ClassVar[str] = "masing_power"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity("power_loss", "κ₁", "1/s^2", "secant stiffness lost to slip at 1 mm", 0.0),
        Quantity(
            "power_exponent", "q", "1", "exponent of the stiffness lost to slip", 0.0, is_open=True
        ),
    )

    power_loss: Scalar
    power_exponent: Scalar

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        """Return prior bounds of the stiffness loss at the largest motion, for a usual exponent."""
        square, reach = scales.omega_n**2, scales.y_peak / REFERENCE
        low, high = (float(part * square * reach**-_USUAL_EXPONENT) for part in LOSS)
        return {"power_loss": (low, high), "power_exponent": EXPONENT}

    def stiffness(self) -> Scalar:
        """Return zero, because the law contains no elastic force [1/s^2]."""
        return 0.0 * self.power_loss

    def powers_of_length(self) -> dict[str, Scalar]:
        """Return the exponent of length that the loss at 1 mm has in addition to its unit 1/s^2."""
        return {"power_loss": -self.power_exponent}

    def lag(self, x: Scalar) -> tuple[Scalar, Scalar]:
        """Return the force lost to slip, a power of x, and its slope."""
        secant = self.power_loss * power(x * PER_REFERENCE, self.power_exponent)
        return secant * x, (1.0 + self.power_exponent) * secant

    def lag_integral(self, x: Scalar) -> Scalar:
        """Return the integral of the force lost to slip from 0 to x [J/kg]."""
        return self.lag(x)[0] * x / (2.0 + self.power_exponent)

    def loop(self, y_peak: Scalar, omega: Scalar = SLOW) -> Loop:
        """Return equivalent stiffness and damping in closed form, at every amplitude."""
        softening, damping = power_loop(self.power_exponent)
        lost: Any = self.power_loss * power(jnp.asarray(y_peak) / REFERENCE, self.power_exponent)
        return Loop(-softening * lost, damping * lost)


class Iwan4(Masing):
    r"""Iwan's array of sliders with Segalman's four parameters.

    $$\rho(\varphi) = R\varphi^\chi + S\,\delta(\varphi - \varphi_{max}), \qquad
      F_b = K_T x - c\,x^{2+\chi} \text{ below } \varphi_{max}, \quad F_S \text{ beyond}$$
    $$\varphi_{max} = \frac{F_S (1+\beta)}{K_T \left(\beta + \frac{\chi+1}{\chi+2}\right)}, \qquad
      c = \frac{K_T \varphi_{max}^{-(1+\chi)}}{(1+\beta)(2+\chi)}$$

    Below macroslip only c and chi act, and the law is the power law: small motion determines the
    loss at 1 mm, $\kappa = c\,\mathrm{(1\,mm)}^{1+\chi}$, instead of F_S. K_T and beta are then
    only constrained by macroslip lying beyond the motion.

    Attributes:
        iwan_stiffness: Stiffness at rest, K_T [1/s^2].
        iwan_loss: Secant stiffness lost at 1 mm below macroslip, kappa [1/s^2].
        iwan_chi: Exponent chi > -1 of the sliders' density [-].
        iwan_beta: Stiffness of the last sliders to slip over that of all others [-].

    Reference:
        Segalman (2005).
    """

    name: ClassVar[str] = "iwan4"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity(
            "iwan_stiffness",
            "K_T",
            "1/s^2",
            "stiffness of the sliders at rest",
            0.0,
            is_share=True,
            is_open=True,
        ),
        Quantity(
            "iwan_loss", "κ_I", "1/s^2", "secant stiffness lost to slip at 1 mm", 0.0, is_open=True
        ),
        Quantity("iwan_chi", "χ", "1", "exponent of the sliders' density", -1.0, is_open=True),
        Quantity("iwan_beta", "β", "1", "stiffness of the last slider / that of all others", 0.0),
    )

    iwan_stiffness: Scalar
    iwan_loss: Scalar
    iwan_chi: Scalar
    iwan_beta: Scalar

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        """Return prior bounds: K_T relative to omega_n^2, loss and chi as in `MasingPower`."""
        share = FORCED_SHARE if scales.forced else SHARE
        low, high = MasingPower.prior(scales)["power_loss"]
        return {
            "iwan_stiffness": (share[0] * scales.omega_n**2, share[1] * scales.omega_n**2),
            "iwan_loss": (low, high),
            "iwan_chi": (EXPONENT[0] - 1.0, EXPONENT[1] - 1.0),
            "iwan_beta": (0.0, 10.0),
        }

    @classmethod
    def of_segalman(cls, k_t: Scalar, f_s: Scalar, chi: Scalar, beta: Scalar) -> "Iwan4":
        """Return the law from Segalman's parameters: K_T [1/s^2], F_S [N/kg], chi and beta."""
        phi_max = f_s * (1.0 + beta) / (k_t * (beta + (chi + 1.0) / (chi + 2.0)))
        secant = k_t / ((1.0 + beta) * (2.0 + chi))
        return cls(k_t, secant * power(REFERENCE / phi_max, 1.0 + chi), chi, beta)

    @classmethod
    def of_density(cls, phi_max: Scalar, r: Scalar, s: Scalar, chi: Scalar) -> "Iwan4":
        """Return the law of sliders: phi_max [m], R [1/(m^(1+chi) s^2)], S [1/s^2], chi."""
        spread = r * power(phi_max, 1.0 + chi) / (1.0 + chi)
        loss = r * power(REFERENCE, 1.0 + chi) / ((1.0 + chi) * (2.0 + chi))
        return cls(spread + s, loss, chi, s / spread)

    @property
    def phi_max(self) -> Scalar:
        """The displacement of macroslip phi_max, at which all sliders slip [m]."""
        return REFERENCE * power(self._secant / self.iwan_loss, 1.0 / (1.0 + self.iwan_chi))

    @property
    def f_s(self) -> Scalar:
        """The force of macroslip F_S, at which all sliders slip [N/kg]."""
        return (self.iwan_stiffness - self._secant) * self.phi_max

    @property
    def r(self) -> Scalar:
        """The factor R of the sliders' density [1/(m^(1+chi) s^2)]."""
        return self.c * (self.iwan_chi + 1.0) * (self.iwan_chi + 2.0)

    @property
    def s(self) -> Scalar:
        """The stiffness S of the sliders that slip last [1/s^2]."""
        return self.iwan_stiffness * self.iwan_beta / (1.0 + self.iwan_beta)

    @property
    def c(self) -> Scalar:
        """The factor c of the force lost to slip, c x^(2+chi) [1/(m^(1+chi) s^2)]."""
        return self.iwan_loss / power(REFERENCE, 1.0 + self.iwan_chi)

    @property
    def _secant(self) -> Scalar:
        """The secant stiffness lost at macroslip, K_T - F_S / phi_max [1/s^2]."""
        return self.iwan_stiffness / ((1.0 + self.iwan_beta) * (2.0 + self.iwan_chi))

    def convert(self, omega_n: float, zeta: float, mass: float) -> dict[str, Conversion]:
        """Return Segalman's parameters for a modal mass, and the displacement of macroslip."""
        parameters = {"K_T": mass * self.iwan_stiffness, "F_S": mass * self.f_s}
        parameters |= {"chi": self.iwan_chi, "beta": self.iwan_beta, "phi_max": self.phi_max}
        values = {name: float(x) for name, x in parameters.items()}
        return {"Segalman's Iwan": Conversion(values, SEGALMAN_UNITS)}

    def stiffness(self) -> Scalar:
        """Return K_T, the stiffness with all sliders stuck [1/s^2]."""
        return self.iwan_stiffness

    def kink(self) -> Corner:
        """Return the virgin curve's kink at macroslip, where the last sliders slip together."""
        phi_max = self.phi_max
        spread = self.iwan_stiffness / (1.0 + self.iwan_beta)
        return Corner(phi_max, -self.s, spread * (1.0 + self.iwan_chi) / phi_max)

    def powers_of_length(self) -> dict[str, Scalar]:
        """Return the exponent of length that the loss at 1 mm has in addition to its unit 1/s^2."""
        return {"iwan_loss": -1.0 - self.iwan_chi}

    def thresholds(self) -> tuple[Threshold, ...]:
        """Return the displacement of macroslip; smaller motions depend only on the loss and chi."""
        return (Threshold("macroslip", self.phi_max, "K_T, F_S and beta"),)

    def lag(self, x: Scalar) -> tuple[Scalar, Scalar]:
        """Return the force lost to slip (K_T x - F_S beyond macroslip), and its slope."""
        sticks = x < self.phi_max
        below = jnp.minimum(x, self.phi_max)
        secant = self.iwan_loss * power(below * PER_REFERENCE, 1.0 + self.iwan_chi)
        lag = jnp.where(sticks, secant * x, self.iwan_stiffness * x - self.f_s)
        return lag, jnp.where(sticks, (2.0 + self.iwan_chi) * secant, self.iwan_stiffness)

    def lag_integral(self, x: Scalar) -> Scalar:
        """Return the integral of the force lost to slip from 0 to x [J/kg]."""
        phi_max = self.phi_max
        below = jnp.minimum(x, phi_max)
        slips = self.iwan_stiffness * (x + below) / 2.0 - self.f_s
        secant = self._secant * power(below / phi_max, 1.0 + self.iwan_chi)
        return secant * below**2 / (3.0 + self.iwan_chi) + (x - below) * slips

    def loop(self, y_peak: Scalar, omega: Scalar = SLOW) -> Loop:
        """Return the equivalent stiffness and damping.

        They are in closed form below macroslip, and by quadrature beyond it.
        """
        y_peak, q = jnp.asarray(y_peak, float), 1.0 + self.iwan_chi
        below, part = y_peak <= self.phi_max, y_peak / self.phi_max
        softening, damping = power_loop(q)
        lost = self._secant * power(jnp.minimum(part, 1.0), q)
        beyond = super().loop(y_peak, omega)
        return Loop(
            jnp.where(below, self.iwan_stiffness - softening * lost, beyond.stiffness),
            jnp.where(below, damping * lost, beyond.damping),
        )


class MasingExponential(Masing):
    r"""The Masing law with an exponential virgin curve, which Bouc-Wen's law can also have.

    $$F_b = \frac{\alpha}{b}\left(1 - e^{-b x}\right)$$

    Attributes:
        exponential_alpha: Stiffness at rest [1/s^2].
        exponential_b: Rate of softening [1/m].
    """

    name: ClassVar[str] = "masing_exponential"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity(
            "exponential_alpha",
            "α_e",
            "1/s^2",
            "stiffness of the joint at rest",
            0.0,
            is_share=True,
        ),
        Quantity("exponential_b", "b", "1/m", "rate of softening of the virgin curve", 0.0),
    )

    products: ClassVar[tuple[Monomial, ...]] = (
        Monomial(
            Quantity("exponential_alpha_b", "α_e b", "1/(m s^2)", "softening at rest, alpha * b"),
            {"exponential_alpha": 1, "exponential_b": 1},
        ),
    )

    exponential_alpha: Scalar
    exponential_b: Scalar

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        """Return prior bounds of alpha relative to omega_n^2, and of b relative to 1 / `y_peak`."""
        share = FORCED_SHARE if scales.forced else SHARE
        low, high = (float(part * scales.omega_n**2) for part in share)
        return {
            "exponential_alpha": (low, high),
            "exponential_b": (0.02 / scales.y_peak, 20.0 / scales.y_peak),
        }

    def stiffness(self) -> Scalar:
        """Return alpha, the stiffness at rest [1/s^2]."""
        return self.exponential_alpha

    def lag(self, x: Scalar) -> tuple[Scalar, Scalar]:
        """Return the force lost to slip, alpha x s E_2(s) with s = b x, and its slope.

        This form has no cancellation.
        """
        s = jnp.asarray(self.exponential_b * x, float)
        alpha = self.exponential_alpha
        return alpha * x * s * exponential_remainder(2, s), alpha * s * exponential_remainder(1, s)

    def lag_integral(self, x: Scalar) -> Scalar:
        """Return the integral of the force lost to slip, alpha x^2 s E_3(s) [J/kg]."""
        s = jnp.asarray(self.exponential_b * x, float)
        return self.exponential_alpha * x**2 * s * exponential_remainder(3, s)
