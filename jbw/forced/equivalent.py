r"""Equivalent stiffness and loss of a joint against amplitude, for many posterior draws.

At the displacement amplitude Y, the fundamental force per unit mass that sustains the motion is

$$\frac{F_1}{Y} = K(Y) - \omega^2 + j\,(c\,\omega + D(Y)), \qquad c = 2\zeta\omega_n$$

With one harmonic, K and D are those of the law's steady loop. With more, the higher harmonics are
eliminated at each amplitude, and K and D depend slightly on the frequency as well.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float
from numpy.typing import NDArray

from jbw.errors import ConfigError, ModelError
from jbw.oscillator.checks import require_contracts, require_float64
from jbw.oscillator.modes.structure import Structure
from jbw.oscillator.oscillator import Joint, Oscillator, as_oscillator
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.steady.waveform import crest, orders, synthesis

Values = NDArray[np.float64]
LANES = 128  # number of points in a compiled call, whatever the number of draws
STEP = 1e-4  # relative step of amplitude or frequency in finite differences
# change of a harmonic, relative to Y, at which its iteration ends, and largest number of iterations
CONDENSED, MOST_STEPS = 1e-13, 60


class EquivalentLoops(NamedTuple):
    """Equivalent stiffness and loss at given amplitudes, with their slopes.

    The loss is linearised in the frequency about that of the evaluation, D + c omega, so that a
    velocity-dependent force acts as viscous damping at its amplitude.

    Attributes:
        stiffness: K [1/s^2].
        loss: D [1/s^2].
        viscous: c, including the damper of the mode [1/s].
        stiffness_by_y: dK/dY [1/(m s^2)].
        loss_by_y: dD/dY [1/(m s^2)].
        viscous_by_y: dc/dY [1/(m s)].
    """

    stiffness: Values
    loss: Values
    viscous: Values
    stiffness_by_y: Values
    loss_by_y: Values
    viscous_by_y: Values


@dataclass(frozen=True, eq=False)
class EquivalentMotion:
    """Posterior draws of a joint as oscillators with equivalent stiffness and loss.

    Attributes:
        joint: The oscillator, whose leaves have the shape (draw,).
        num_harmonics: Number of odd harmonics that are balanced.
    """

    joint: Oscillator
    num_harmonics: int = 1

    @property
    def omega_n(self) -> Values:
        """The natural frequency at small amplitude, of shape (draw, 1) [rad/s]."""
        return np.asarray(self.joint.omega_n, float)[:, None]

    @property
    def viscous(self) -> Values:
        """The viscous damping c = 2 zeta omega_n, of shape (draw, 1) [1/s]."""
        return 2.0 * np.asarray(self.joint.zeta, float)[:, None] * self.omega_n

    @property
    def feels_rate(self) -> bool:
        """Whether the force of a law depends on the magnitude of the velocity."""
        return any(law.feels_rate for law in self.joint.laws)

    def values(self, y: Values, omega: Values) -> tuple[Values, Values]:
        """Return stiffness K and loss D [1/s^2] at amplitudes y [m] and frequencies omega [rad/s].

        All have the shape (draw, *any). They are NaN where y is not positive, or where the higher
        harmonics do not converge.
        """
        return self._at_points(_loops, y, omega, self.num_harmonics)

    def shapes(self, y: Values, omega: Values) -> tuple[Values, Values]:
        """Return the largest displacement and the third harmonic, both relative to Y.

        Both are computed with the balanced number of harmonics, but at least two.
        """
        return self._at_points(_shapes, y, omega, max(self.num_harmonics, 2))

    def _at_points(
        self, function: Callable[..., Array], y: Values, omega: Values, num_harmonics: int
    ) -> tuple[Values, Values]:
        draw = np.repeat(np.arange(y.shape[0]), y.size // y.shape[0])
        omega = np.broadcast_to(omega, y.shape)
        function = partial(function, num_harmonics=num_harmonics)
        pair = self.by_lanes(function, draw, y.ravel(), omega.ravel())
        return pair[:, 0].reshape(y.shape), pair[:, 1].reshape(y.shape)

    def by_lanes(
        self, function: Callable[..., Array], draw: NDArray[np.intp], *points: Values
    ) -> Values:
        """Return a function's values at many points, by calls that have a fixed number of points.

        Args:
            function: Takes a joint and points of equally many lanes; returns a row for each lane.
            draw: Draw of the joint at each point.
            points: Arguments at each point. The first must be positive.

        Returns:
            One row per point; NaN where an argument is not finite or the first is not positive.
        """
        known = np.flatnonzero(np.all(np.isfinite(points), 0) & (points[0] > 0))
        rows = []
        for first in range(0, len(known), LANES):
            lot = known[first : first + LANES]
            padded = np.pad(lot, (0, LANES - len(lot)), "edge")
            joint = jax.tree.map(lambda leaf, i=draw[padded]: leaf[i], self.joint)
            rows.append(np.asarray(function(joint, *(x[padded] for x in points)))[: len(lot)])
        width = rows[0].shape[1] if rows else 2
        found = np.full((len(draw), width), np.nan)
        if rows:
            found[known] = np.concatenate(rows)
        return found

    def loops(self, y: Values, omega: Values) -> EquivalentLoops:
        """Return stiffness and loss at amplitudes y [m] and frequencies omega [rad/s], with slopes.

        Slopes are central differences with a step of 1e-4 and errors of 1e-8. The frequency of a
        fold depends on these errors only to second order.
        """
        steps = 1.0 + STEP * np.array([0.0, 1.0, -1.0])
        amplitudes, frequency = y[..., None] * steps, np.broadcast_to(omega, y.shape)[..., None]
        stiffness, loss = self.values(amplitudes, frequency)
        by_speed = np.zeros_like(loss)
        if self.feels_rate:
            faster, slower = (self.values(amplitudes, frequency * step)[1] for step in steps[1:])
            by_speed = (faster - slower) / (2.0 * STEP * frequency)
        parts = stiffness, loss - by_speed * frequency, by_speed
        slopes = ((part[..., 1] - part[..., 2]) / (2.0 * STEP * y) for part in parts)
        stiffness, loss, by_speed = (part[..., 0] for part in parts)
        return EquivalentLoops(stiffness, loss, by_speed + wide(self.viscous, y), *slopes)


def wide(values: Values, like: Values) -> Values:
    """Return values of shape (draw, 1) with axes appended, so that they match another array."""
    return values.reshape(-1, *(1,) * (like.ndim - 1))


def equivalent_motion(joint: Joint, num_harmonics: int = 1) -> EquivalentMotion:
    """Return posterior draws of a joint as oscillators with equivalent stiffness and loss.

    Args:
        joint: A `BoucWen` or an `Oscillator`, of scalars or arrays of one shape (draw,).
        num_harmonics: Number of balanced odd harmonics; 1 uses the steady loop alone.

    Raises:
        ConfigError: `num_harmonics` is below 1, or JAX runs in float32.
        ModelError: The joint has several modes, or a law without a steady loop.
    """
    require_float64("The forced response")
    if isinstance(joint, Structure):
        raise ModelError(
            "Argument `joint` must have one mode, but is a Structure of several.",
            remedy="Compute its curve by `jbw.response_curve`, which balances all modes.",
        )
    if num_harmonics < 1:
        raise ConfigError(
            f"Argument `num_harmonics` must be at least 1, but is {num_harmonics}.",
            remedy="Use 1 for the steady loop alone, or 8 for an accurate result.",
        )
    require_contracts(joint)
    oscillator = as_oscillator(joint)
    for law in oscillator.laws:
        if not law.is_even or num_harmonics > 1:
            law.check_periodic()
    leaves, structure = jax.tree.flatten(oscillator)
    draws = np.broadcast_arrays(*(np.atleast_1d(np.asarray(leaf, float)) for leaf in leaves))
    return EquivalentMotion(jax.tree.unflatten(structure, draws), num_harmonics)


@partial(jax.jit, static_argnames="num_harmonics")
def _loops(
    joint: Oscillator, y: Float[Array, " lane"], omega: Float[Array, " lane"], num_harmonics: int
) -> Float[Array, "lane 2"]:
    def loop(joint: Oscillator, y: Array, omega: Array) -> Array:
        if num_harmonics > 1:
            force = condensed(joint, y, omega, num_harmonics)[0]
            return jnp.stack([joint.omega_n**2 + jnp.real(force), jnp.imag(force)])
        stiffness, loss = joint.loop(y, omega)
        return jnp.stack([joint.k + stiffness, loss])

    return jax.vmap(loop)(joint, y, omega)


@partial(jax.jit, static_argnames="num_harmonics")
def _shapes(
    joint: Oscillator, y: Float[Array, " lane"], omega: Float[Array, " lane"], num_harmonics: int
) -> Float[Array, "lane 2"]:
    def shape(joint: Oscillator, y: Array, omega: Array) -> Array:
        _, higher = condensed(joint, y, omega, num_harmonics)
        motion = jnp.concatenate([jnp.ones(1, complex), higher])
        return jnp.stack([jnp.abs(synthesis(motion, crest(motion))), jnp.abs(higher[0])])

    return jax.vmap(shape)(joint, y, omega)


def condensed(
    joint: Oscillator, y: Scalar, omega: Scalar, num_harmonics: int
) -> tuple[Complex[Array, ""], Complex[Array, " higher"]]:
    r"""Solve for the higher harmonics of a motion whose fundamental is given.

    $$q_n \leftarrow -\frac{r_n(Y, q_3, q_5, \dots)}{\omega_n^2 - n^2\omega^2
      + 2j n\zeta\omega_n\omega}$$

    with r_n of the laws' forces minus those of their stiffness at rest. Near the resonance the
    inertia of the third harmonic is eight times the stiffness, so that each step gains a digit or
    more.

    Args:
        joint: The oscillator, scalars.
        y: Amplitude Y of the displacement's fundamental [m].
        omega: Frequency [rad/s].
        num_harmonics: Number of balanced odd harmonics, at least 2.

    Returns:
        The laws' part r_1 / Y of the fundamental's stiffness [1/s^2], and the higher harmonics
        divided by Y; NaN where 60 steps do not reach 1e-13.
    """
    n = orders(num_harmonics)[1:]
    inertia = joint.omega_n**2 - (n * omega) ** 2 + 2j * joint.zeta * joint.omega_n * n * omega

    def force(q: Array) -> Array:
        motion = jnp.asarray(y * jnp.concatenate([jnp.ones(1, complex), q]))
        forces = (law.harmonics(motion, 2, omega) for law in joint.laws)
        return sum(forces, jnp.zeros(num_harmonics, complex)) / y

    def unfinished(state: tuple) -> Array:
        _, change, _, count = state
        return (change > CONDENSED) & (count < MOST_STEPS)

    def advance(state: tuple) -> tuple:
        q, _, _, count = state
        r = force(q)
        ahead = -r[1:] / inertia
        return ahead, jnp.max(jnp.abs(ahead - q)), r[0], count + 1

    start = jnp.zeros(num_harmonics - 1, complex), jnp.inf, jnp.zeros((), complex), 0
    q, change, r_1, _ = jax.lax.while_loop(unfinished, advance, start)
    converged = change <= CONDENSED
    return jnp.where(converged, r_1, jnp.nan), jnp.where(converged, q, jnp.nan)
