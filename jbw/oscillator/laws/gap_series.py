r"""The Bouc-Wen law in series with a gap: free travel between two contacts.

The memory is the element's force Z and the position s in the gap, $-b \le s \le b$. While |s| < b
there is no force; at a contact the element takes all motion beyond it. A move in the direction
$\sigma$ unloads Z to zero, over the travel

$$D_0 = \frac{\log(1 + (\gamma - \delta)|Z|/\alpha)}{\gamma - \delta},$$

then crosses the gap, then loads the element on the other side. The slope and curvature of the force
jump where Z reaches zero and where contact is made, without any turning point.
"""

from typing import ClassVar

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Complex

from jbw.oscillator import generic
from jbw.oscillator.kinks import Ends, StepPath, barrier, kink_impulse, signed, slope_jump_impulse
from jbw.oscillator.law import Bounds, Law, Loop, Monomial, Scales, Threshold
from jbw.oscillator.laws.bouc_wen import BoucWenLaw
from jbw.oscillator.laws.gap_move import Memory, moved, unloading
from jbw.oscillator.parameters import SLOW, Scalar, beyond_all_motion
from jbw.oscillator.steady.waveform import (
    angle_of,
    crest,
    gauss_legendre,
    over_half_period,
    synthesis,
)
from jbw.quantities import Quantity
from jbw.report.messages import joint as messages

# Prior range of half the gap, relative to the largest displacement: a wider gap never closes.
WIDTH = (0.005, 0.9)
# largest prior stiffness: relative to the stiffness at rest (False), or, under prescribed motion,
# relative to the stiffness of a whole loop (True)
STIFFEST = {False: 2.0, True: 20.0}
_NODES, _NODES_PER_HARMONIC = 32, 4

# whether the element in series with the gap is in contact, and the constant c in the slope of the
# element's force [1/m]
Contact = tuple[Bool[Array, "..."], Scalar]


class GapSeries(Law):
    r"""The Bouc-Wen law with nu = 1 in series with a gap.

    At rest the gap is open and the joint has no stiffness: omega_n is the frequency with an open
    gap, and in contact the stiffness is $\omega_n^2 + \alpha$. A gap wider than all motion never
    acts.

    Attributes:
        gap_stiffness: Stiffness alpha of the element at a contact [1/s^2].
        gap_softening: Delta of the element [1/m].
        gap_opening: Gamma of the element [1/m].
        gap: Half of the free travel, b [m].
    """

    name: ClassVar[str] = "gap_series"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity(
            "gap_stiffness",
            "α_g",
            "1/s^2",
            "stiffness of the joint in series with the gap",
            0.0,
            is_open=True,
        ),
        Quantity("gap_softening", "δ_g", "1/m", "softening of the joint in series with the gap"),
        Quantity("gap_opening", "γ_g", "1/m", "opening of the joint in series with the gap"),
        Quantity("gap", "b", "m", "half of the free travel", 0.0),
    )

    products: ClassVar[tuple[Monomial, ...]] = (
        Monomial(
            Quantity("gap_alpha_delta", "α_g δ_g", "1/(m s^2)", "softening in series with the gap"),
            {"gap_stiffness": 1, "gap_softening": 1},
        ),
        Monomial(
            Quantity("gap_alpha_gamma", "α_g γ_g", "1/(m s^2)", "opening in series with the gap"),
            {"gap_stiffness": 1, "gap_opening": 1},
        ),
    )

    gap_stiffness: Scalar
    gap_softening: Scalar
    gap_opening: Scalar
    gap: Scalar

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        """Return Bouc-Wen's prior bounds, with a stiffness that may exceed omega_n^2."""
        element_bounds, square = BoucWenLaw.prior(scales), scales.omega_n**2
        return {
            "gap_stiffness": (1e-3 * square, STIFFEST[scales.forced] * square),
            "gap_softening": element_bounds["delta"],
            "gap_opening": element_bounds["gamma"],
            "gap": (WIDTH[0] * scales.y_peak, WIDTH[1] * scales.y_peak),
        }

    @classmethod
    def caution(cls, bounds: Bounds, y_peak: float) -> str | None:
        """Return a warning if the prior includes gaps that never close."""
        return beyond_all_motion("gap", bounds["gap"], y_peak)

    def thresholds(self) -> tuple[Threshold, ...]:
        """Return the displacement at which the gap closes."""
        return (Threshold("contact", self.gap, messages.BEHIND_GAP),)

    @property
    def element(self) -> BoucWenLaw:
        """The Bouc-Wen element behind the gap."""
        return BoucWenLaw(self.gap_stiffness, self.gap_softening, self.gap_opening)

    def at_rest(self) -> Memory:
        """Return the internal state at rest: no force, in the middle of the gap."""
        return 0.0, 0.0

    def force(self, y: Scalar, v: Scalar, memory: Memory) -> Scalar:
        """Return the hysteretic force Z [N/kg]."""
        return memory[0]

    def stiffness(self) -> Scalar:
        """Return zero stiffness: at rest the gap is open."""
        return 0.0 * self.gap_stiffness

    def memory_unit(self, omega_n: Scalar) -> Memory:
        """Return factors that convert force and position to velocities: 1 / omega_n, omega_n."""
        return 1.0 / omega_n, omega_n

    def branch(self, v: Scalar, memory: Memory) -> Contact:
        """Return whether there is contact, and the constant c of dZ/dy = alpha - c Z [1/m]."""
        z, s = memory
        outward = (jnp.abs(s) >= self.gap) & (signed(s, v) > 0.0)
        c = signed(self.gap_opening, v) + signed(self.gap_softening, jnp.where(z == 0.0, v, z))
        return (jnp.asarray(z) != 0.0) | outward, c

    def rate(self, y: Scalar, v: Scalar, memory: Memory) -> Memory:
        """Return the time derivatives of the force Z and of the position s in the gap."""
        contact, c = self.branch(v, memory)
        slope = self.gap_stiffness - c * memory[0]
        return jnp.where(contact, slope * v, 0.0), jnp.where(contact, 0.0, v)

    def move(self, y: Scalar, memory: Memory, dy: Scalar) -> Memory:
        """Return the exact internal state after a monotone move."""
        return moved(self, memory, dy).memory

    # -- through a time step -----------------------------------------------------------------------
    def remainder(
        self, h: Scalar, y: Scalar, v: Scalar, memory: Memory, branch: Contact
    ) -> tuple[Scalar, Scalar]:
        """Return the force Z, which has no linear part at rest, and h times the rate of Z."""
        return memory[0], h * v * self._slope(memory[0], branch)

    def bend(
        self, h: Scalar, y: Scalar, v: Scalar, a: Scalar, memory: Memory, branch: Contact
    ) -> Scalar:
        """Return h^2/2 times the second time derivative of Z, with the time step h."""
        slope = self._slope(memory[0], branch)
        return 0.5 * h**2 * slope * (a - branch[1] * v**2)

    def _slope(self, z: Scalar, branch: Contact) -> Scalar:
        contact, c = branch
        return jnp.where(contact, self.gap_stiffness - c * z, 0.0)

    def glide(
        self, y: Scalar, memory: Memory, dy: Scalar, branch: Contact
    ) -> tuple[Memory, Bool[Array, "..."]]:
        """Return the internal state after a step without reversal, and True if contact changed."""
        gap_move = moved(self, memory, dy)
        return gap_move.memory, gap_move.released | gap_move.met

    def turn(
        self, h: Scalar, y: Scalar, memory: Memory, ends: Ends, quartic: Scalar
    ) -> tuple[Memory, Scalar, Scalar]:
        r"""Return the state after a step that may reverse, and the changes of v and y by kinks.

        The constant is $c = \sigma(\gamma - \delta)$ at a release and $\sigma(\gamma + \delta)$ at
        a contact, whose jumps have the opposite sign:

        $$J_1 = \alpha v, \quad J_2 = \alpha (a - c v^2), \quad
          J_3 = \alpha (\dot a - 3 c v a + c^2 v^3)$$
        """
        path = StepPath.through(ends, quartic)
        direction = jnp.where(ends[0] == 0.0, ends[1], ends[0])
        first = moved(self, memory, signed(jnp.abs(path.before), direction))
        second = moved(self, first.memory, path.after)
        at_turn = first.memory
        before = self._slope(at_turn[0], self.branch(ends[0], at_turn))
        after = self._slope(at_turn[0], self.branch(ends[1], at_turn))
        jump = jnp.where(path.turns, after - before, 0.0)
        impulse = kink_impulse(1.0 - path.fraction, jump * path.bend, jump * 6.0 * path.cubic.c_3)
        impulse_v, impulse_y = impulse.v, impulse.y
        opposite = self.gap_opening - self.gap_softening, self.gap_opening + self.gap_softening
        for way, start, here in ((first, 0.0, True), (second, path.before, False)):
            side = signed(1.0, direction if here else path.after)
            kinks = (
                (way.released, way.release, -1.0, side * opposite[0]),
                (way.met, way.meeting, 1.0, side * opposite[1]),
            )
            for happens, travel, sign, c in kinks:
                target = start + side * jnp.where(happens, travel, 0.0)
                s = barrier(jnp.where(happens, path.passage(target, first=here), 1.0))
                v, a, twist = path.cubic.slope(s), path.cubic.bend(s), 6.0 * path.cubic.c_3
                scale = jnp.where(happens, sign * self.gap_stiffness, 0.0)
                more = slope_jump_impulse(
                    1.0 - s,
                    scale * v,
                    scale * (a - c * v**2),
                    scale * (twist - 3.0 * c * v * a + c**2 * v**3),
                )
                impulse_v, impulse_y = barrier((impulse_v + more[0], impulse_y + more[1]))
        return second.memory, impulse_v, impulse_y

    def shift(self, y: Scalar, memory: Memory, dy: Scalar, branch: Contact) -> Memory:
        """Return the state after a small move: Z along its tangent in contact, else the moved s."""
        z, s = memory
        contact, _ = branch
        moved = z + self._slope(z, branch) * dy
        return (
            jnp.where(contact & (moved * s > 0.0), moved, 0.0),
            jnp.where(contact, s, jnp.clip(s + dy, -self.gap, self.gap)),
        )

    # -- along a periodic motion -------------------------------------------------------------------
    def at_tip(self, y_peak: Scalar) -> Memory:
        """Return the internal state at the tip of a loop, where the element is in contact."""
        beyond = jnp.maximum(jnp.asarray(y_peak, float) - self.gap, 0.0)
        return self.element.at_tip(beyond), jnp.minimum(jnp.asarray(y_peak, float), self.gap)

    def loop(self, y_peak: Scalar, omega: Scalar = SLOW) -> Loop:
        r"""Return the equivalent stiffness and damping; the damping from the loss E per cycle.

        The motion is y = Y cos(theta).
        """
        y_peak = jnp.asarray(y_peak, float)
        peak = jnp.where(y_peak > self.gap, y_peak, 1.0)
        acts = y_peak > self.gap
        element_loop = self.element.loop(jnp.where(acts, peak - self.gap, 0.0))
        energy = element_loop.energy(jnp.where(acts, peak - self.gap, 0.0))
        tip = self.at_tip(jnp.where(acts, peak, 0.0))
        release = unloading(self, tip[0])
        displacements = stop_gradient((peak - release, peak - release - 2.0 * self.gap))
        angles = [
            jnp.arccos(jnp.clip(displacement / stop_gradient(peak), -1.0, 1.0))
            for displacement in displacements
        ]
        theta, weights = gauss_legendre(_NODES, jnp.zeros_like(peak), *angles, jnp.pi)
        column = [x[..., None] for x in jnp.broadcast_arrays(peak, tip[0], tip[1])]
        force = self._falling(column[0] * (1.0 - jnp.cos(theta)), (column[1], column[2]))
        real = 2.0 / jnp.pi * jnp.sum(weights * force * jnp.cos(theta), -1) / peak
        damping = energy / (jnp.pi * peak**2)
        return Loop(jnp.where(acts, real, 0.0), jnp.where(acts, damping, 0.0))

    def _falling(self, travel: Scalar, tip: Memory) -> Scalar:
        """Return the joint's force [N/kg] at given travels downwards from the tip of a loop."""
        column = GapSeries(*(jnp.asarray(x)[..., None] for x in self.parameters().values()))
        return moved(column, tip, -travel).memory[0]

    def harmonics(
        self, q: Complex[Array, " harmonic"], max_turns: int, omega: Scalar = SLOW
    ) -> Complex[Array, " harmonic"]:
        """Return the odd harmonics, integrated piecewise between contacts over half a period."""
        if max_turns > 2:
            return generic.harmonics_by_moves(self, q, max_turns, omega)
        fixed = stop_gradient(q)
        start = crest(fixed)
        peak = synthesis(q, start)
        tip = self.at_tip(peak)
        release = unloading(self, tip[0])
        displacements = stop_gradient((peak - release, peak - release - 2.0 * self.gap))
        breaks = (angle_of(fixed, start, displacement) for displacement in displacements)
        num_nodes = _NODES + _NODES_PER_HARMONIC * q.shape[0]

        def falling(y: Array) -> Scalar:
            return moved(self, tip, jnp.minimum(y - peak, 0.0)).memory[0]

        return over_half_period(falling, q, num_nodes, start, *breaks, start + jnp.pi)
