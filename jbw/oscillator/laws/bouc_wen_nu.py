r"""Bouc-Wen's law with its exponent free, by the stretch w = Z / alpha of the joint's spring.

$$\frac{dw}{dy} = 1 - c\,|w / \mathrm{1\,mm}|^\nu, \qquad
  c = d + g\,\mathrm{sgn}(\dot y)\,\mathrm{sgn}(w)$$

With exponents other than 1 the law has no closed map. One step takes the mean of c |w|^nu along the
stretch, of which the integral is known on both sides of w = 0, so that neither the zero nor its
broken power is a kink to it.

Reference:
    Wen (1976); Ismail, Ikhouane and Rodellar (2009), Archives of Computational Methods in
    Engineering 16, 161.
"""

from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Complex, Float

from jbw.oscillator.kinks import Ends, StepPath, kink_impulse, signed
from jbw.oscillator.law import Bounds, Law, Loop, Scales
from jbw.oscillator.laws.bouc_wen import FORCED_SHARE, SHARE
from jbw.oscillator.laws.iwan import REFERENCE, power
from jbw.oscillator.parameters import Scalar, batched
from jbw.oscillator.steady.waveform import synthesis
from jbw.quantities import Quantity

NU = (0.1, 3.0)
_ROUNDS = 3  # of the mean's fixed point
_NODES, _WEIGHTS = (jnp.asarray(x) for x in np.polynomial.legendre.leggauss(48))
_UNIT, _UNIT_WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS
_HALVINGS, _FAR = 60, 16.0  # of the search for the tip's stretch, up to so many amplitudes
_PERIODS = 4  # Newton's steps to the steady stretch


class BoucWenNu(Law):
    r"""Bouc-Wen's law of any exponent; its memory is the stretch w.

    $$d = \delta\,\alpha^{\nu-1}\,\mathrm{(1\,mm)}^\nu, \qquad
      g = \gamma\,\alpha^{\nu-1}\,\mathrm{(1\,mm)}^\nu$$

    Attributes:
        nu_stiffness: Stiffness alpha [1/s^2].
        nu_softening: d, the part of the slope that is lost at a stretch of 1 mm [-].
        nu_opening: g, how much more of it is lost on loading than on unloading, halved [-].
        nu: Exponent [-].

    Reference:
        Eq. (2), with nu free.
    """

    name: ClassVar[str] = "bouc_wen_nu"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity("nu_stiffness", "α_ν", "1/s^2", "stiffness of the hysteretic part", 0.0),
        Quantity("nu_softening", "d_ν", "1", "slope lost at a stretch of 1 mm"),
        Quantity("nu_opening", "g_ν", "1", "opening of the hysteresis loop at 1 mm"),
        Quantity("nu", "ν", "1", "smoothness exponent", 0.0),
    )

    nu_stiffness: Scalar
    nu_softening: Scalar
    nu_opening: Scalar
    nu: Scalar

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        """Softening and opening of order one at the largest displacement, for nu = 1."""
        share, part = FORCED_SHARE if scales.forced else SHARE, REFERENCE / scales.y_peak
        return {
            "nu_stiffness": (share[0] * scales.omega_n**2, share[1] * scales.omega_n**2),
            "nu_softening": (-2.0 * part, 20.0 * part),
            "nu_opening": (0.0, 20.0 * part),
            "nu": NU,
        }

    @classmethod
    def of_bouc_wen(cls, alpha: Scalar, delta: Scalar, gamma: Scalar, nu: Scalar) -> "BoucWenNu":
        """The law of Eq. (2)'s parameters; delta and gamma in kg^(nu-1)/(N^(nu-1) m)."""
        factor = power(alpha, nu - 1.0) * power(REFERENCE, nu)
        return cls(alpha, delta * factor, gamma * factor, nu)

    def stiffness(self) -> Scalar:
        """Alpha [1/s^2]."""
        return self.nu_stiffness

    def at_rest(self) -> Scalar:
        """W = 0 [m]."""
        return 0.0

    def memory_unit(self, omega_n: Scalar) -> Scalar:
        """A displacement times omega_n is a velocity."""
        return omega_n

    def force(self, y: Scalar, v: Scalar, memory: Scalar) -> Scalar:
        """Alpha w [N/kg]."""
        return self.nu_stiffness * memory

    def rate(self, y: Scalar, v: Scalar, memory: Scalar) -> Scalar:
        """Rate of w [m/s]."""
        return v * (1.0 - self._lost(v, memory))

    def move(self, y: Scalar, memory: Scalar, dy: Scalar) -> Scalar:
        """The stretch after a monotone move of any length, by the way that it takes."""
        return batched(_moved, self, memory, dy)

    def _factor(self, v: Scalar, w: Scalar) -> Scalar:
        """Factor c of the part that is lost."""
        return self.nu_softening + signed(signed(self.nu_opening, v), w)

    def _lost(self, v: Scalar, w: Scalar) -> Scalar:
        """Part of the slope that is lost, c |w|^nu."""
        return self._factor(v, w) * power(jnp.abs(w) / REFERENCE, self.nu)

    def _stretched(self, w: Scalar, dy: Scalar) -> Scalar:
        r"""The stretch after a short monotone move, with the mean of $f = c|w|^\nu$ along it.

        $$\bar f = \frac{G(w_1) - G(w)}{w_1 - w} + \frac{\Delta y\,(f_1 - f)^2}{12 (w_1 - w)},
          \qquad G = \frac{c\,w|w|^\nu}{\nu + 1}$$
        """
        lost = self._lost(dy, w)
        integral = lost * w / (self.nu + 1.0)
        end = w + dy * (1.0 - lost)
        for _ in range(_ROUNDS):
            lost_1, rise = self._lost(dy, end), end - w
            moves = jnp.abs(rise) > 1e-12 * (jnp.abs(w) + jnp.abs(end))
            rise = jnp.where(moves, rise, 1.0)
            change = lost_1 * end / (self.nu + 1.0) - integral + dy * (lost_1 - lost) ** 2 / 12.0
            end = w + dy * (1.0 - jnp.where(moves, change / rise, lost))
        return end

    # -- through a time step -----------------------------------------------------------------------
    def branch(self, v: Scalar, memory: Scalar) -> Scalar:
        """Sense of motion."""
        return signed(1.0, v)

    def remainder(
        self, h: Scalar, y: Scalar, v: Scalar, memory: Scalar, branch: Scalar
    ) -> tuple[Scalar, Scalar]:
        """Alpha (w - y), and h times its rate."""
        own = self.nu_stiffness
        return own * (memory - y), -h * own * v * self._lost(v, memory)

    def bend(
        self, h: Scalar, y: Scalar, v: Scalar, a: Scalar, memory: Scalar, branch: Scalar
    ) -> Scalar:
        """Half of h^2 times its second derivative near a turning point, where v is small."""
        return -0.5 * h**2 * self.nu_stiffness * a * self._lost(v, memory)

    def glide(
        self, y: Scalar, memory: Scalar, dy: Scalar, branch: Scalar
    ) -> tuple[Scalar, Bool[Array, "..."] | bool]:
        """By one short move; the zero of w is no kink to it."""
        return self._stretched(memory, dy), False

    def turn(
        self, y: Scalar, memory: Scalar, ends: Ends, quartic: Scalar
    ) -> tuple[Scalar, Scalar, Scalar]:
        """Two short moves, and the impulse of the slope's jump, 2 alpha g |w|^nu."""
        path = StepPath.through(ends, quartic)
        there = self._stretched(memory, path.before)
        jump = self.nu_stiffness * (self._lost(path.before, there) - self._lost(path.after, there))
        found = kink_impulse(1.0 - path.fraction, jnp.where(path.turns, jump * path.bend, 0.0), 0.0)
        return self._stretched(there, path.after), found.v, found.y

    def shift(self, y: Scalar, memory: Scalar, dy: Scalar, branch: Scalar) -> Scalar:
        """The stretch along its tangent."""
        return memory + (1.0 - self._lost(branch, memory)) * dy

    # -- along a periodic motion -------------------------------------------------------------------
    def at_tip(self, y_peak: Scalar) -> Scalar:
        """The stretch at y = Y on the steady loop."""
        return batched(_tip, self, y_peak)

    def loop(self, y_peak: Scalar) -> Loop:
        """Closed integrals of the steady loop, by quadrature."""
        return Loop(*batched(_loop, self, y_peak))

    def force_over_period(
        self, q: Complex[Array, " harmonic"], theta: Float[Array, " time"], max_turns: int
    ) -> Float[Array, " time"]:
        """Force along the period that ends where it starts, by moves between the angles."""
        y = synthesis(q, theta)
        steps = jnp.diff(jnp.append(y, y[0]))

        def onward(w: Array, dy: Array) -> tuple[Any, Any]:
            after = self._stretched(w, dy)
            return after, after

        def end(w: Array) -> Array:
            return jax.lax.scan(onward, w, steps)[0]

        w = jnp.asarray(0.5 * y[0])
        for _ in range(_PERIODS):
            last, slope = jax.jvp(end, (w,), (jnp.ones_like(w),))
            w = w - (last - w) / (slope - 1.0)
        _, after = jax.lax.scan(onward, w, steps)
        return self.nu_stiffness * jnp.append(w, after[:-1])


def _way(c: Scalar, w: Scalar, nu: Scalar, weight: int = 0) -> Scalar:
    r"""$\int_0^w t^m / (1 - c|t/\mathrm{1\,mm}|^\nu)\,dt$ for w >= 0, m the `weight`.

    With t = w s^p, p such that the broken power is at least of second order at s = 0.
    """
    p = jnp.maximum(1.0, 2.0 / nu)
    t = w * power(_UNIT, p)
    bracket = 1.0 - c * power(t / REFERENCE, nu)
    return jnp.sum(_UNIT_WEIGHTS * p * power(_UNIT, p - 1.0) * w * t**weight / bracket)


def _limit(c: Scalar, nu: Scalar) -> Scalar:
    """The stretch at which 1 - c |w|^nu vanishes, that nothing passes."""
    bounded = c > 0.0
    most = power(1.0 / jnp.where(bounded, c, 1.0), 1.0 / nu)
    return jnp.where(bounded, REFERENCE * most, jnp.inf)


def _root(
    left: Callable[[Scalar], Scalar], high: Scalar, slope: Callable[[Scalar], Scalar]
) -> Scalar:
    """Root of a rising function between 0 and `high`, with the derivatives of one Newton's step."""

    def halved(_, pair: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = pair
        middle = 0.5 * (low + high)
        above = left(middle) > 0.0
        return jnp.where(above, low, middle), jnp.where(above, middle, high)

    high = stop_gradient(high)
    low, high = jax.lax.fori_loop(0, _HALVINGS, halved, (0.0 * high, high))
    w = stop_gradient(0.5 * (low + high))
    return w - left(w) / stop_gradient(slope(w))


def _moved(law: BoucWenNu, memory: Scalar, dy: Scalar) -> Scalar:
    """The stretch after a move: down to zero where it goes against it, and up on the other side."""
    w, nu = jnp.asarray(memory, float), law.nu
    against = w * dy < 0.0
    less, more = law.nu_softening - law.nu_opening, law.nu_softening + law.nu_opening
    way, size = jnp.abs(dy), jnp.abs(w)
    to_zero = _way(less, size, nu)
    falls = against & (way < to_zero)
    c = jnp.where(falls, less, more)
    begun = jnp.where(against, 0.0, _way(more, size, nu))
    target = jnp.where(falls, to_zero - way, jnp.where(against, way - to_zero, begun + way))
    high = jnp.minimum(_FAR * target, _limit(c, nu) * (1.0 - 1e-15))
    found = _root(
        lambda one: _way(c, one, nu) - target,
        high,
        lambda one: 1.0 / (1.0 - c * power(one / REFERENCE, nu)),
    )
    sense = jnp.where(falls, signed(1.0, w), signed(1.0, dy))
    return jnp.where(dy == 0.0, w, sense * found)


def _tip(law: BoucWenNu, y_peak: Scalar) -> Scalar:
    r"""Stretch at the tip, $D_{d-g}(w) + D_{d+g}(w) = 2Y$, with D the way from w = 0."""
    peak = jnp.abs(jnp.asarray(y_peak, float))
    less, more = law.nu_softening - law.nu_opening, law.nu_softening + law.nu_opening
    high = jnp.minimum(_FAR * peak, _limit(more, law.nu) * (1.0 - 1e-12))
    found = _root(
        lambda w: _way(less, w, law.nu) + _way(more, w, law.nu) - 2.0 * peak,
        high,
        lambda w: sum(1.0 / (1.0 - c * power(w / REFERENCE, law.nu)) for c in (less, more)),
    )
    return signed(found, jnp.asarray(y_peak, float))


def _loop(law: BoucWenNu, y_peak: Scalar) -> tuple[Scalar, Scalar]:
    r"""Equivalent stiffness and damping of one law; those of rest at Y = 0.

    $$\mathrm{Re}\,\kappa = \frac{2\alpha}{\pi Y}
      \int_{-w_m}^{w_m} \sqrt{1 - (y(w)/Y)^2}\,dw, \qquad
      \mathrm{Im}\,\kappa = \frac{2\alpha}{\pi Y^2} \left(\int_0^{w_m} \frac{t\,dt}{1 - b\,t^\nu}
      - \int_0^{w_m} \frac{t\,dt}{1 - a\,t^\nu}\right)$$

    along the way down from the tip, a = d - g above w = 0 and b = d + g below.
    """
    at_zero = y_peak == 0.0
    peak = jnp.where(at_zero, REFERENCE, y_peak)
    w, own = _tip(law, peak), law.nu_stiffness
    less, more = law.nu_softening - law.nu_opening, law.nu_softening + law.nu_opening
    zero = peak - _way(less, w, law.nu)
    # w_m sin t, with t graded towards the zero of w, where y has a broken power of it.
    t, weights = 0.5 * jnp.pi * _UNIT**3, 1.5 * jnp.pi * _UNIT**2 * _UNIT_WEIGHTS
    stretch = w * jnp.sin(t)
    y = jnp.stack([
        zero + jax.vmap(lambda one: _way(less, one, law.nu))(stretch),
        zero - jax.vmap(lambda one: _way(more, one, law.nu))(stretch),
    ])  # fmt: skip
    height = jnp.sqrt(jnp.maximum(1.0 - (y / peak) ** 2, 1e-300))
    real = 2.0 * own / (jnp.pi * peak) * jnp.sum(weights * w * jnp.cos(t) * height)
    lost = _way(more, w, law.nu, 1) - _way(less, w, law.nu, 1)
    imaginary = 2.0 * own / (jnp.pi * peak**2) * lost
    return jnp.where(at_zero, own, real), jnp.where(at_zero, 0.0, imaginary)
