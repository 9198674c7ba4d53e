r"""The Bouc-Wen law with degradation and pinching, as in Baber, Wen and Noori.

Its state is w, the stretch z of the joint's spring relative to that at yield, and e, the dissipated
energy relative to the energy of yield:

$$w = \frac{z}{z_y}, \qquad e = \frac{1}{z_y^2}\int z\,\mathrm{d}y, \qquad F = \alpha z$$

$$\frac{\mathrm{d}z}{\mathrm{d}y} = \frac{h}{\eta}\,\Bigl[1 - \nu\,|w|^n
  \bigl(\beta\,\mathrm{sgn}(\dot y w) + 1 - \beta\bigr)\Bigr], \qquad
  \nu = 1 + \delta_\nu e, \qquad \eta = 1 + \delta_\eta e$$

$$h = 1 - \zeta_1 \exp\Bigl[-\Bigl(\frac{w\,\mathrm{sgn}(\dot y) - q\,w_u}{\zeta_2}\Bigr)^2\Bigr],
  \qquad w_u = \nu^{-1/n}$$

$$\zeta_1 = \zeta_s (1 - e^{-p e}), \qquad
  \zeta_2 = (\psi + \delta_\psi e)(\lambda + \zeta_1)$$

All parameters except alpha and z_y are pure numbers: energies are relative to alpha z_y^2, that of
a slip by z_y under the yield force. The joint changes with every cycle, so no motion is steady. A
steady loop, as for a backbone, is therefore that of the joint before damage, which is Bouc-Wen's
law with the exponent n.

No move has a closed form. Along a record the move is integrated by the Runge-Kutta rule of order 4
in parts; a move of any length uses an adaptive rule of order 8.

Reference:
    Baber and Wen (1981), J. Eng. Mech. Div. 107, 1069; Baber and Noori (1985), J. Eng. Mech. 111,
    1010; Foliente (1995), J. Struct. Eng. 121, 1013.
"""

from typing import Any, ClassVar, NamedTuple

import diffrax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Complex, Float

from jbw.kept_programs import returned
from jbw.oscillator.kinks import Ends, StepPath, kink_impulse, signed
from jbw.oscillator.law import Bounds, Law, Loop, Scales
from jbw.oscillator.laws.bouc_wen import SHARE
from jbw.oscillator.laws.bouc_wen_nu import BoucWenNu
from jbw.oscillator.laws.powers import REFERENCE, power
from jbw.oscillator.parameters import SLOW, Conversion, Material, Scalar, batched, of_opensees
from jbw.quantities import Quantity

# prior range of the stiffness, relative to that of the stiffest measured cycle, which is already
# degraded
WORN_SHARE = (0.01, 2.0)
TOLERANCE = 1e-12  # largest error of z in a move, relative to the stretch at yield
MOST_STEPS = 4096  # largest number of time steps in a move
PARTS = 4  # Runge-Kutta steps in each of many moves along a record
# Settings of OpenSees: tolerance relative to the stretch at yield, and number of iterations.
NEWTON = (1e-10, 100.0)


@returned
class Worn(NamedTuple):
    """The internal state: spring stretch z [m], dissipated energy e relative to alpha z_y^2 [-]."""

    stretch: Scalar
    energy: Scalar


class BWBNPinching(Law):
    r"""The Bouc-Wen law with pinching, but without degradation of strength or stiffness.

    It is the law of OpenSees' material `BWBN`.

    $$\nu = \eta = 1$$

    Attributes:
        bwbn_stiffness: Stiffness alpha of the hysteretic part [1/s^2].
        bwbn_yield: Stretch z_y beyond which the force of a fresh joint no longer grows [m].
        bwbn_n: Exponent n: the larger, the sharper the yield [-].
        bwbn_beta: Part beta of the lost slope that dissipates; gamma is the remaining part [-].
        bwbn_zeta_s: Total slip zeta_s, the largest part of the slope that pinching removes [-].
        bwbn_p: Rate of pinching with energy, p [-].
        bwbn_q: Centre of pinching, relative to the largest stretch that the law reaches, q [-].
        bwbn_psi: Spread of pinching, psi [-].
        bwbn_delta_psi: Growth of the spread with energy, delta_psi [-].
        bwbn_lambda: Spread at little pinching; the larger lambda, the less zeta_1 adds [-].
    """

    name: ClassVar[str] = "bwbn_pinching"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity(
            "bwbn_stiffness", "α_b", "1/s^2", "stiffness of the hysteretic part", 0.0, is_share=True
        ),
        Quantity("bwbn_yield", "z_y", "m", "stretch at yield", 0.0, is_open=True),
        Quantity("bwbn_n", "n", "1", "exponent, sharpness of yield", 0.0, is_open=True),
        Quantity("bwbn_beta", "β", "1", "part of the lost slope that dissipates", 0.0),
        Quantity("bwbn_zeta_s", "ζ_s", "1", "total slip, largest pinching", 0.0),
        Quantity("bwbn_p", "p", "1", "rate of pinching with energy", 0.0),
        Quantity("bwbn_q", "q", "1", "centre of pinching"),
        Quantity("bwbn_psi", "ψ", "1", "spread of pinching", 0.0, is_open=True),
        Quantity("bwbn_delta_psi", "δ_ψ", "1", "growth of the pinching's spread with energy", 0.0),
        Quantity("bwbn_lambda", "λ", "1", "initial spread of pinching, over ψ", 0.0, is_open=True),
    )
    degrades: ClassVar[bool] = True

    bwbn_stiffness: Scalar
    bwbn_yield: Scalar
    bwbn_n: Scalar
    bwbn_beta: Scalar
    bwbn_zeta_s: Scalar
    bwbn_p: Scalar
    bwbn_q: Scalar
    bwbn_psi: Scalar
    bwbn_delta_psi: Scalar
    bwbn_lambda: Scalar

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        """Return prior bounds: z_y within or slightly beyond the motion, any amount of pinching.

        Where the stiffness is that of a secant, the fresh joint may be up to twice as stiff.
        """
        share, peak = WORN_SHARE if scales.forced else SHARE, scales.y_peak
        return {
            "bwbn_stiffness": (share[0] * scales.omega_n**2, share[1] * scales.omega_n**2),
            "bwbn_yield": (0.02 * peak, 2.0 * peak),
            "bwbn_n": (0.5, 4.0),
            "bwbn_beta": (0.05, 1.5),
            "bwbn_zeta_s": (0.0, 0.99),
            "bwbn_p": (0.0, 5.0),
            "bwbn_q": (-0.2, 0.8),
            "bwbn_psi": (0.02, 2.0),
            "bwbn_delta_psi": (0.0, 0.2),
            "bwbn_lambda": (0.02, 2.0),
        }

    def stiffness(self) -> Scalar:
        """Return alpha, the stiffness at rest [1/s^2]."""
        return self.bwbn_stiffness

    def at_rest(self) -> Worn:
        """Return the internal state at rest: an unstretched spring without damage."""
        return Worn(0.0, 0.0)

    def memory_unit(self, omega_n: Scalar) -> Worn:
        """Return factors that convert the state to velocities: omega_n for z, 0 for the energy."""
        return Worn(omega_n, 0.0)

    def force(self, y: Scalar, v: Scalar, memory: Worn) -> Scalar:
        """Return the hysteretic force alpha z [N/kg]."""
        return self.bwbn_stiffness * memory[0]

    def rate(self, y: Scalar, v: Scalar, memory: Worn) -> Worn:
        """Return the time derivatives of the spring's stretch z [m/s] and of the energy e [1/s]."""
        return Worn(v * self.slope(v, memory), v * memory[0] / self.bwbn_yield**2)

    def degradation(self, energy: Scalar) -> tuple[Scalar, Scalar]:
        """Return the degradation factors of strength, nu, and stiffness, eta, at an energy e."""
        return 1.0, 1.0

    def slope(self, v: Scalar, memory: Worn) -> Scalar:
        """Return the slope dz/dy of the spring's stretch for a direction of motion."""
        w, n = memory[0] / self.bwbn_yield, self.bwbn_n
        nu, eta = self.degradation(memory[1])
        dissipating = signed(signed(self.bwbn_beta, v), w)
        lost = nu * power(jnp.abs(w), n) * (dissipating + 1.0 - self.bwbn_beta)
        return self._pinched(signed(w, v), nu, memory[1]) / eta * (1.0 - lost)

    def _pinched(self, ahead: Scalar, nu: Scalar, energy: Scalar) -> Scalar:
        """Return the pinching factor h for the spring's stretch in the direction of motion."""
        slip = -self.bwbn_zeta_s * jnp.expm1(-self.bwbn_p * energy)
        spread = (self.bwbn_psi + self.bwbn_delta_psi * energy) * (self.bwbn_lambda + slip)
        centre = self.bwbn_q * nu ** (-1.0 / self.bwbn_n)
        return 1.0 - slip * jnp.exp(-(((ahead - centre) / spread) ** 2))

    # -- along a path ------------------------------------------------------------------------------
    def move(self, y: Scalar, memory: Worn, dy: Scalar) -> Worn:
        """Return the internal state after a monotone move, with a relative error of 1e-12."""
        return batched(_moved, self, Worn(*memory), dy)

    def follow(self, y: Scalar, memory: Worn, dy: Scalar) -> Worn:
        r"""Return the internal state after a short move, by four Runge-Kutta steps ($O(h^4)$).

        Where z passes zero, the slope has a kink of $|w|^n$, and the error of that step is of the
        order $h^{1+n}$.
        """
        return self._in_parts(memory, dy, PARTS)

    def _in_parts(self, memory: Worn, dy: Scalar, parts: int) -> Worn:
        """Return the internal state after a monotone move, by Runge-Kutta steps of order 4.

        Stages are limited to the largest stretch that the law reaches, so that moves much longer
        than the yield end in slip and not beyond it.
        """
        h = dy / parts
        limit = self._largest(memory)

        def change(memory: Worn) -> Worn:
            return self.rate(0.0, h, memory)

        def moved(memory: Worn, by: Worn, part: float) -> Worn:
            stretch = jnp.clip(memory[0] + part * by[0], -limit, limit)
            return Worn(stretch, memory[1] + part * by[1])

        for _ in range(parts):
            k_1 = change(memory)
            k_2 = change(moved(memory, k_1, 0.5))
            k_3 = change(moved(memory, k_2, 0.5))
            k_4 = change(moved(memory, k_3, 1.0))
            slopes = zip(k_1, k_2, k_3, k_4, strict=True)
            mean = Worn(*((a + 2.0 * b + 2.0 * c + d) / 6.0 for a, b, c, d in slopes))
            memory = moved(memory, mean, 1.0)
        return memory

    def _largest(self, memory: Worn) -> Scalar:
        r"""Return a bound of the spring's stretch: 1.01 max(|initial stretch|, $z_y w_u$) [m]."""
        nu, _ = self.degradation(memory[1])
        ultimate = self.bwbn_yield * nu ** (-1.0 / self.bwbn_n)
        return 1.01 * jnp.maximum(jnp.abs(memory[0]), ultimate)

    # -- through a time step -----------------------------------------------------------------------
    def branch(self, v: Scalar, memory: Worn) -> Scalar:
        """Return the direction of motion, 1 or -1."""
        return signed(1.0, v)

    def glide(
        self, y: Scalar, memory: Worn, dy: Scalar, branch: Scalar
    ) -> tuple[Worn, Bool[Array, "..."] | bool]:
        """Return the internal state after one short step; z may pass zero in it."""
        return self._in_parts(memory, dy, 1), False

    def turn(
        self, h: Scalar, y: Scalar, memory: Worn, ends: Ends, quartic: Scalar
    ) -> tuple[Worn, Scalar, Scalar]:
        """Return the state after a step with a reversal, and how the force's kink changes v, y."""
        path = StepPath.through(ends, quartic)
        top = self._in_parts(memory, path.before, 1)
        jump = self.bwbn_stiffness * (self.slope(path.after, top) - self.slope(path.before, top))
        impulse = kink_impulse(
            1.0 - path.fraction, jnp.where(path.turns, jump * path.bend, 0.0), 0.0
        )
        return self._in_parts(top, path.after, 1), impulse.v, impulse.y

    def shift(self, y: Scalar, memory: Worn, dy: Scalar, branch: Scalar) -> Worn:
        """Return the internal state after a small move, along the tangent of the spring's stretch.

        The change of the energy is of second order and neglected.
        """
        return Worn(memory[0] + self.slope(branch, memory) * dy, memory[1])

    # -- before damage -----------------------------------------------------------------------------
    def undamaged(self) -> BoucWenNu:
        """Return the law before damage (e = 0) and without pinching: Bouc-Wen's with exponent n."""
        lost = power(REFERENCE / self.bwbn_yield, self.bwbn_n)
        softening, opening = (1.0 - self.bwbn_beta) * lost, self.bwbn_beta * lost
        return BoucWenNu(self.bwbn_stiffness, softening, opening, self.bwbn_n)

    def at_tip(self, y_peak: Scalar) -> Worn:
        """Return the internal state at the tip of the steady loop before damage."""
        stretch = self.undamaged().at_tip(y_peak)
        return Worn(stretch, 0.0 * stretch)

    def loop(self, y_peak: Scalar, omega: Scalar = SLOW) -> Loop:
        """Return the equivalent stiffness and damping of the joint before damage."""
        return self.undamaged().loop(y_peak, omega)

    def force_over_period(
        self,
        q: Complex[Array, " harmonic"],
        theta: Float[Array, " time"],
        max_turns: int,
        omega: Scalar = SLOW,
    ) -> Float[Array, " time"]:
        """Return the steady force [N/kg] before damage, at given angles of a period."""
        return self.undamaged().force_over_period(q, theta, max_turns, omega)

    # -- for other programs ------------------------------------------------------------------------
    def convert(self, omega_n: float, zeta: float, mass: float) -> dict[str, Conversion]:
        """Return this law as OpenSees' `BWBN`; its z is the spring's stretch [m], energy in J."""
        return of_opensees(self._card(mass))

    def _card(self, mass: float) -> Material:
        r"""Build the OpenSees material `BWBN`.

        Its command is `uniaxialMaterial BWBN tag alpha ko n gamma beta Ao q zetas p Shi deltaShi
        lambda ...`, with

        $$k_0 = m\alpha, \quad \beta_O = \beta / z_y^n, \quad \gamma_O = (1 - \beta) / z_y^n, \quad
          p_O = \frac{p}{m\alpha z_y^2}, \quad \psi_O = \psi z_y, \quad
          \delta_{\psi O} = \frac{\delta_\psi z_y}{m\alpha z_y^2}$$
        """
        energy, slip = self._yield_energy(mass), self.bwbn_yield
        tolerance, iterations = NEWTON
        return Material(
            "BWBN",
            (
                *self._unworn(mass), self.bwbn_q, self.bwbn_zeta_s, self.bwbn_p / energy,
                self.bwbn_psi * slip, self.bwbn_delta_psi * slip / energy, self.bwbn_lambda,
                tolerance * slip, iterations,
            ),
        )  # fmt: skip

    def _unworn(self, mass: float) -> tuple[Scalar, ...]:
        """Return the arguments common to both OpenSees materials: ratio, k_0, n, gamma, beta, A."""
        lost = self.bwbn_yield**-self.bwbn_n
        gamma, beta = (1.0 - self.bwbn_beta) * lost, self.bwbn_beta * lost
        return 0.0, mass * self.bwbn_stiffness, self.bwbn_n, gamma, beta, 1.0

    def _yield_energy(self, mass: float) -> Scalar:
        """Return m alpha z_y^2 [J], the unit in which the dissipated energy e is stated."""
        return mass * self.bwbn_stiffness * self.bwbn_yield**2


class BWBN(BWBNPinching):
    r"""The Bouc-Wen law with pinching and with degradation of strength and stiffness.

    $$\nu = 1 + \delta_\nu e, \qquad \eta = 1 + \delta_\eta e$$

    Attributes:
        bwbn_delta_nu: Degradation of strength with energy, delta_nu [-].
        bwbn_delta_eta: Degradation of stiffness with energy, delta_eta [-].
    """

    name: ClassVar[str] = "bwbn"
    table: ClassVar[tuple[Quantity, ...]] = (
        *BWBNPinching.table,
        Quantity("bwbn_delta_nu", "δ_ν", "1", "degradation of strength with energy", 0.0),
        Quantity("bwbn_delta_eta", "δ_η", "1", "degradation of stiffness with energy", 0.0),
    )

    bwbn_delta_nu: Scalar
    bwbn_delta_eta: Scalar

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        """Return prior bounds; strength and stiffness at most halve within two units of energy."""
        worn = (0.0, 0.5)
        return {**super().prior(scales), "bwbn_delta_nu": worn, "bwbn_delta_eta": worn}

    def degradation(self, energy: Scalar) -> tuple[Scalar, Scalar]:
        """Return the degradation factors of strength, nu, and of stiffness, eta, at an energy e."""
        return 1.0 + self.bwbn_delta_nu * energy, 1.0 + self.bwbn_delta_eta * energy

    def convert(self, omega_n: float, zeta: float, mass: float) -> dict[str, Conversion]:
        """Return the law as a material of OpenSees; none if it both degrades and pinches."""
        if not self.bwbn_delta_nu and not self.bwbn_delta_eta:
            return super().convert(omega_n, zeta, mass)
        if self.bwbn_zeta_s:
            return {}
        energy = self._yield_energy(mass)
        worn = (0.0, self.bwbn_delta_nu / energy, self.bwbn_delta_eta / energy)
        return of_opensees(Material("BoucWen", (*self._unworn(mass), *worn)))


def _moved(law: BWBNPinching, memory: Worn, dy: Scalar) -> Worn:
    """Return the internal state after a monotone move, by Dormand and Prince's rule of order 8."""

    def rate(part: Scalar, scaled: tuple[Scalar, Scalar], dy: Any) -> tuple[Scalar, Scalar]:
        by = law.rate(0.0, dy, Worn(law.bwbn_yield * scaled[0], scaled[1]))
        return by.stretch / law.bwbn_yield, by.energy

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rate),  # pyright: ignore[reportArgumentType]
        diffrax.Dopri8(),
        t0=0.0,
        t1=1.0,
        dt0=None,
        y0=(memory.stretch / law.bwbn_yield, memory.energy),
        args=dy,
        stepsize_controller=diffrax.PIDController(rtol=TOLERANCE, atol=TOLERANCE),
        adjoint=diffrax.DirectAdjoint(),
        max_steps=MOST_STEPS,
        throw=False,
    )
    scaled, energy = solution.ys  # pyright: ignore[reportGeneralTypeIssues]
    return Worn(law.bwbn_yield * scaled[-1], energy[-1])
