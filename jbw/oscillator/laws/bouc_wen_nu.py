r"""The Bouc-Wen law with any exponent, in terms of its spring's stretch w = Z / alpha.

$$\frac{dw}{dy} = 1 - c\,|w / \mathrm{1\,mm}|^\nu, \qquad
  c = d + g\,\mathrm{sgn}(\dot y)\,\mathrm{sgn}(w)$$

With exponents other than 1 the law has no closed map. One step uses the means of the powers of c
|w|^nu along the stretch, whose integrals are known on both sides of w = 0. The zero and its
fractional power are therefore no kink of the step; the error of the time step's cubics from that
power is known too.

Reference:
    Wen (1976); Ismail, Ikhouane and Rodellar (2009), Archives of Computational Methods in
    Engineering 16, 161.
"""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jax.scipy.special import gammaln
from jaxtyping import Array, Bool, Complex, Float

import jbw.oscillator.laws.stretch_path as stretch_path
from jbw.oscillator.kinks import Ends, StepPath, cusp_impulse, kink_impulse, signed
from jbw.oscillator.law import Bounds, Law, Loop, Monomial, Scales
from jbw.oscillator.laws.bouc_wen import FORCED_SHARE, SHARE
from jbw.oscillator.laws.conversions import bouc_wen
from jbw.oscillator.laws.powers import REFERENCE, power, power_loop
from jbw.oscillator.parameters import SLOW, Conversion, Scalar, batched, of_opensees
from jbw.oscillator.rare import where_rare
from jbw.oscillator.steady.waveform import synthesis
from jbw.quantities import Quantity
from jbw.report.messages.joint import SAME_EXPONENT

NU = (0.1, 3.0)
_ROUNDS = 2  # number of Newton steps that solve for the spring's stretch after a short move
# If the spring's stretch w changes by more than this fraction in a step, |w|^nu is not taken as
# linear.
_NEAR = 0.03
_TINY = 1e-9  # smallest slope of the force, relative to the slope at rest; it replaces zero
_PARTS = 8  # number of parts into which a move along a record is divided
# longest undivided move, relative to the spring's stretch at which the slope vanishes, and number
# of parts into which a longer move is divided
_SHORT, _MANY_PARTS = 0.05, 32
# The search for the stretch at a steady loop's tip begins at or below this fraction of its limit.
_INSIDE = 0.9
_PERIODS = 4  # number of Newton steps that solve for the spring's stretch in the steady loop


def weak_loop(nu: Scalar) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    r"""Return a small loop's stiffness loss and damping, per unit delta or gamma and (alpha Y)^nu.

    $$C_s = \frac{4 I(\nu + 2)}{\pi (\nu + 1)}, \qquad C_d = \frac{4}{\pi (\nu + 2)}$$
    """
    nu = jnp.asarray(nu, float)
    integral = 0.5 * jnp.sqrt(jnp.pi) * jnp.exp(gammaln(0.5 * (nu + 3.0)) - gammaln(0.5 * nu + 2.0))
    return 4.0 / jnp.pi * integral / (nu + 1.0), 4.0 / jnp.pi / (nu + 2.0)


class BoucWenNu(Law):
    r"""The Bouc-Wen law with any exponent, whose internal state is the stretch w of its spring.

    $$d = \delta\,\alpha^{\nu-1}\,\mathrm{(1\,mm)}^\nu, \qquad
      g = \gamma\,\alpha^{\nu-1}\,\mathrm{(1\,mm)}^\nu$$

    Attributes:
        nu_stiffness: Stiffness alpha [1/s^2].
        nu_softening: d, the part of the slope that is lost at a stretch of 1 mm [-].
        nu_opening: g, half of the difference between the parts lost on loading and unloading [-].
        nu: Exponent [-].

    Reference:
        Eq. (2), with nu free.
    """

    name: ClassVar[str] = "bouc_wen_nu"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity(
            "nu_stiffness", "α_ν", "1/s^2", "stiffness of the hysteretic part", 0.0, is_share=True
        ),
        Quantity("nu_softening", "d_ν", "1", "slope lost at a stretch of 1 mm"),
        Quantity("nu_opening", "g_ν", "1", "opening of the hysteresis loop at 1 mm"),
        Quantity("nu", "ν", "1", "smoothness exponent", 0.0, is_open=True),
    )

    same_as: ClassVar[str] = SAME_EXPONENT
    products: ClassVar[tuple[Monomial, ...]] = (
        Monomial(
            Quantity("nu_alpha_d", "α_ν d_ν", "1/s^2", "stiffness lost at a stretch of 1 mm"),
            {"nu_stiffness": 1, "nu_softening": 1},
        ),
        Monomial(
            Quantity("nu_alpha_g", "α_ν g_ν", "1/s^2", "loop opening at 1 mm, times stiffness"),
            {"nu_stiffness": 1, "nu_opening": 1},
        ),
    )

    nu_stiffness: Scalar
    nu_softening: Scalar
    nu_opening: Scalar
    nu: Scalar

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        """Return prior bounds that allow softening and loop opening of order one at large motion.

        The bounds refer to the largest displacement and to nu = 1.
        """
        share, part = FORCED_SHARE if scales.forced else SHARE, REFERENCE / scales.y_peak
        return {
            "nu_stiffness": (share[0] * scales.omega_n**2, share[1] * scales.omega_n**2),
            "nu_softening": (-2.0 * part, 20.0 * part),
            "nu_opening": (0.0, 20.0 * part),
            "nu": NU,
        }

    @classmethod
    def of_bouc_wen(cls, alpha: Scalar, delta: Scalar, gamma: Scalar, nu: Scalar) -> "BoucWenNu":
        """Return the law from Eq. (2)'s parameters; delta, gamma in kg^(nu-1)/(N^(nu-1) m)."""
        factor = power(alpha, nu - 1.0) * power(REFERENCE, nu)
        return cls(alpha, delta * factor, gamma * factor, nu)

    @classmethod
    def of_masing(cls, alpha: Scalar, loss: Scalar, exponent: Scalar) -> "BoucWenNu":
        r"""Return the law that equals, at small motion, a Masing law with a power-law loss.

        $$\nu = q, \qquad \alpha d = \kappa\,C_s^M / C_s, \qquad
          \alpha g = \kappa\,C_d^M / C_d$$

        Args:
            alpha: Stiffness; that of the Masing law, if it has one [1/s^2].
            loss: Secant stiffness kappa that the Masing law loses at 1 mm [1/s^2].
            exponent: Exponent q of the loss; 1 + chi for Iwan's law.
        """
        (softens, opens), (own_softens, own_opens) = power_loop(exponent), weak_loop(exponent)
        softening, opening = loss * softens / own_softens, loss * opens / own_opens
        return cls(alpha, softening / alpha, opening / alpha, exponent)

    def stiffness(self) -> Scalar:
        """Return alpha, the stiffness at rest [1/s^2]."""
        return self.nu_stiffness

    def at_rest(self) -> Scalar:
        """Return the spring's stretch at rest, w = 0 [m]."""
        return 0.0

    def powers_of_length(self) -> dict[str, Scalar]:
        """Return the powers of length to add to the units of the parameters stated at 1 mm."""
        names = ("nu_softening", "nu_opening", "nu_alpha_d", "nu_alpha_g")
        return dict.fromkeys(names, -self.nu)

    def memory_unit(self, omega_n: Scalar) -> Scalar:
        """Return omega_n, which converts the internal state, a displacement, to a velocity."""
        return omega_n

    def convert(self, omega_n: float, zeta: float, mass: float) -> dict[str, Conversion]:
        """Return this law as OpenSees' Bouc-Wen material, whose z is the spring's stretch w [m]."""
        lost = (c / REFERENCE**self.nu for c in (self.nu_softening, self.nu_opening))
        return of_opensees(bouc_wen(mass * self.nu_stiffness, self.nu, *lost))

    def force(self, y: Scalar, v: Scalar, memory: Scalar) -> Scalar:
        """Return the hysteretic force alpha w [N/kg]."""
        return self.nu_stiffness * memory

    def rate(self, y: Scalar, v: Scalar, memory: Scalar) -> Scalar:
        """Return the time derivative of the spring's stretch w [m/s]."""
        return v * (1.0 - self._lost(v, memory))

    def move(self, y: Scalar, memory: Scalar, dy: Scalar) -> Scalar:
        """Return the spring's stretch after the joint moves monotonically by dy of any length."""
        return batched(stretch_path.moved, self, memory, dy)

    def follow(self, y: Scalar, memory: Scalar, dy: Scalar) -> Scalar:
        """Return the spring's stretch after one of many moves along a record, in eight steps.

        With 250 samples per cycle the error is 1e-6 of the largest stretch for nu >= 0.5, and 2e-4
        for nu = 0.1, whose force bends sharply at w = 0.
        """
        part = dy / _PARTS
        for _ in range(_PARTS):
            memory = self._stretched(memory, part)
        return memory

    def _factors(self) -> tuple[Array, Array]:
        """Return the factors c of the slope 1 - c |w|^nu, for motion to and away from w = 0."""
        less, more = self.nu_softening - self.nu_opening, self.nu_softening + self.nu_opening
        return jnp.asarray(less), jnp.asarray(more)

    def _factor(self, v: Scalar, w: Scalar) -> Scalar:
        """Return the factor c in f = c |w|^nu, the fraction of the slope that is lost."""
        return self.nu_softening + signed(signed(self.nu_opening, v), w)

    def _lost(self, v: Scalar, w: Scalar) -> Scalar:
        """Return the lost fraction of the slope, f = c |w|^nu."""
        return self._factor(v, w) * power(jnp.abs(w) / REFERENCE, self.nu)

    def _powers(self, v: Scalar, w: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """Return the lost fraction f of the slope, and the integrals of f and f^2 from 0 to w."""
        lost = self._lost(v, w)
        return lost, lost * w / (self.nu + 1.0), lost**2 * w / (2.0 * self.nu + 1.0)

    def _stretched(self, w: Scalar, dy: Scalar) -> Scalar:
        r"""Return the spring's stretch after a small displacement step, from the moments of f(w).

        $$w_1 = w + \frac{\Delta y}{\langle 1/(1 - f)\rangle}, \qquad
          \Bigl\langle\frac{1}{1 - f}\Bigr\rangle = \frac{1}{1 - m}
          \Bigl(1 + \frac{\mu}{(1 - m)^2} + \dots\Bigr)$$

        over the stretch, by Newton steps. Away from w = 0, where f is nearly linear, $\mu = (f_1 -
        f)^2 / 12$ is used because its rounding is small.
        """
        lost, mean, square = self._powers(dy, w)
        end = w + dy * (1.0 - lost)
        for _ in range(_ROUNDS):
            lost_1, mean_1, square_1 = self._powers(dy, end)
            size, rise = jnp.abs(w) + jnp.abs(end), end - w
            moves, near = jnp.abs(rise) > 1e-12 * size, jnp.abs(rise) > _NEAR * size
            over = 1.0 / jnp.where(moves, rise, 1.0)
            m = jnp.where(moves, (mean_1 - mean) * over, lost)
            spread = jnp.where(near, (square_1 - square) * over - m**2, (lost_1 - lost) ** 2 / 12.0)
            rest = jnp.where(m == 1.0, _TINY, 1.0 - m)
            iterate = w + dy * rest / (1.0 + spread / rest**2)
            # Most of the change of m comes from f, the lost part of the slope, at the step's end.
            end = end + (iterate - end) / (1.0 + jnp.maximum((lost_1 - m) / rest, -0.5))
        return end

    # -- through a time step -----------------------------------------------------------------------
    def branch(self, v: Scalar, memory: Scalar) -> Scalar:
        """Return the direction of motion, 1 or -1."""
        return signed(1.0, v)

    def remainder(
        self, h: Scalar, y: Scalar, v: Scalar, memory: Scalar, branch: Scalar
    ) -> tuple[Scalar, Scalar]:
        """Return the force alpha (w - y), and its rate times the time step h."""
        alpha = self.nu_stiffness
        return alpha * (memory - y), -h * alpha * v * self._lost(v, memory)

    def bend(
        self, h: Scalar, y: Scalar, v: Scalar, a: Scalar, memory: Scalar, branch: Scalar
    ) -> Scalar:
        """Return h^2/2 times the second time derivative of alpha (w - y) near a reversal."""
        return -0.5 * h**2 * self.nu_stiffness * a * self._lost(v, memory)

    def glide(
        self, y: Scalar, memory: Scalar, dy: Scalar, branch: Scalar
    ) -> tuple[Scalar, Bool[Array, "..."] | bool]:
        """Return the spring's stretch after one short step; w = 0 needs no special treatment."""
        return self._stretched(memory, dy), False

    def turn(
        self, h: Scalar, y: Scalar, memory: Scalar, ends: Ends, quartic: Scalar
    ) -> tuple[Scalar, Scalar, Scalar]:
        """Return the spring's stretch after a reversal, and the changes of v and y due to its kink.

        The force's slope jumps by 2 alpha g |w|^nu at the kink.
        """
        path = StepPath.through(ends, quartic)
        w_turn = self._stretched(memory, path.before)
        jump = self.nu_stiffness * (
            self._lost(path.before, w_turn) - self._lost(path.after, w_turn)
        )
        impulse = kink_impulse(
            1.0 - path.fraction, jnp.where(path.turns, jump * path.bend, 0.0), 0.0
        )
        return self._stretched(w_turn, path.after), impulse.v, impulse.y

    def shift(self, y: Scalar, memory: Scalar, dy: Scalar, branch: Scalar) -> Scalar:
        """Return the spring's stretch after a small move dy, by the tangent of w(y)."""
        return memory + (1.0 - self._lost(branch, memory)) * dy

    def missed(
        self, h: Scalar, start: tuple[Scalar, Scalar], end: tuple[Scalar, Scalar]
    ) -> tuple[Scalar, Scalar]:
        r"""Return the effects on v and y of $r' = -\alpha h v f$ near w = 0, for linear w(t).

        Far from w = 0 the result would be rounding and is set to zero.
        """
        (v, w), (v_1, w_1) = start, end
        rise = w_1 - w
        near = (jnp.abs(rise) > _NEAR * (jnp.abs(w) + jnp.abs(w_1))) & (v * v_1 > 0.0)
        over = 1.0 / jnp.where(near, rise, 1.0)
        rate = jnp.where(near, -0.5 * self.nu_stiffness * h * (v + v_1), 0.0)

        def integrals(w: Scalar) -> tuple[Scalar, ...]:
            f_k = [rate * self._lost(v, w)]
            for k in (1, 2, 3):
                f_k.append(f_k[-1] * (w * over) / (self.nu + k))
            return tuple(f_k)

        return cusp_impulse(integrals(w), integrals(w_1))

    # -- along a periodic motion -------------------------------------------------------------------
    def at_tip(self, y_peak: Scalar) -> Scalar:
        """Return the spring's stretch at the tip y = Y of the steady loop."""
        return batched(stretch_path.tip, self, y_peak)

    def loop(self, y_peak: Scalar, omega: Scalar = SLOW) -> Loop:
        """Return the steady loop's stiffness and damping, by quadrature of exact integrals."""
        return Loop(*batched(stretch_path.loop, self, y_peak))

    def force_over_period(
        self,
        q: Complex[Array, " harmonic"],
        theta: Float[Array, " time"],
        max_turns: int,
        omega: Scalar = SLOW,
    ) -> Float[Array, " time"]:
        """Return the steady force [N/kg] at angles of a period, by moves from angle to angle."""
        y = synthesis(q, theta)
        steps = jnp.diff(jnp.append(y, y[0]))
        fixed = stop_gradient((self, steps))

        def toward(w: Array, last: Array, slope: Array) -> Array:
            # The spring's stretch converges within a period; in long slip, rounding makes the slope
            # arbitrary.
            return w - (last - w) / (jnp.where(jnp.abs(slope) < 1.0, slope, 0.0) - 1.0)

        def newton(_: Any, state: tuple[Array, Array]) -> tuple[Array, Array]:
            w, _ = state
            last, slope = jax.jvp(lambda w: _along(*fixed, w)[0], (w,), (jnp.ones_like(w),))
            return toward(w, last, slope), slope

        # Start within the limit of the spring's stretch, since the search diverges from outside.
        limit = stretch_path.stretch_limit(jnp.maximum(*self._factors()), self.nu)
        w = stop_gradient(jnp.clip(0.5 * y[0], -_INSIDE * limit, _INSIDE * limit))
        w, slope = jax.lax.fori_loop(0, _PERIODS, newton, (w, jnp.zeros_like(w)))
        # These two steps do not change the value of the solution; they make its first and second
        # derivatives correct.
        for _ in range(2):
            w = toward(w, _along(self, steps, w)[0], slope)
        _, after = _along(self, steps, w)
        return self.nu_stiffness * jnp.append(w, after[:-1])  # pyright: ignore[reportReturnType]


def _along(law: BoucWenNu, steps: Float[Array, " time"], w: Array) -> tuple[Array, Array]:
    """Return the spring's stretch after several moves in a row, and after each of these moves."""
    # Divide long moves, because one step between two angles may miss the short range in which slip
    # begins.
    most = jnp.max(jnp.abs(jnp.stack(law._factors())))
    longest = _SHORT * stretch_path.stretch_limit(most, law.nu)

    def onward(w: Array, dy: Array) -> tuple[Any, Any]:
        is_long = jnp.abs(dy) > longest
        after = where_rare(is_long, _in_parts, (law, w, dy), law._stretched(w, dy))
        return after, after

    return jax.lax.scan(onward, w, steps)


def _in_parts(operands: tuple[BoucWenNu, Scalar, Scalar]) -> Scalar:
    """Return the spring's stretch w after a move dy of any length, computed as many short moves."""
    law, w, dy = operands
    part = dy / _MANY_PARTS
    return jax.lax.fori_loop(0, _MANY_PARTS, lambda _, at: law._stretched(at, part), w)
