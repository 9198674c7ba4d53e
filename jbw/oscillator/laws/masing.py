r"""Masing laws: all branches follow from a concave virgin (first-loading) curve.

$$F = s F_b(s (y - y_0)) \text{ at first}, \qquad
  F = F_r + 2 s F_b\!\left(\tfrac{s (y - y_r)}{2}\right) \text{ after a reversal at } (y_r, F_r)$$

and a closed branch is forgotten with its reversals. The virgin curve is given by its lag $\ell(x) =
K x - F_b(x)$, the part of the elastic force lost to slip, which is accurate where it is small. The
law is equivalent to a parallel array of sliders of density $-F_b''(\varphi)$.

Reference:
    Masing (1926); Iwan (1966); Mayergoyz (1991) for the closures.
"""

from collections.abc import Callable
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Complex, Float

from jbw.oscillator.kinks import Corner, Ends, StepPath, barrier, kink_impulse, slope_jump_impulse
from jbw.oscillator.law import Law, Loop
from jbw.oscillator.laws.masing_loop import steady_force, steady_harmonics, steady_loop
from jbw.oscillator.laws.reversals import (
    SIZE,
    Branch,
    Entries,
    Stack,
    branch_of,
    closed,
    closes,
    headed,
    nothing_remembered,
)
from jbw.oscillator.parameters import SLOW, Scalar, batched
from jbw.report.messages.joint import SAME_CURVES


class _Move(NamedTuple):
    """A monotone motion of a Masing law: the branches at both ends, and the loops that it closes.

    Attributes:
        begin: Branch at the start, turned into the direction of the move.
        end: Branch at the end.
        popped: Number of reversals that the move has closed.
        closure: Displacement of the last closure [m].
    """

    begin: Branch
    end: Branch
    popped: Scalar
    closure: Scalar


class Masing(Law):
    """The base class of Masing laws; a subclass defines `stiffness`, `lag` and `lag_integral`.

    Attributes:
        depth: Number of reversals that can be remembered; static.
    """

    same_as: ClassVar[str] = SAME_CURVES

    depth: int = eqx.field(default=SIZE, static=True, kw_only=True)

    def lag(self, x: Scalar) -> tuple[Scalar, Scalar]:
        """Return the force lost to slip at x >= 0, K x - F_b [N/kg], and its slope [1/s^2]."""
        raise NotImplementedError

    def lag_integral(self, x: Scalar) -> Scalar:
        """Return the integral of the force lost to slip from 0 to x [J/kg]."""
        raise NotImplementedError

    def kink(self) -> Corner | None:
        """Return the kink of the virgin curve, or None if it is smooth."""
        return None

    def backbone(self, x: Scalar) -> Scalar:
        """Return the force on the virgin curve at x >= 0, F_b [N/kg]."""
        return self.stiffness() * x - self.lag(x)[0]

    # -- motion ------------------------------------------------------------------------------------
    def at_rest(self) -> Branch:
        """Return the state at rest: no load reversals, at the start of the virgin curve."""
        return nothing_remembered(self.depth)

    def force(self, y: Scalar, v: Scalar, memory: Branch) -> Scalar:
        """Return the force on the present branch [N/kg]."""
        return memory.force

    def rate(self, y: Scalar, v: Scalar, memory: Branch) -> Branch:
        """Return the time derivative of the internal state, along the present or a new branch."""
        goes_on = memory.sense * v > 0.0
        slope = self.stiffness() + jnp.where(goes_on, memory.slope, 0.0)
        still = jax.tree.map(lambda x: 0.0 * x * v, memory)
        return still._replace(force=slope * v)

    def move(self, y: Scalar, memory: Branch, dy: Scalar) -> Branch:
        """Return the internal state after a monotone move, exact for any number of closed loops."""
        return self._moved(y, memory, dy).end

    def refreshed(self, y: Scalar, memory: Branch) -> Branch:
        """Return the branch and the force at y, computed again from the load reversals."""
        branch = branch_of(memory.sense, memory.stack)
        force, slope = self._on_branch(branch, y)
        moved = memory.stack.count > 0.5
        return branch._replace(
            force=jnp.where(moved, force, memory.force), slope=jnp.where(moved, slope, 0.0)
        )

    def at_tip(self, y_peak: Scalar) -> Branch:
        """Return the internal state at y = Y on the virgin curve, where the loops' tips lie."""
        y_peak = jnp.asarray(y_peak, float)
        return self.move(0.0 * y_peak, self.at_rest(), y_peak)

    def memory_unit(self, omega_n: Scalar) -> Branch:
        """Return factors from state to velocities: 1/omega_n for forces, omega_n for lengths."""
        # Counters and dependent entries have a small weight: a power of two, because it causes no
        # rounding.
        small = 2.0**-10 + 0.0 * omega_n
        none = 0.0 * omega_n  # `missed` only counts upwards, so it has no part in a steady state.
        stack = Stack(small, small, none, (omega_n,) * self.depth, (1.0 / omega_n,) * self.depth)
        return Branch(small, small, small, small, small, 1.0 / omega_n, small, stack)

    def packed(self, memory: Branch) -> Branch:
        """Return the internal state with load reversals as arrays and counts as integers."""
        stack, size = memory.stack, float(self.depth)
        stack = stack._replace(count=jnp.clip(jnp.round(stack.count), 0.0, size))
        branch = branch_of(jnp.sign(jnp.round(memory.sense)), stack)
        stack = stack._replace(y=jnp.stack(stack.y), f=jnp.stack(stack.f))
        return branch._replace(force=memory.force, slope=memory.slope, stack=stack)

    def unpacked(self, memory: Branch) -> Branch:
        """Return the internal state with its load reversals as scalars."""
        y, f = (tuple(jnp.moveaxis(x, -1, 0)) for x in (memory.stack.y, memory.stack.f))
        return memory._replace(stack=memory.stack._replace(y=y, f=f))

    def guesses(self, memory: Branch) -> Scalar:
        """Return the number of returns to load reversals that were no longer remembered."""
        return memory.stack.missed

    # -- for derivatives ---------------------------------------------------------------------------
    def stack_columns(self, memory: Branch) -> tuple[Entries, Entries]:
        """Return the displacements and the forces of the load reversals."""
        return memory.stack.y, memory.stack.f

    def with_columns(self, y: Scalar, memory: Branch, columns: tuple) -> Branch:
        """Return the branch at y, given the load reversals' displacements and forces."""
        stack = memory.stack._replace(y=columns[0], f=columns[1])
        return self.refreshed(y, memory._replace(stack=stack))

    def turned_or_closed(self, before: Branch, after: Branch) -> Bool[Array, "..."]:
        """Return whether a step has reversed the motion or closed a loop."""
        closed = before.stack.count != after.stack.count
        return jnp.asarray((before.sense != after.sense) | closed)

    def _on_branch(self, memory: Branch, y: Scalar) -> tuple[Scalar, Scalar]:
        """Return the force at y on the present branch, and its slope minus the slope at rest."""
        distance, stretched = memory.sense * (y - memory.y), memory.stretch > 1.5
        lag, slope = self.lag(jnp.maximum(distance, 0.0) * jnp.where(stretched, 0.5, 1.0))
        rest = self.stiffness() * distance - jnp.where(stretched, 2.0, 1.0) * lag
        return memory.f + memory.sense * rest, -slope

    def _moved(self, y: Scalar, memory: Branch, dy: Scalar) -> _Move:
        """Return a monotone move by dy: the branches at both ends, and the loops that it closes."""
        sense, stack = headed(memory.sense, memory.stack, y, memory.force, dy)
        begin = branch_of(sense, stack)._replace(force=memory.force)
        begin, stack = barrier((begin, stack))
        stack, popped, closure = closed(sense, stack, y + dy)
        end = barrier(self.refreshed(y + dy, branch_of(sense, stack)._replace(force=memory.force)))
        return _Move(begin, end, popped, closure)

    # -- through a time step -----------------------------------------------------------------------
    def remainder(
        self, h: Scalar, y: Scalar, v: Scalar, memory: Branch, branch: tuple
    ) -> tuple[Scalar, Scalar]:
        """Return the nonlinear force F - K y, and its rate times the time step h."""
        return memory.force - self.stiffness() * y, h * v * memory.slope

    def bend(
        self, h: Scalar, y: Scalar, v: Scalar, a: Scalar, memory: Branch, branch: tuple
    ) -> Scalar:
        """Return h^2/2 times the second time derivative of F - K y near a reversal."""
        return 0.5 * h**2 * a * memory.slope

    def glide(
        self, y: Scalar, memory: Branch, dy: Scalar, branch: tuple
    ) -> tuple[Branch, Bool[Array, "..."]]:
        """Return the state after a step, and True if it reversed, closed a loop or met a kink."""
        sense, after = memory.sense, y + dy
        force, slope = self._on_branch(memory, after)
        met = (sense * dy <= 0.0) | closes(sense, after, memory.y, memory.closure)
        if (kink := self.kink()) is not None:
            place = kink.y * memory.stretch
            met = met | ((sense * (y - memory.y) < place) & (sense * (after - memory.y) >= place))
        return memory._replace(force=force, slope=slope), met  # pyright: ignore[reportReturnType]

    def turn(
        self, h: Scalar, y: Scalar, memory: Branch, ends: Ends, quartic: Scalar
    ) -> tuple[Branch, Scalar, Scalar]:
        """Return the state after a step with a reversal, and the changes of v and y by kinks."""
        start, end, rise = ends
        # A motion that starts against the branch's direction stems from the correction at the end
        # of the step before. Such a motion is too short for a reversal.
        strays = (memory.sense * start <= 0.0) & (start * end < 0.0)
        path = StepPath.through((jnp.where(strays, 0.0, start), end, rise), quartic)
        first = self._moved(y, memory, path.before)
        last = self.move(y + path.before, first.end, path.after)
        # After a reversal, the new branch starts with the slope at rest.
        jump = jnp.where(path.turns, -first.end.slope, 0.0)
        impulse = kink_impulse(1.0 - path.fraction, jump * path.bend, jump * 6.0 * path.cubic.c_3)
        impulse_v, impulse_y = impulse.v, impulse.y
        for more_v, more_y in self._kinks(y, path, first):
            impulse_v, impulse_y = barrier((impulse_v + more_v, impulse_y + more_y))
        return last, impulse_v, impulse_y

    def shift(self, y: Scalar, memory: Branch, dy: Scalar, branch: tuple) -> Branch:
        """Return the internal state after a small move dy, with the force along its tangent."""
        return memory._replace(force=memory.force + (self.stiffness() + memory.slope) * dy)

    def _kinks(self, y: Scalar, path: StepPath, first: _Move):
        """Yield the effects of loop closure and of the virgin kink on v and y before a reversal."""
        after, closing = first.end, jnp.asarray(first.popped > 0.5)

        def closure():
            inner, outer = (self._on_branch(b, first.closure)[1] for b in (first.begin, after))
            return _slope_jump(path, first.closure - y, outer - inner)

        yield _where_met(closing, closure)
        if (kink := self.kink()) is None:
            return
        place = after.y + after.sense * after.stretch * kink.y
        begun = jnp.where(closing, first.closure, y)
        ahead, passed = place - begun, y + path.before - place
        met = jnp.asarray((after.sense * ahead > 0.0) & (after.sense * passed >= 0.0))

        def macroslip():
            curvature = after.sense * kink.curvature / jnp.maximum(after.stretch, 1.0)
            return _slope_jump(path, place - y, kink.slope, curvature)

        yield _where_met(met, macroslip)

    # -- along a periodic motion -------------------------------------------------------------------
    def loop(self, y_peak: Scalar, omega: Scalar = SLOW) -> Loop:
        r"""Return the loop's stiffness and damping from the lost force, with x = Y sin^2(theta/2).

        theta is the phase on the way from Y to -Y.

        $$\mathrm{Re}\,\kappa = K + \frac{4}{\pi Y}\int_0^\pi \ell(x) \cos\theta\,d\theta, \qquad
          \mathrm{Im}\,\kappa = \frac{4}{\pi Y^2}\left(Y \ell(Y) - 2\int_0^Y \ell\right)$$
        """
        return Loop(*batched(steady_loop, self, y_peak))

    def harmonics(
        self, q: Complex[Array, " harmonic"], max_turns: int, omega: Scalar = SLOW
    ) -> Complex[Array, " harmonic"]:
        """Return the odd harmonics of F - K y, for a motion with two turning points per period."""
        if max_turns > 2:
            return super().harmonics(q, max_turns, omega)
        return steady_harmonics(self, q)

    def force_over_period(
        self,
        q: Complex[Array, " harmonic"],
        theta: Float[Array, " time"],
        max_turns: int,
        omega: Scalar = SLOW,
    ) -> Float[Array, " time"]:
        """Return the exact steady force [N/kg] at angles of a period with two turning points."""
        if max_turns > 2:
            return super().force_over_period(q, theta, max_turns, omega)
        return steady_force(self, q, theta)


def _where_met(
    met: Bool[Array, "..."], impulses: Callable[[], tuple[Scalar, Scalar]]
) -> tuple[Scalar, Scalar]:
    nothing = jax.tree.map(jnp.zeros_like, jax.eval_shape(impulses))
    return jax.lax.cond(met, impulses, lambda: nothing)


def _slope_jump(
    path: StepPath, target: Scalar, slope: Scalar, curvature: Scalar = 0.0
) -> tuple[Scalar, Scalar]:
    """Return the effect on v and y of a jump in the force's slope before the turning point."""
    s = barrier(path.passage(target, first=True))
    speed = path.cubic.slope(s)
    return slope_jump_impulse(
        1.0 - s, slope * speed, slope * path.cubic.bend(s) + curvature * speed**2
    )
