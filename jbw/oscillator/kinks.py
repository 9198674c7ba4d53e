r"""Kinks of a law inside a time step (v or z passes zero), and their effect on the motion.

Displacement within a step of length h is a cubic in $s \in [0, 1]$; slopes are per step.
"""

from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jbw.oscillator.parameters import Scalar

# Slopes h v at the start and the end of a step, and the displacement in between; or derivatives
# with respect to these three.
Ends = tuple[Scalar, Scalar, Scalar]


def signed(magnitude: Scalar, sign: Scalar) -> Float[Array, "..."]:
    """Return a magnitude with the sign of another number; zero counts as positive."""
    return jnp.where(sign < 0.0, -magnitude, magnitude)


def barrier(values: Any) -> Any:
    """Return the values unchanged, so that XLA computes them only once."""
    # A barrier is set around one value at a time, because a barrier for several values cannot be
    # transposed if some are not linear.
    return jax.tree.map(jax.lax.optimization_barrier, values)


class CubicPath(NamedTuple):
    r"""The displacement path $y(s) - y(0) = c_1 s + c_2 s^2 + c_3 s^3$ [m] of a step."""

    c_1: Scalar
    c_2: Scalar
    c_3: Scalar

    def move(self, s: Scalar) -> Scalar:
        """Return the displacement since the start of the step [m]."""
        return s * (self.c_1 + s * (self.c_2 + s * self.c_3))

    def slope(self, s: Scalar) -> Scalar:
        """Return the first derivative of the path with respect to s, h v [m]."""
        return self.c_1 + s * (2.0 * self.c_2 + 3.0 * s * self.c_3)

    def bend(self, s: Scalar) -> Scalar:
        """Return the second derivative of the path with respect to s, h^2 dv/dt [m]."""
        return 2.0 * self.c_2 + 6.0 * s * self.c_3


class Corner(NamedTuple):
    """A displacement where the slope and curvature of a force's curve jump, with the jumps.

    Attributes:
        y: Displacement [m].
        slope: Jump of the slope [1/s^2].
        curvature: Jump of the curvature [1/(m s^2)].
    """

    y: Scalar
    slope: Scalar
    curvature: Scalar


def hermite_basis(s: Scalar) -> tuple[Ends, Ends, Ends]:
    """Return derivatives of displacement, slope and curvature at s with respect to path ends."""
    s_2 = s * s
    s_3 = s * s_2
    return (
        (s - 2.0 * s_2 + s_3, s_3 - s_2, 3.0 * s_2 - 2.0 * s_3),
        (1.0 - 4.0 * s + 3.0 * s_2, 3.0 * s_2 - 2.0 * s, 6.0 * (s - s_2)),
        (6.0 * s - 4.0, 6.0 * s - 2.0, 6.0 - 12.0 * s),
    )


class StepPath(NamedTuple):
    """The displacement along a time step that may contain one turning point.

    Attributes:
        cubic: Its cubic part.
        turns: Whether the path turns.
        fraction: Step fraction of the turning point; 1 if the path does not turn.
        bend: Second derivative at the turning point, h^2 dv/dt [m].
        before: Move from the start to the turning point [m].
        after: Move from the turning point to the end [m].
        quartic: Quartic term of the path [m].
        sharpness: Absolute value of `bend` [m]; 2 if the path does not turn.
    """

    cubic: CubicPath
    turns: Bool[Array, "..."]
    fraction: Scalar
    bend: Scalar
    before: Scalar
    after: Scalar
    quartic: Scalar
    sharpness: Scalar

    @classmethod
    def through(cls, ends: Ends, quartic: Scalar) -> Self:
        r"""Return the path with given slopes and displacement, and a quartic term if it turns.

        Of the two roots $s = c_1/(-c_2 \pm \sqrt{c_2^2 - 3 c_1 c_3})$ of the cubic's slope the one
        in (0, 1) is the turning point, if the slopes at the ends have opposite signs. The square
        root is half of |y''| there.
        """
        start, end, rise = ends
        turns = jnp.asarray(start * end < 0.0)
        c_1, c_2, c_3 = cubic = barrier(
            CubicPath(start, 3.0 * rise - 2.0 * start - end, start + end - 2.0 * rise)
        )
        square = c_2**2 - 3.0 * c_1 * c_3
        root = barrier(jnp.sqrt(jnp.where(turns, jnp.maximum(square, 1e-300), 1.0)))
        s = c_1 / jnp.where(turns, signed(root, c_1) - c_2, 1.0)
        fraction = barrier(jnp.where(turns, s, 1.0))
        weight = (fraction * (1.0 - fraction)) ** 2
        before = barrier(jnp.where(turns, cubic.move(fraction) + quartic * weight, rise))
        bend = cubic.bend(fraction)
        return cls(cubic, turns, fraction, bend, before, rise - before, quartic, 2.0 * root)

    def passage(self, target: Scalar, *, first: bool) -> Scalar:
        """Return the fraction of the step where the path reaches `target`, before or after turning.

        Newton's iteration takes three steps, from the parabola about the turning point, or from the
        chord if the path does not turn. Only the last step carries the derivative.
        """
        fixed, aim = jax.lax.stop_gradient((self, target))
        part = fixed.before if first else fixed.after
        rest = aim if first else aim - fixed.before
        done = jnp.clip(rest / jnp.where(part == 0.0, 1.0, part), 0.0, 1.0)
        if first:
            bent = jnp.where(fixed.turns, 1.0 - jnp.sqrt(1.0 - done), done)
            s = fixed.fraction * bent
        else:
            s = fixed.fraction + (1.0 - fixed.fraction) * jnp.sqrt(done)
        for _ in range(3):
            s = barrier(jnp.clip(fixed._nearer(s, aim), 0.0, 1.0))
        return self._nearer(s, target)

    def _nearer(self, s: Scalar, target: Scalar) -> Scalar:
        """Return a better estimate of when the path reaches `target`, by one Newton step."""
        weight = s * (1.0 - s)
        move = self.cubic.move(s) + self.quartic * weight**2
        slope = self.cubic.slope(s) + 2.0 * self.quartic * weight * (1.0 - 2.0 * s)
        return s - (move - target) / jnp.where(slope == 0.0, 1.0, slope)


class KinkImpulse(NamedTuple):
    """The change of v [m/s] and of y / h [m/s] that a force kink causes, with its derivatives."""

    v: Scalar
    y: Scalar
    v_slopes: tuple[Scalar, Scalar, Scalar]
    y_slopes: tuple[Scalar, Scalar, Scalar]


def kink_impulse(x: Scalar, jump_2: Scalar, jump_3: Scalar) -> KinkImpulse:
    r"""Return the changes of v and y by a force kink within a step, beyond the cubic prediction.

    With jumps J_2, J_3 of the second and third derivative of r when a fraction x remains, given as
    h^3 J_2 and h^4 J_3 [m/s],

    $$\int_0^h (r - H)\,ds = \tfrac{h^3}{12} J_2\,x(1-x)(1-2x) + \tfrac{h^4}{24} J_3\,x^2(1-x)^2$$
    $$\int_0^h (h - s)(r - H)\,ds = \tfrac{h^4}{120} J_2\,x(1-x)(4 - 5x - 5x^2)
      + \tfrac{h^5}{120} J_3\,x^2(1-x)^2(2 + x)$$

    and the response of v and y to a force r is minus these. All weights vanish at x = 0 and 1, so
    the step stays continuous in its parameters.
    """
    weight = x * (1.0 - x)
    v_2, v_3 = -weight * (1.0 - 2.0 * x) / 12.0, -(weight**2) / 24.0
    y_2 = -weight * (4.0 - 5.0 * x - 5.0 * x**2) / 120.0
    y_3 = -(weight**2) * (2.0 + x) / 120.0
    v_x = jump_2 * (weight / 2.0 - 1.0 / 12.0) - jump_3 * weight * (1.0 - 2.0 * x) / 12.0
    y_x = (
        -(jump_2 * (4.0 - 18.0 * x + 20.0 * x**3) + jump_3 * weight * (4.0 - 5.0 * x - 5.0 * x**2))
        / 120.0
    )
    impulse_v, impulse_y = v_2 * jump_2 + v_3 * jump_3, y_2 * jump_2 + y_3 * jump_3
    return KinkImpulse(impulse_v, impulse_y, (v_x, v_2, v_3), (y_x, y_2, y_3))


def slope_jump_impulse(
    x: Scalar, jump_1: Scalar, jump_2: Scalar, jump_3: Scalar = 0.0
) -> tuple[Scalar, Scalar]:
    r"""Return the changes of v and y by a jump in the force's slope, as at the onset of slip.

    The jumps are given as h J_1, h^2 J_2 and h^3 J_3 [N/kg]; the impulses are those on v over h and
    on y over h^2 [m/s^2]:

    $$\int_0^h (r - H)\,ds = h^2 J_1
      \left(\tfrac{x^2}{2} - \tfrac{x}{2} + \tfrac{1}{12}\right) + \dots$$
    $$\int_0^h (h - s)(r - H)\,ds
      = h^3 J_1 \left(\tfrac{x^3}{6} - \tfrac{3x}{20} + \tfrac{1}{30}\right) + \dots$$
    """
    impulse = kink_impulse(x, jump_2, jump_3)
    v = impulse.v - jump_1 * (0.5 * x * (x - 1.0) + 1.0 / 12.0)
    y = impulse.y - jump_1 * (x * (x**2 / 6.0 - 0.15) + 1.0 / 30.0)
    return v, y


def cusp_impulse(start: tuple[Scalar, ...], end: tuple[Scalar, ...]) -> tuple[Scalar, Scalar]:
    r"""Return the changes of v and y by a power-law kink in the rate of the force.

    F_0 = r' and its first three integrals from the kink are given at both ends of the step, for
    steps of length one. The impulses are those on v over h and on y over h^2 [m/s^2]:

    $$\int_0^1 (r - H)\,ds = [F_2] - \tfrac12 (F_1 + F_1') + \tfrac1{12} [F_0]$$
    $$\int_0^1 (1 - s)(r - H)\,ds = [F_3] - F_2 - \tfrac7{20} F_1 - \tfrac3{20} F_1'
      - \tfrac1{20} F_0 + \tfrac1{30} F_0'$$

    with primes at the end and brackets for the change; the response is minus these.
    """
    (a_0, a_1, a_2, a_3), (b_0, b_1, b_2, b_3) = start, end
    v = (a_2 - b_2) + 0.5 * (a_1 + b_1) + (a_0 - b_0) / 12.0
    y = (a_3 - b_3) + a_2 + 0.35 * a_1 + 0.15 * b_1 + 0.05 * a_0 - b_0 / 30.0
    return v, y
