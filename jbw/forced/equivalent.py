r"""Equivalent stiffness and loss of a joint against amplitude, for many posterior draws.

At the displacement amplitude Y, the fundamental force per unit mass that sustains the motion is

$$\frac{F_1}{Y} = K(Y) - \omega^2 + j\,(c\,\omega + D(Y)), \qquad c = 2\zeta\omega_n$$

With one harmonic, K and D are those of the law's steady loop. With more, the higher harmonics are
eliminated at each amplitude, and K and D depend slightly on the frequency as well. For one of
several modes, Y is the amplitude of the mode's own coordinate and F_1 the force on this mode. The
other modes are eliminated like the harmonics, so that the resonance frequency over Y is the
backbone of the mode, with the static and dynamic contributions of all other modes.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Int
from numpy.typing import NDArray

from jbw.errors import ConfigError, ModelError
from jbw.oscillator.checks import require_contracts, require_float64, require_periodic
from jbw.oscillator.law import laws_in
from jbw.oscillator.modes.balance import dynamic_stiffness, joint_forces
from jbw.oscillator.modes.structure import Structure, admitted, by_joint
from jbw.oscillator.oscillator import Joint, Oscillator, as_oscillator
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.steady.waveform import crest, orders, synthesis

Values = NDArray[np.float64]
Mode = Int[Array | np.ndarray, ""]  # index of the mode
LANES = 128  # number of points in a compiled call, whatever the number of draws
STEP = 1e-4  # relative step of amplitude or frequency in finite differences
# change of the joints' harmonics, relative to the largest, at which their iteration ends; and the
# largest number of iterations
CONDENSED, MOST_STEPS = 1e-13, 100
MAX_TURNS = 2  # number of turning points of a joint in a period


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
        joint: The oscillator, or the structure with one row of `h` per joint; its leaves have a
            first axis of draws.
        num_harmonics: Number of odd harmonics that are balanced.
        mode: Index of the mode of a structure, from 0.
    """

    joint: Oscillator | Structure
    num_harmonics: int = 1
    mode: int = 0

    @property
    def omega_n(self) -> Values:
        """The natural frequency at small amplitude, of shape (draw, 1) [rad/s]."""
        return self._of_mode(self.joint.omega_n)

    @property
    def viscous(self) -> Values:
        """The viscous damping c = 2 zeta omega_n, of shape (draw, 1) [1/s]."""
        return 2.0 * self._of_mode(self.joint.zeta) * self.omega_n

    def _of_mode(self, leaf: Scalar) -> Values:
        values = np.asarray(leaf, float)
        return values.reshape(len(values), -1)[:, self.mode, None]

    @property
    def feels_rate(self) -> bool:
        """Whether the force of a law depends on the magnitude of the velocity."""
        return any(law.feels_rate for law in laws_in(self.joint.laws))

    @property
    def has_further_modes(self) -> bool:
        """Whether the joint belongs to a `Structure`, whose other modes move with mode `mode`."""
        return isinstance(self.joint, Structure)

    @property
    def is_by_backbone(self) -> bool:
        """Whether the stiffness K as a function of amplitude alone describes free vibration."""
        return self.has_further_modes

    @property
    def feels_frequency(self) -> bool:
        """Whether K and D depend on the frequency, so that they are found by iteration."""
        return self.num_harmonics > 1 or self.feels_rate or self.has_further_modes

    def values(self, y: Values, omega: Values) -> tuple[Values, Values]:
        """Return stiffness K and loss D [1/s^2] at amplitudes y [m] and frequencies omega [rad/s].

        All have the shape (draw, *any). They are NaN where y is not positive, or where the higher
        harmonics do not converge.
        """
        stiffness, loss, *_ = self._at_points(y, omega)
        return stiffness, loss

    def shapes(self, y: Values, omega: Values) -> tuple[Values, Values]:
        """Return the largest displacement over Y, and the joints' third harmonic over their first.

        Both are computed with the balanced number of harmonics, but at least two.
        """
        several = max(self.num_harmonics, 2)
        crests, third = self._by_lanes(partial(_shapes, num_harmonics=several), y, omega)
        return crests, third

    def seen(self, y: Values, omega: Values) -> NDArray[np.complex128]:
        """Return the measured displacement's first harmonic over Y; 1 if there is one mode."""
        if not self.has_further_modes:
            return np.ones(y.shape, complex)
        _, _, real, imag, *_ = self._at_points(y, omega)
        return real + 1j * imag

    def moved_along(self, y: Values, omega: Values) -> tuple[Values, Values]:
        """Return force power and kinetic energy, each divided by the value of the mode alone.

        Both are 1 if the other modes do not move.
        """
        if not self.has_further_modes:
            return np.ones_like(y), np.ones_like(y)
        *_, power, mass = self._at_points(y, omega)
        return power, mass

    def _at_points(self, y: Values, omega: Values) -> Values:
        """Return K, D and, for a structure, parts of the other modes; axes are (part, *point)."""
        function = _modal_loops if self.has_further_modes else _loops
        return self._by_lanes(partial(function, num_harmonics=self.num_harmonics), y, omega)

    def _by_lanes(self, function: Callable[..., Array], y: Values, omega: Values) -> Values:
        draw = np.repeat(np.arange(y.shape[0]), y.size // y.shape[0])
        omega = np.broadcast_to(omega, y.shape)
        # The mode is an argument of the program, so that one program serves all modes.
        rows = self.by_lanes(
            partial(function, mode=np.asarray(self.mode)), draw, y.ravel(), omega.ravel()
        )
        return rows.T.reshape(-1, *y.shape)

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
        width = rows[0].shape[1] if rows else 8
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


def equivalent_motion(
    joint: Joint | Structure, num_harmonics: int = 1, mode: int = 0
) -> EquivalentMotion:
    """Return posterior draws of a joint as oscillators with equivalent stiffness and loss.

    Args:
        joint: A `BoucWen` or an `Oscillator`, of scalars or arrays of one shape (draw,); or a
            `Structure`, of one draw or with a first axis of draws in every leaf.
        num_harmonics: Number of balanced odd harmonics; 1 uses the steady loop alone.
        mode: Index of the mode of a `Structure`, from 0. The force must act on it.

    Raises:
        ConfigError: `num_harmonics` is below 1, `mode` does not exist, or JAX runs in float32.
        ModelError: The joint has a law without a steady loop, or the force does not act on the
            mode.
    """
    require_float64("The forced response")
    if num_harmonics < 1:
        raise ConfigError(
            f"Argument `num_harmonics` must be at least 1, but is {num_harmonics}.",
            remedy="Use 1 for the steady loop alone, or 8 for an accurate result.",
        )
    if isinstance(joint, Structure):
        return _of_structure(joint, num_harmonics, mode)
    _require_mode(mode, 1)
    require_contracts(joint)
    oscillator = as_oscillator(joint)
    for law in oscillator.laws:
        if not law.is_even or num_harmonics > 1:
            law.check_periodic()
    leaves, structure = jax.tree.flatten(oscillator)
    draws = np.broadcast_arrays(*(np.atleast_1d(np.asarray(leaf, float)) for leaf in leaves))
    return EquivalentMotion(jax.tree.unflatten(structure, draws), num_harmonics)


def _of_structure(structure: Structure, num_harmonics: int, mode: int) -> EquivalentMotion:
    require_periodic(structure)
    if np.ndim(structure.omega_n) < 2:
        structure = jax.tree.map(lambda leaf: jnp.asarray(leaf, float)[None], admitted(structure))
    rows = jax.vmap(_admitted_rows)(structure)
    _require_mode(mode, np.shape(rows.omega_n)[1])
    if np.any(np.asarray(rows.b)[:, mode] == 0.0):
        raise ModelError(
            f"Field `b` of the `Structure` must not be 0 for mode {mode}, but it is.",
            why=f"The source does not act on mode {mode}, which therefore has no resonance.",
            remedy="Name a mode on which the source acts.",
        )
    return EquivalentMotion(rows, num_harmonics, mode)


def _admitted_rows(structure: Structure) -> Structure:
    rows = by_joint(admitted(structure))
    return replace(rows, c=jnp.atleast_2d(rows.c))  # pyright: ignore[reportArgumentType]


def _require_mode(mode: int, count: int) -> None:
    if not 0 <= mode < count:
        raise ConfigError(
            f"Argument `mode` must be an index from 0 to {count - 1}, but is {mode}.",
            remedy="Name a mode of the joint.",
        )


@partial(jax.jit, static_argnames="num_harmonics")
def _loops(
    joint: Oscillator,
    y: Float[Array, " lane"],
    omega: Float[Array, " lane"],
    mode: Mode,
    num_harmonics: int,
) -> Float[Array, "lane 2"]:
    def loop(joint: Oscillator, y: Array, omega: Array) -> Array:
        if num_harmonics > 1:
            force = condensed(_rows(joint), mode, y, omega, num_harmonics).force
            return jnp.stack([joint.omega_n**2 + jnp.real(force), jnp.imag(force)])
        stiffness, loss = joint.loop(y, omega)
        return jnp.stack([joint.k + stiffness, loss])

    return jax.vmap(loop)(joint, y, omega)


@partial(jax.jit, static_argnames="num_harmonics")
def _modal_loops(
    structure: Structure,
    y: Float[Array, " lane"],
    omega: Float[Array, " lane"],
    mode: Mode,
    num_harmonics: int,
) -> Float[Array, "lane 6"]:
    """Return K, D, the measured displacement, and power and kinetic energy with all modes."""

    def loop(structure: Structure, y: Array, omega: Array) -> Array:
        motion = condensed(structure, mode, y, omega, num_harmonics)
        h, p, b, c = (jnp.asarray(x) for x in (structure.h, structure.p, structure.b, structure.c))
        stiffness = jnp.asarray(structure.omega_n)[mode] ** 2 + jnp.real(motion.force)
        q, output = jnp.real(motion.q[:, 0]), c[0] @ motion.q[:, 0]
        # By reciprocity, the ratios h / p of the modes are proportional to their modal masses.
        sizes, effects = jnp.sum(jnp.abs(h), 0), jnp.sum(jnp.abs(p), 1)
        mass = jnp.where(effects > 0.0, sizes / jnp.where(effects > 0.0, effects, 1.0), 0.0)
        power, kinetic = (jnp.sum(mass * part) / mass[mode] for part in (b * q / b[mode], q**2))
        loss = jnp.imag(motion.force)
        return jnp.stack([stiffness, loss, output.real, output.imag, power, kinetic])

    return jax.vmap(loop)(structure, y, omega)


@partial(jax.jit, static_argnames="num_harmonics")
def _shapes(
    joint: Oscillator | Structure,
    y: Float[Array, " lane"],
    omega: Float[Array, " lane"],
    mode: Mode,
    num_harmonics: int,
) -> Float[Array, "lane 2"]:
    def shape(joint: Oscillator | Structure, y: Array, omega: Array) -> Array:
        motion = condensed(_rows(joint), mode, y, omega, num_harmonics)
        own, first, third = motion.q[mode], *jnp.max(jnp.abs(motion.x[:, :2]), axis=0)
        return jnp.stack([jnp.abs(synthesis(own, crest(own))), third / first])

    return jax.vmap(shape)(joint, y, omega)


def _rows(joint: Oscillator | Structure) -> Structure:
    """Return a structure unchanged, and an oscillator as a structure of one mode and one joint."""
    if isinstance(joint, Structure):
        return joint
    omega_n, zeta, one = jnp.atleast_1d(joint.omega_n), jnp.atleast_1d(joint.zeta), jnp.ones(1)
    return Structure(omega_n, zeta, one[None], one[None], one, one[None], (joint.laws,))


class CondensedMotion(NamedTuple):
    """The motion for a fundamental of amplitude Y in one mode; all quantities are relative to Y.

    Attributes:
        force: Part of the joints in the fundamental's stiffness, sum_j p_mj r_j1 / Y [1/s^2].
        q: Harmonics of the modal coordinates, of which the mode's own fundamental is 1.
        x: Harmonics of every joint's displacement.
    """

    force: Complex[Array, ""]
    q: Complex[Array, "mode harmonic"]
    x: Complex[Array, "joint harmonic"]


def condensed(
    structure: Structure, mode: Mode, y: Scalar, omega: Scalar, num_harmonics: int
) -> CondensedMotion:
    r"""Solve for the other modes and the higher harmonics of a motion with a given fundamental.

    $$q_{in} \leftarrow \frac{b_i u_n - \sum_j p_{ij} r_{jn}(x)}{d_i(n\omega)}, \qquad
      u_1 = \frac{d_m(\omega)\,Y + \sum_j p_{mj} r_{j1}(x)}{b_m}, \qquad q_{m1} = Y$$

    with r of the laws' forces minus those of their stiffness at rest, and the modes' dynamic
    stiffness d_i. Near the resonance of mode m, the other modes and the higher harmonics are stiff,
    so that each step gains a digit or more.

    Args:
        structure: The structure, with one row of `h` per joint.
        mode: Index m of the mode.
        y: Amplitude Y of the fundamental of the mode's coordinate [m].
        omega: Frequency [rad/s].
        num_harmonics: Number of balanced odd harmonics.

    Returns:
        The motion; NaN where 100 steps do not reach 1e-13.
    """
    d, is_first = dynamic_stiffness(structure, omega, num_harmonics), orders(num_harmonics) == 1
    h, p, b = (jnp.asarray(x) for x in (structure.h, structure.p, structure.b))

    def coordinates(r: Array) -> tuple[Array, Array]:
        push = p @ r
        source = (d[mode, 0] + push[mode, 0]) / b[mode]
        q = (b[:, None] * source * is_first - push) / d
        return push[mode, 0], q.at[mode, 0].set(1.0)

    def forces(x: Array) -> Array:
        if num_harmonics > 1:
            return joint_forces(structure.laws, omega, jnp.asarray(y * x), MAX_TURNS) / y
        secants = [
            _secant(laws, y * jnp.abs(x[j, 0]), omega) for j, laws in enumerate(structure.laws)
        ]
        return jnp.stack(secants)[:, None] * x

    def unfinished(state: tuple) -> Array:
        *_, change, count = state
        return (change > CONDENSED) & (count < MOST_STEPS)

    def advance(state: tuple) -> tuple:
        motion, _, count = state
        force, q = coordinates(forces(motion.x))
        ahead = CondensedMotion(force, q, h @ q)
        change = jnp.max(jnp.abs(ahead.x - motion.x)) / jnp.max(jnp.abs(ahead.x))
        return ahead, change, count + 1

    force, q = coordinates(jnp.zeros((len(structure.laws), num_harmonics), complex))
    start = CondensedMotion(force, q, h @ q), jnp.inf, 0
    motion, change, _ = jax.lax.while_loop(unfinished, advance, start)
    return jax.tree.map(lambda part: jnp.where(change <= CONDENSED, part, jnp.nan), motion)


@jax.jit
def joint_secants(
    structure: Structure, x_peak: Float[Array, "draw joint"], omega: Float[Array, " draw"]
) -> Complex[Array, "draw joint"]:
    """Return each joint's complex secant stiffness at its amplitude, minus that at rest [1/s^2]."""

    def of_draw(structure: Structure, x_peak: Array, omega: Array) -> Array:
        pairs = enumerate(structure.laws)
        return jnp.stack([_secant(laws, x_peak[j], omega) for j, laws in pairs])

    return jax.vmap(of_draw)(structure, x_peak, omega)


def _secant(laws: Any, x_peak: Scalar, omega: Scalar) -> Array:
    """Return a joint's complex secant stiffness at an amplitude, minus its stiffness at rest."""
    parts = [(law.loop(x_peak, omega), law.stiffness()) for law in laws]
    total = sum((loop.stiffness - rest + 1j * loop.damping for loop, rest in parts), 0.0j)
    return jnp.asarray(total, complex)
