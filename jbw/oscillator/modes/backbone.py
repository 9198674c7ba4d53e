r"""The backbone of one of several modes: periodic motion with the damping that sustains it.

The extended periodic motion of Krack (2015) is the periodic solution of

$$\ddot q_i + (2\zeta_i\omega_i - 2\zeta_{eq}\omega)\dot q_i + \omega_i^2 q_i
  + \sum_j p_{ij} r_j = 0$$

at a given amplitude L. For one joint, L is the first harmonic X of its displacement. For several
joints, none of which has *the* displacement, L is that of the mode's own coordinate, L = |q_m1|.
The unknowns are omega, zeta_eq, q_m1 and the harmonics of the joints' displacements; they are
followed along L, from the fully stuck joints.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Complex, Float, Int, Real

from jbw.errors import ConfigError, ModelError
from jbw.oscillator.checks import (
    is_concrete,
    require_at_least,
    require_finite,
    require_float64,
    require_periodic,
)
from jbw.oscillator.law import laws_in
from jbw.oscillator.modes.balance import dynamic_stiffness, joint_forces
from jbw.oscillator.modes.structure import Structure, admitted, by_joint, map_joint_laws
from jbw.oscillator.newton import newton_root
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.steady.waveform import num_turns, orders

# The unknowns are omega, zeta_eq, q_m1 and all X_jn, as real and imaginary parts. Omega is divided
# by the mode's own frequency; q_m1 and X_jn are in the units of `Units`.
Point = Float[Array, " unknown"]
Mode = Int[Array | np.ndarray, ""]  # index of the mode whose backbone is computed
_TOLERANCE = 1e-10
_MAX_NEWTON = 12
_MAX_STEPS = 400
_LEAST_STEP = 1e-6
# Largest change of a point of the backbone in one step; a larger step may reach another mode's
# branch.
_MOST_CHANGE = 0.05


class ModalBackbone(eqx.Module):
    """The resonance of one mode of a structure against amplitude.

    The axis of joints exists if the structure's `h` has one row per joint.

    Attributes:
        a: Amplitude of the mode's own coordinate, |q_1| [m].
        x_peak: First harmonic of every joint's displacement, |X_1| [m].
        omega: Resonance frequency [rad/s].
        zeta: Equivalent damping ratio at resonance, viscous and hysteretic [-].
        shape: Deflection shape: first harmonics q_i divided by that of the mode or, for a structure
            of one joint without an axis of joints, q_i/X; at amplitude 0 the mode's own [-].
        x: Harmonics of every joint's displacement, orders 1, 3, 5, ... [m].
        q: Harmonics of the modal coordinates [m].
        y: Harmonics of the outputs [m].
        loss_share: Share of every joint in the joints' total loss per cycle; NaN if none loses [-].
        r: Harmonics of the remainders of every joint's laws, their force minus that of their
            stiffness at rest [N, in units of its h and p].
    """

    a: Float[Array, "*level"]
    x_peak: Float[Array, "*level_joint"]
    omega: Float[Array, "*level"]
    zeta: Float[Array, "*level"]
    shape: Complex[Array, "*level mode"]
    x: Complex[Array, "*level_joint harmonic"]
    q: Complex[Array, "*level mode harmonic"]
    y: Complex[Array, "*channel harmonic"]
    loss_share: Float[Array, "*level_joint"]
    r: Complex[Array, "*level_joint harmonic"]


class BackboneOptions(NamedTuple):
    """The options of a backbone; `is_one_joint` if the amplitude is that of the joint."""

    num_harmonics: int
    max_turns: int
    is_one_joint: bool


def modal_backbone(
    structure: Structure,
    amplitude: Real[ArrayLike, "..."],
    *,
    mode: int,
    num_harmonics: int,
    max_turns: int,
    may_end: bool = False,
) -> ModalBackbone:
    """Compute the backbone of a mode; `jbw.backbone` documents the arguments.

    If it `may_end` before the largest amplitude, values beyond its end are NaN, without an error.
    """
    structure = admitted(structure)
    require_periodic(structure)
    require_finite(structure, y_peak=amplitude)
    require_float64()
    require_at_least("y_peak", amplitude, 0.0)
    is_one_joint = jnp.ndim(structure.h) == 1
    _require_mode(structure, mode, is_one_joint)
    if num_harmonics < 1:
        raise ConfigError(f"Argument `num_harmonics` must be at least 1, but is {num_harmonics}.")
    amplitude = jnp.asarray(amplitude, float)
    options = BackboneOptions(num_harmonics, max_turns, is_one_joint)
    # The mode is an argument of the program, so that one program is compiled for all modes.
    backbone, good = _backbone(by_joint(structure), np.asarray(mode), amplitude, options)
    if not may_end and is_concrete(structure, amplitude, backbone) and not np.all(good):
        first = float(np.asarray(amplitude)[~np.asarray(good)].min())
        motion = "a joint displacement" if is_one_joint else "an amplitude"
        raise ModelError(
            f"No point of the backbone of mode {mode} was found at {motion} of {first:g} m.",
            why="The backbone has a fold at this amplitude, for example near an internal "
            "resonance, or a joint reverses more often in a period than `max_turns` allows.",
            remedy="Use smaller amplitudes, look at `internal_resonances`, or raise `max_turns`.",
        )
    if not is_one_joint:
        return backbone
    one_joint = dict(
        x=backbone.x[..., 0, :],
        x_peak=amplitude,
        loss_share=backbone.loss_share[..., 0],
        r=backbone.r[..., 0, :],
    )
    return replace(backbone, **one_joint)


def _require_mode(structure: Structure, mode: int, is_one_joint: bool) -> None:
    """Raise if a mode does not exist, does not vibrate, or does not move the joint."""
    num = structure.omega_n.shape[0]  # pyright: ignore[reportAttributeAccessIssue]
    if isinstance(mode, bool) or not isinstance(mode, int) or not 0 <= mode < num:
        raise ConfigError(f"Argument `mode` must be an index from 0 to {num - 1}, but is {mode!r}.")
    omega_n = structure.omega_n[mode]  # pyright: ignore[reportIndexIssue]
    if is_concrete(omega_n) and omega_n == 0.0:
        raise ConfigError(
            f"Argument `mode` must be a mode that vibrates, but mode {mode} is a rigid-body mode "
            "(omega_n = 0) and has no backbone.",
            remedy="Name a mode whose omega_n is greater than 0.",
        )
    if not is_one_joint:
        return
    h, p = structure.h[mode], structure.p[mode]  # pyright: ignore
    if is_concrete(h, p) and (h == 0.0 or p == 0.0):
        raise ConfigError(
            f"Mode {mode} of the `Structure` must have `h` and `p` other than 0 to have a "
            f"backbone, but has h = {float(h):g} and p = {float(p):g}.",
            why="The joint does not move in this mode (h = 0), or its force does not act on "
            "the mode (p = 0).",
        )


@partial(jax.jit, static_argnums=3)
def _backbone(
    structure: Structure, mode: Mode, amplitude: Array, options: BackboneOptions
) -> tuple[ModalBackbone, Array]:
    """Return the backbone at every amplitude, and whether each point was found."""
    flat = amplitude.ravel()
    order = jnp.argsort(flat)
    points, good = _followed(options, mode, structure, flat[order])
    back = jnp.argsort(order)
    points, good = points[back], good[back]
    backbone, turns = jax.vmap(partial(_backbone_point, options, mode, structure))(points, flat)
    good = good & (turns <= options.max_turns)
    backbone = jax.tree.map(lambda leaf: jnp.where(_like(good, leaf), leaf, jnp.nan), backbone)
    shape = amplitude.shape
    return jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]), (backbone, good))


def _like(good: Array, leaf: Array) -> Array:
    return good.reshape(-1, *(1,) * (leaf.ndim - 1))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _followed(
    options: BackboneOptions, mode: Mode, structure: Structure, amplitude: Array
) -> tuple[Array, Array]:
    """Follow the backbone over rising amplitudes, each point from the last; mark converged ones.

    After the first point that is not found the branch ends, and no more are tried.
    """
    num_joints = len(structure.laws)
    first = jnp.zeros(4 + 2 * num_joints * options.num_harmonics)
    first = first.at[:4].set(jnp.stack([1.0, structure.zeta[mode], 1.0, 0.0]))  # pyright: ignore
    units = _units(options, mode, structure)
    sticking = structure.h[:, mode] * units.q / units.x  # pyright: ignore
    first = first.at[4 :: 2 * options.num_harmonics].set(sticking)
    # With velocity-dependent laws, zeta at rest differs from the modal damping ratio.
    if any(law.feels_rate for law in laws_in(structure.laws)):
        first, _ = _newton(options, mode, structure, first, jnp.zeros_like(amplitude[0]))

    def onward(carry, target):
        at, point, good = carry
        state = at, point, good
        amplitude_reached, point = _to(options, mode, structure, state, target)
        good = good & (amplitude_reached == target)
        return (amplitude_reached, point, good), (point, good)

    start = jnp.zeros_like(amplitude[0]), first, jnp.asarray(True)
    return jax.lax.scan(onward, start, amplitude)[1]


@_followed.defjvp
def _followed_jvp(options, primals, tangents):
    """Return the derivatives of the backbone's points, amplitude by amplitude."""
    mode, structure, amplitude = primals
    points, good = _followed(options, mode, structure, amplitude)

    def slope(point, amplitude, amplitude_dot):
        _, change = jax.jvp(
            lambda structure, amplitude: _imbalance(options, mode, structure, point, amplitude),
            (structure, amplitude),
            (tangents[1], amplitude_dot),
        )
        jacobian = jax.jacfwd(lambda point: _imbalance(options, mode, structure, point, amplitude))(
            point
        )
        return -jnp.linalg.solve(jacobian, change)

    points_dot = jax.vmap(slope)(points, amplitude, tangents[2])
    return (points, good), (points_dot, np.zeros(good.shape, jax.dtypes.float0))


def _to(
    options: BackboneOptions,
    mode: Mode,
    structure: Structure,
    start: tuple[Array, Point, Array],
    target: Array,
) -> tuple[Array, Point]:
    """Continue from one amplitude to the next, with halved steps where Newton's method fails.

    No step is taken from a `start` that did not converge itself.
    """
    at, point, good = start

    def unfinished(state):
        at, step, *_, tries = state
        return good & (at < target) & (tries < _MAX_STEPS) & (step > _LEAST_STEP * target)

    def advance(state):
        at, step, point, last_at, last, tries = state
        following = jnp.minimum(at + step, target)
        width = jnp.where(at > last_at, at - last_at, 1.0)
        # Predict the next point by the line through the last two points.
        ahead = point + (following - at) / width * (point - last)
        tried, ok = _newton(options, mode, structure, ahead, following)
        ok = ok & (jnp.max(jnp.abs(tried - point)) < _MOST_CHANGE)
        outcomes = (following, 2.0 * step, tried, at, point), (at, 0.5 * step, point, last_at, last)
        return *(jnp.where(ok, a, b) for a, b in zip(*outcomes, strict=True)), tries + 1

    state = at, target - at, point, at, point, 0
    amplitude_reached, _, point, *_ = jax.lax.while_loop(unfinished, advance, state)
    return amplitude_reached, point


def _newton(
    options: BackboneOptions, mode: Mode, structure: Structure, start: Point, amplitude: Array
) -> tuple[Point, Array]:
    """Solve for the backbone's point at one amplitude by Newton's method."""
    point, converged = newton_root(
        lambda point, args: _imbalance(options, mode, args[0], point, args[1]), start,
        (structure, amplitude), tolerance=_TOLERANCE, max_steps=_MAX_NEWTON,
    )  # fmt: skip
    return point, converged & jnp.all(jnp.isfinite(point))


class Units(NamedTuple):
    """The units of the mode's coordinate and of each joint's displacement, per unit amplitude."""

    q: Scalar
    x: Array


def _units(options: BackboneOptions, mode: Mode, structure: Structure) -> Units:
    """Return the units of the modal coordinate and of the joints' displacements in a backbone."""
    if options.is_one_joint:
        return Units(1.0 / structure.h[0, mode], jnp.ones(1))  # pyright: ignore
    return Units(1.0, jnp.max(jnp.abs(structure.h), axis=1))  # pyright: ignore[reportArgumentType]


class BackboneMotion(NamedTuple):
    """The motion at a point of the backbone, divided by the amplitude and by `Units`.

    `residual_1` is the first harmonic of the mode's own balance, multiplied by d of the mode.
    """

    omega: Scalar
    zeta: Scalar
    q_m1: Scalar
    q: Array
    x: Array
    r: Array
    residual_1: Scalar


def _motion(
    options: BackboneOptions, mode: Mode, structure: Structure, point: Point, amplitude: Scalar
) -> BackboneMotion:
    """Return frequency, damping, joint motion and modal motion at a point of the backbone."""
    units = _units(options, mode, structure)
    omega_m = structure.omega_n[mode]  # pyright: ignore[reportIndexIssue]
    omega, zeta = point[0] * omega_m, point[1]
    q_m1, x = jax.lax.complex(point[2], point[3]), point[4:].reshape(*structure.h.shape[:1], -1, 2)  # pyright: ignore
    x = jax.lax.complex(x[..., 0], x[..., 1])
    laws = map_joint_laws(
        lambda law, unit: law.scaled(amplitude * unit, omega_m**2), structure.laws, units.x
    )
    r = joint_forces(laws, point[0], x, options.max_turns)
    push = (structure.p * units.x) @ r  # pyright: ignore
    d = dynamic_stiffness(structure, omega, options.num_harmonics, zeta) / omega_m**2
    # At zero amplitude, the mode's dynamic stiffness d vanishes; therefore the mode's first
    # harmonic is not divided by d.
    residual_1 = d[mode, 0] * units.q * q_m1 + push[mode, 0]  # pyright: ignore
    q = (-push / d.at[mode, 0].set(1.0)).at[mode, 0].set(units.q * q_m1)  # pyright: ignore
    return BackboneMotion(omega, zeta, q_m1, q, x, r, residual_1)


def _imbalance(
    options: BackboneOptions, mode: Mode, structure: Structure, point: Point, amplitude: Scalar
) -> Point:
    """Return the residuals of the mode's first harmonic, the amplitude and the joints' motion."""
    motion = _motion(options, mode, structure, point, amplitude)
    apart = motion.x - (structure.h @ motion.q) / _units(options, mode, structure).x[:, None]
    relative_amplitude = motion.x[0, 0] if options.is_one_joint else motion.q_m1
    residual = jnp.concatenate(
        [jnp.stack([motion.residual_1, relative_amplitude - 1.0]), apart.ravel()]
    )
    return jnp.stack([residual.real, residual.imag], axis=1).ravel()


def _backbone_point(
    options: BackboneOptions, mode: Mode, structure: Structure, point: Point, amplitude: Array
) -> tuple[ModalBackbone, Array]:
    r"""Return a point of the backbone, and the largest number of turning points of any joint.

    The loss of a joint per cycle is $\pi \sum_n n\,\mathrm{Im}(r_n \bar X_n)$.
    """
    motion = _motion(options, mode, structure, point, amplitude)
    unit = _units(options, mode, structure).x
    loss = unit**2 * jnp.sum(
        orders(options.num_harmonics) * jnp.imag(motion.r * jnp.conj(motion.x)), axis=1
    )
    total = jnp.sum(loss)
    share = jnp.where(total == 0.0, jnp.nan, loss / jnp.where(total == 0.0, 1.0, total))
    x, q = amplitude * unit[:, None] * motion.x, amplitude * motion.q
    stiffness = structure.omega_n[mode] ** 2  # pyright: ignore[reportIndexIssue]
    r = stiffness * amplitude * unit[:, None] * motion.r
    sizes = jnp.abs(q[mode, 0]), jnp.abs(x[:, 0])
    rates = motion.omega, motion.zeta
    turns = jnp.max(jax.vmap(num_turns)(motion.x))
    y = jnp.asarray(structure.c) @ q
    return ModalBackbone(*sizes, *rates, motion.q[:, 0], x, q, y, share, r), turns  # pyright: ignore
