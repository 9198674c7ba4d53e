r"""Iwan's array with sliders whose sliding force is lower than the force at which slip begins.

A slider sticks up to its limit and slides at a lower force. Its force drops when it begins to
slide, and must rise to the limit again before it slides the next time. Therefore a closed inner
loop is not forgotten, and a stack of reversals cannot describe the array. Its sliders are followed
one by one, in time and along paths. The law is not in the register: nothing fits it.

Reference:
    Mignolet, Song and Wang (2015), Journal of Sound and Vibration 349, 289; the densities of
    Segalman (2005). The five-parameter law of Segalman and Starr (2004), which smooths macroslip,
    is different: any concave virgin curve, see `given_backbone`.
"""

from typing import ClassVar, NamedTuple, NoReturn

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jbw.errors import ModelError
from jbw.kept_programs import returned
from jbw.oscillator.kinks import Ends, StepPath, kink_impulse
from jbw.oscillator.law import Branch, Law, Loop
from jbw.oscillator.laws.iwan import Iwan4
from jbw.oscillator.laws.powers import REFERENCE, power
from jbw.oscillator.laws.stretch_path import UNIT_RULE
from jbw.oscillator.parameters import SLOW, Scalar
from jbw.quantities import Quantity

COUNT = 1000
GRADING = 2  # Edges of the bins of slip limits are evenly spaced numbers to this power.
# Integration points of a loop are evenly spaced numbers to this power, which concentrates them near
# 0.
_GRADED = 3
# Factor that keeps the argument of the arcsine below 1, because the arcsine has no derivative at 1.
_WITHIN = 1.0 - 1e-14


@returned
class SliderStretches(NamedTuple):
    """The stretch of every slider's spring [m], and its sliding direction (0 if stuck)."""

    stretch: Float[Array, " slider"]
    slides: Float[Array, " slider"]


class Iwan5(Law):
    r"""Sliders that stick up to phi and slide at theta phi, with the densities of `Iwan4`.

    $$\rho(\varphi) = R\varphi^\chi + S\,\delta(\varphi - \varphi_{max}), \qquad
      F_b(u) = \vartheta \int_0^u \varphi\,\rho\,d\varphi + u \int_u^\infty \rho\,d\varphi$$

    With theta = 1 it is `Iwan4`. A finite number of sliders represents the density, each with the
    stiffness and the moment of its bin: the error of virgin curves and loops falls with the square
    of their number, and linearly where a bin is about to slide. Stepped in time they begin to slide
    one by one, each within its step: errors are 6e-4, 2e-4 and 1e-4 of the largest motion with one,
    two and four steps per sample where theta is 0.8 and a period has 40 samples.

    Attributes:
        iwan_stiffness: Stiffness at rest, K_T [1/s^2].
        iwan_loss: Secant stiffness that `Iwan4` of the same limits loses at 1 mm [1/s^2].
        iwan_chi: Exponent chi > -1 of the sliders' density [-].
        iwan_beta: Stiffness of the last sliders to slip over that of all others [-].
        iwan_theta: Sliding force over sticking limit, above 0, at most 1 [-].
        count: Number of sliders.
    """

    name: ClassVar[str] = "iwan5"
    table: ClassVar[tuple[Quantity, ...]] = (
        *Iwan4.table,
        Quantity("iwan_theta", "ϑ", "1", "sliding force / sticking limit", 0.0),
    )

    iwan_stiffness: Scalar
    iwan_loss: Scalar
    iwan_chi: Scalar
    iwan_beta: Scalar
    iwan_theta: Scalar
    count: int = eqx.field(default=COUNT, static=True)

    @property
    def sticking(self) -> Iwan4:
        """The Iwan law with the sliders' sticking limits (theta = 1)."""
        return Iwan4(self.iwan_stiffness, self.iwan_loss, self.iwan_chi, self.iwan_beta)

    def array(self) -> tuple[Float[Array, " slider"], Float[Array, " slider"]]:
        """Return each slider's stiffness [1/s^2] and slip limit [m]; the last slider slips last."""
        edge = self.sticking.phi_max * jnp.linspace(0.0, 1.0, self.count) ** GRADING
        stiffness, moment = jnp.diff(self._zeroth(edge)), jnp.diff(self._first(edge))
        limit = jnp.append(moment / stiffness, self.sticking.phi_max)
        return jnp.append(stiffness, self._lump), limit

    def stiffness(self) -> Scalar:
        """Return K_T, the stiffness with all sliders stuck [1/s^2]."""
        return self.iwan_stiffness

    def at_rest(self) -> SliderStretches:
        """Return the internal state at rest: no slider is stretched."""
        return SliderStretches(jnp.zeros(self.count), jnp.zeros(self.count))

    def force(self, y: Scalar, v: Scalar, memory: SliderStretches) -> Scalar:
        """Return the sum of the sliders' forces [N/kg]."""
        return memory.stretch @ self.array()[0]

    def move(self, y: Scalar, memory: SliderStretches, dy: Scalar) -> SliderStretches:
        """Return each spring's stretch after a monotone move, exact for each slider."""
        limit = self.array()[1]
        way = jnp.sign(jnp.asarray(dy, float))
        stuck_stretch = memory.stretch + dy
        goes_on = (memory.slides == way) & (way != 0.0)
        slides = goes_on | (way * stuck_stretch >= limit)
        stretch = jnp.where(slides, way * self.iwan_theta * limit, stuck_stretch)
        direction = jnp.where(way == 0.0, memory.slides, jnp.where(slides, way, 0.0))
        return SliderStretches(stretch, direction)

    def virgin(self, x: Scalar) -> Scalar:
        """Return the force [N/kg] of the first loading to x >= 0, in closed form."""
        most, theta = self.sticking.phi_max, self.iwan_theta
        q, last = jnp.minimum(x, most), self._lump * jnp.where(x < most, x, theta * most)
        return theta * self._first(q) + x * (self._spread - self._zeroth(q)) + last

    def unloading(self, y_peak: Scalar, by: Scalar) -> Scalar:
        r"""Return the steady loop's force [N/kg] at a distance D back from the tip Y (closed form).

        $$F = -\vartheta M_1(p) + \vartheta (M_1(q) - M_1(p)) - D (M_0(q) - M_0(p))
          + (Y - D)(M_0(\infty) - M_0(q)), \qquad M_n(x) = \int_0^x \varphi^n \rho\,d\varphi$$

        with p = D/(1 + theta) and q = Y, both limited to Y and phi_max; the last sliders likewise.
        """
        most, theta = self.sticking.phi_max, self.iwan_theta
        q = jnp.minimum(y_peak, most)
        p = jnp.minimum(by / (1.0 + theta), q)
        gone = theta * (self._first(q) - 2.0 * self._first(p))
        stuck = by * (self._zeroth(q) - self._zeroth(p))
        never = (y_peak - by) * (self._spread - self._zeroth(q))
        slid = jnp.where(by < (1.0 + theta) * most, theta * most - by, -theta * most)
        return gone - stuck + never + self._lump * jnp.where(y_peak < most, y_peak - by, slid)

    def loop(self, y_peak: Scalar, omega: Scalar = SLOW) -> Loop:
        r"""Return the equivalent stiffness and damping of the steady loop, summed over sliders.

        With r = phi/Y, and the angle at which it begins to slide, $\cos c = 1 - (1 +
        \vartheta)\,r$, a sliding slider of unit stiffness has

        $$\mathrm{Re}\,\kappa = \frac{2}{\pi}\Bigl[(2\vartheta r - 1)\sin c
          + \frac{c + \sin c\cos c}{2}\Bigr], \qquad
          E = 4\vartheta\varphi Y - (1 + \vartheta)(3\vartheta - 1)\,\varphi^2$$

        The sum of E over the density has a closed form. The sum of the stiffness is computed by
        Gauss's rule in c, graded towards 0, where the integrand has a fractional power.
        """
        y_peak = jnp.asarray(y_peak, float)
        at_zero = y_peak == 0.0
        peak = jnp.where(at_zero, REFERENCE, y_peak)
        most, theta, chi = self.sticking.phi_max, self.iwan_theta, self.iwan_chi
        reach = jnp.minimum(peak, most)
        # stiffness of the sliders that slip last, if they do
        last = jnp.where(peak < most, 0.0, self._lump)
        end = _drop(theta, reach / peak)

        def part(node: Scalar, weight: Scalar) -> Scalar:
            c, ratio = end * node**_GRADED, 2.0 * jnp.sin(0.5 * end * node**_GRADED) ** 2
            phi = peak * ratio / (1.0 + theta)
            density = (chi + 1.0) * self._zeroth(phi) / ratio
            by_node = _GRADED * end * node ** (_GRADED - 1) * jnp.sin(c)
            return weight * by_node * density * _slider_stiffness(theta, c)

        slides = jnp.sum(jax.vmap(part)(*map(jnp.asarray, UNIT_RULE)), axis=0)
        slides = slides + last * _slider_stiffness(theta, end)
        sticks = self._spread - self._zeroth(reach) + self._lump - last
        first = self._first(reach) + last * most
        second = (chi + 1.0) / (chi + 3.0) * reach**2 * self._zeroth(reach) + last * most**2
        energy = 4.0 * theta * peak * first - (1.0 + theta) * (3.0 * theta - 1.0) * second
        return Loop(
            jnp.where(at_zero, self.iwan_stiffness, sticks + slides),
            jnp.where(at_zero, 0.0, energy / (jnp.pi * peak**2)),
        )

    def rate(self, y: Scalar, v: Scalar, memory: SliderStretches) -> SliderStretches:
        """Return the stretch rate of stuck sliders' springs [m/s]; `move` handles force drops."""
        stays = memory.slides * v > 0.0
        return SliderStretches(jnp.where(stays, 0.0, v), jnp.zeros_like(memory.slides))

    def turn(
        self, h: Scalar, y: Scalar, memory: SliderStretches, ends: Ends, quartic: Scalar
    ) -> tuple[SliderStretches, Scalar, Scalar]:
        """Return the state of the sliders after a step that may reverse, and kinks' effect on v, y.

        After a reversal, all sliders are stuck.
        """
        path = StepPath.through(ends, quartic)
        at_turn = self.move(y, memory, path.before)
        regained = jnp.sum(self.array()[0] * jnp.abs(at_turn.slides))
        impulse = kink_impulse(
            1.0 - path.fraction, jnp.where(path.turns, regained * path.bend, 0.0), 0.0
        )
        return self.move(y + path.before, at_turn, path.after), impulse.v, impulse.y

    def shift(
        self, y: Scalar, memory: SliderStretches, dy: Scalar, branch: Branch
    ) -> SliderStretches:
        """Return the sliders after a small correction, which moves only the stuck ones."""
        stretch = memory.stretch + jnp.where(memory.slides == 0.0, dy, 0.0)
        return SliderStretches(stretch, memory.slides)

    def memory_unit(self, omega_n: Scalar) -> NoReturn:
        """Raise an error, because periodic motion of the many sliders is not supported."""
        raise ModelError(
            "The periodic motion of the law `iwan5` is not supported: each slider has its own "
            "state.",
            remedy="Use `backbone` for the law `iwan5`, or simulate until the motion repeats.",
        )

    def scaled(self, length: Scalar, stiffness: Scalar) -> NoReturn:
        """Raise an error, because harmonic balance does not support this law."""
        self.memory_unit(length)

    # -- the density of the sliders ----------------------------------------------------------------
    @property
    def _spread(self) -> Scalar:
        """The total stiffness of all sliders except those that slip last [1/s^2]."""
        return self.iwan_stiffness / (1.0 + self.iwan_beta)

    @property
    def _lump(self) -> Scalar:
        """The stiffness of the sliders that slip last [1/s^2]."""
        return self.sticking.s

    def _zeroth(self, x: Scalar) -> Scalar:
        """Return the moment M_0 of the density up to x <= phi_max [1/s^2]."""
        return self._spread * power(x / self.sticking.phi_max, self.iwan_chi + 1.0)

    def _first(self, x: Scalar) -> Scalar:
        """Return the moment M_1 of the density up to x <= phi_max [N/kg]."""
        return (self.iwan_chi + 1.0) / (self.iwan_chi + 2.0) * x * self._zeroth(x)


def _drop(theta: Scalar, ratio: Scalar) -> Scalar:
    """Return the phase [rad] at which sliders with limit `ratio` times the peak begin to slip."""
    return 2.0 * jnp.arcsin(jnp.sqrt(0.5 * (1.0 + theta) * ratio * _WITHIN))


def _slider_stiffness(theta: Scalar, c: Scalar) -> Scalar:
    """Return the equivalent stiffness of a slider of unit stiffness that slips from angle c on."""
    ratio = 2.0 * jnp.sin(0.5 * c) ** 2 / (1.0 + theta)
    sine = jnp.sin(c)
    return 2.0 / jnp.pi * ((2.0 * theta * ratio - 1.0) * sine + 0.5 * (c + sine * jnp.cos(c)))
