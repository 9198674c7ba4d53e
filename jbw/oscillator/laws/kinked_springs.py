r"""Springs whose slope or curvature jumps at some displacements: stops, and the force y|y|."""

from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Complex

from jbw.oscillator import generic
from jbw.oscillator.kinks import Corner, Ends, StepPath, barrier, signed, slope_jump_impulse
from jbw.oscillator.law import Bounds, Loop, Scales, Threshold
from jbw.oscillator.laws.springs import Spring, bounds_of_power
from jbw.oscillator.parameters import (
    SLOW,
    Conversion,
    Material,
    Scalar,
    beyond_all_motion,
    of_opensees,
)
from jbw.oscillator.steady.waveform import (
    angle_of,
    crest,
    over_half_period,
)
from jbw.quantities import Quantity

# Prior of a stop's stiffness relative to the linear stiffness, from an opening contact to a pin.
STOP_SHARE = (-0.5, 2.0)
# Prior of the gap relative to the largest displacement; a stop without gap is a linear spring.
STOP_GAP = (0.02, 1.0)
_NODES, _NODES_PER_HARMONIC = 16, 4


class KinkedSpring(Spring):
    """The base class of odd springs with corners; steps and integrals end at each corner."""

    def corners(self) -> tuple[Corner, ...]:
        """Return the corners of the spring, in order of falling displacement."""
        raise NotImplementedError

    def even_part(self) -> None:
        """Return None: the force of an odd spring has no even part."""

    # -- through a time step -----------------------------------------------------------------------
    @property
    def kinked(self) -> bool:
        """Whether the law has kinks: always."""
        return True

    def glide(
        self, y: Scalar, memory: tuple[()], dy: Scalar, branch: tuple[()]
    ) -> tuple[tuple[()], Bool[Array, "..."]]:
        """Return the empty internal state, and True if the step passes through a corner."""
        passed = ((y > corner.y) != (y + dy > corner.y) for corner in self.corners())
        return (), jnp.any(jnp.stack([jnp.asarray(crossed) for crossed in passed]), 0)

    def turn(
        self, h: Scalar, y: Scalar, memory: tuple[()], ends: Ends, quartic: Scalar
    ) -> tuple[tuple[()], Scalar, Scalar]:
        r"""Return the changes of v and y by the corners passed before and after the reversal.

        From the jumps of f' and f'' at a corner, the jumps of the force's time derivatives are

        $$J_1 = f'\,|v|, \quad J_2 = \mathrm{sgn}(v)\,(f' a + f'' v^2), \quad
          J_3 = \mathrm{sgn}(v)\,(f' \dot a + 3 f'' v a)$$
        """
        path = StepPath.through(ends, quartic)
        cubic = path.cubic
        corner = Corner(*(jnp.stack([jnp.asarray(x) for x in column])
                          for column in zip(*self.corners(), strict=True)))  # fmt: skip
        top = y + path.before
        impulse_v, impulse_y = 0.0, 0.0
        for first, start, stop in ((True, y, top), (False, top, y + ends[2])):
            passes = (start > corner.y) != (stop > corner.y)
            s = barrier(jnp.where(passes, path.passage(corner.y - y, first=first), 1.0))
            v, a, twist = cubic.slope(s), cubic.bend(s), 6.0 * cubic.c_3
            slope, curvature = (
                jnp.where(passes, signed(jump, stop - start), 0.0) for jump in corner[1:]
            )
            on_v, on_y = slope_jump_impulse(
                1.0 - s,
                slope * v,
                slope * a + curvature * v**2,
                slope * twist + 3.0 * curvature * v * a,
            )
            impulse_v, impulse_y = barrier((impulse_v + on_v, impulse_y + on_y))
        return (), jnp.sum(impulse_v), jnp.sum(impulse_y)

    # -- along a periodic motion -------------------------------------------------------------------
    def harmonics(
        self, q: Complex[Array, " harmonic"], max_turns: int, omega: Scalar = SLOW
    ) -> Complex[Array, " harmonic"]:
        """Return the odd harmonics, integrated piecewise between the corners over half a period."""
        if max_turns > 2:
            return generic.harmonics_by_moves(self, q, max_turns, omega)
        fixed = stop_gradient(q)
        start = crest(fixed)
        displacements = (stop_gradient(jnp.asarray(corner.y, float)) for corner in self.corners())
        breaks = (angle_of(fixed, start, displacement) for displacement in displacements)
        num_nodes = _NODES + _NODES_PER_HARMONIC * q.shape[0]
        return over_half_period(self, q, num_nodes, start, *breaks, start + jnp.pi)


class Quadratic(KinkedSpring):
    r"""Stiffness that changes with the magnitude of the displacement, $f(y) = c\,y|y|$ [N/kg].

    Attributes:
        c: Quadratic stiffness, negative if it softens [1/(m s^2)].
    """

    name: ClassVar[str] = "quadratic"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity(
            "quadratic",
            "c₂",
            "1/(m s^2)",
            "stiffness that changes with the size of the displacement",
        ),
    )
    fields: ClassVar[Mapping[str, str]] = {"quadratic": "c"}

    c: Scalar

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        """Return prior bounds of c, from the linear force."""
        return bounds_of_power("quadratic", 2, scales)

    def __call__(self, y: Scalar) -> Scalar:
        """Return the force at the displacement y [m]."""
        return self.c * y * jnp.abs(y)

    def corners(self) -> tuple[Corner, ...]:
        """Return the corner at rest, y = 0, where f'' = 2 c sgn(y) jumps."""
        return (Corner(0.0 * self.c, 0.0 * self.c, 4.0 * self.c),)

    def loop(self, y_peak: Scalar, omega: Scalar = SLOW) -> Loop:
        r"""Return the equivalent stiffness in closed form, $\kappa = 8 c Y / (3\pi)$."""
        stiffness = 8.0 / (3.0 * jnp.pi) * self.c * jnp.asarray(y_peak, float)
        return Loop(stiffness, jnp.zeros_like(stiffness))  # pyright: ignore[reportArgumentType]


class Stop(KinkedSpring):
    r"""A two-sided stop, $f(y) = K\,\mathrm{sgn}(y)\,\max(|y| - \delta, 0)$ [N/kg].

    A pin that makes contact stiffens (K > 0); an interface that opens softens (K < 0).

    Attributes:
        k: Stiffness beyond the gap [1/s^2].
        gap: Displacement delta at which the stop begins to act [m].
    """

    name: ClassVar[str] = "stop"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity("stop_stiffness", "K_P", "1/s^2", "stiffness of the stop"),
        Quantity("stop_gap", "δ_P", "m", "displacement at which the stop begins to act", 0.0),
    )
    fields: ClassVar[Mapping[str, str]] = {"stop_stiffness": "k", "stop_gap": "gap"}

    k: Scalar
    gap: Scalar

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        """Return prior bounds: stiffness of either sign, and gaps within the motion."""
        least, most = (share * scales.omega_n**2 for share in STOP_SHARE)
        near, far = (share * scales.y_peak for share in STOP_GAP)
        return {"stop_stiffness": (least, most), "stop_gap": (near, far)}

    @classmethod
    def caution(cls, bounds: Bounds, y_peak: float) -> str | None:
        """Return a warning if the prior includes stops that the motion never reaches."""
        return beyond_all_motion("stop_gap", bounds["stop_gap"], y_peak)

    def thresholds(self) -> tuple[Threshold, ...]:
        """Return the displacement at which the stop begins to act."""
        return (Threshold("the stop", self.gap, "its stiffness"),)

    def __call__(self, y: Scalar) -> Scalar:
        """Return the force at the displacement y [m]."""
        return self.k * (y - jnp.clip(y, -self.gap, self.gap))

    def corners(self) -> tuple[Corner, ...]:
        """Return the corners on both sides where the stop begins to act."""
        none = 0.0 * self.k
        return Corner(self.gap, self.k, none), Corner(-self.gap, -self.k, none)

    def loop(self, y_peak: Scalar, omega: Scalar = SLOW) -> Loop:
        r"""Return the equivalent stiffness beyond the gap, with $c = \arccos(\delta/Y)$.

        $$\kappa = \frac{K}{\pi}\,(2c - \sin 2c)$$
        """
        y_peak = jnp.asarray(y_peak, float)
        acts = y_peak > self.gap
        c = jnp.arccos(jnp.where(acts, self.gap / jnp.where(acts, y_peak, 1.0), 0.5))
        stiffness = jnp.where(acts, self.k / jnp.pi * (2.0 * c - jnp.sin(2.0 * c)), 0.0)
        return Loop(stiffness, jnp.zeros_like(stiffness))

    def convert(self, omega_n: float, zeta: float, mass: float) -> dict[str, Conversion]:
        """Return this law as a piecewise linear material of OpenSees with four points."""
        gap, force = float(self.gap), mass * self.k * float(self.gap)
        points = ("-strain", -2 * gap, -gap, gap, 2 * gap, "-stress", -force, 0.0, 0.0, force)
        return of_opensees(Material("ElasticMultiLinear", points))
