r"""Backbone of a mode among others: periodic motion under the damping that sustains it.

The extended periodic motion of Krack (2015) is the periodic solution of

$$\ddot q_i + (2\zeta_i\omega_i - 2\zeta_{eq}\omega)\dot q_i + \omega_i^2 q_i + p_i r = 0$$

with the first harmonic X of the joint's displacement given. Its unknowns are omega, zeta_eq and the
higher harmonics of the joint's displacement; they are found along X, from the sticking joint on.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, ArrayLike, Complex, Float, Real

from jbw.errors import ConfigError, ModelError
from jbw.oscillator.checks import (
    is_concrete,
    require_at_least,
    require_finite,
    require_float64,
    require_periodic,
)
from jbw.oscillator.modes.balance import dynamic_stiffness, joint_force
from jbw.oscillator.modes.structure import Structure, admitted
from jbw.oscillator.parameters import Scalar

# (omega, zeta_eq, Re X_3/X, Im X_3/X, ...), omega in units of the mode's own.
Point = Float[Array, " unknown"]
_TOLERANCE = 1e-10
_MAX_NEWTON = 12
_MAX_STEPS = 400
_LEAST_STEP = 1e-6
# Largest change of a point in one step along X: beyond it may lie another mode's branch.
_MOST_CHANGE = 0.05


class ModalBackbone(eqx.Module):
    """Resonance of one mode of a structure against amplitude.

    Attributes:
        x_peak: First harmonic X of the joint's displacement [m].
        omega: Resonance frequency [rad/s].
        zeta: Equivalent damping ratio there, viscous and hysteretic [-].
        shape: Deflection shape, first harmonics q_i/X; at X = 0 the mode's own [-].
        x: Harmonics of the joint's displacement, orders 1, 3, 5, ... [m].
        q: Harmonics of the modal coordinates [m].
        y: Harmonics of the outputs [m].
    """

    x_peak: Float[Array, "*level"]
    omega: Float[Array, "*level"]
    zeta: Float[Array, "*level"]
    shape: Complex[Array, "*level mode"]
    x: Complex[Array, "*level harmonic"]
    q: Complex[Array, "*level mode harmonic"]
    y: Complex[Array, "*channel harmonic"]


def modal_backbone(
    structure: Structure,
    x_peak: Real[ArrayLike, "..."],
    *,
    mode: int,
    num_harmonics: int,
    max_turns: int,
) -> ModalBackbone:
    """Backbone of a mode; `jbw.backbone` documents its arguments."""
    structure = admitted(structure)
    require_periodic(structure)
    require_finite(structure, y_peak=x_peak)
    require_float64()
    require_at_least("y_peak", x_peak, 0.0)
    _require_mode(structure, mode)
    if num_harmonics < 1:
        raise ConfigError(f"Argument `num_harmonics` must be at least 1, but is {num_harmonics}.")
    x_peak = jnp.asarray(x_peak, float)
    backbone, good = _backbone(structure, x_peak, mode, num_harmonics, max_turns)
    if is_concrete(structure, x_peak, backbone) and not np.all(good):
        first = float(np.asarray(x_peak)[~np.asarray(good)].min())
        raise ModelError(
            f"The backbone of mode {mode} was not found at a joint displacement of {first:g} m.",
            why="It folds over there, as near an internal resonance, or the joint turns more "
            "often in a period than was allowed.",
            remedy="Stay below, look at `internal_resonances`, or raise `max_turns`.",
        )
    return backbone


def _require_mode(structure: Structure, mode: int) -> None:
    """Raise for a mode that is not there, or does not move the joint."""
    num = structure.omega_n.shape[0]  # pyright: ignore[reportAttributeAccessIssue]
    if isinstance(mode, bool) or not isinstance(mode, int) or not 0 <= mode < num:
        raise ConfigError(f"Argument `mode` must be an index from 0 to {num - 1}, but is {mode!r}.")
    h, p = structure.h[mode], structure.p[mode]  # pyright: ignore[reportIndexIssue]
    if is_concrete(h, p) and (h == 0.0 or p == 0.0):
        raise ConfigError(
            f"Mode {mode} of the `Structure` must have `h` and `p` other than 0 to have a "
            f"backbone, but has h = {float(h):g} and p = {float(p):g}.",
            why="Nothing of it passes through the joint.",
        )


@partial(jax.jit, static_argnums=(2, 3, 4))
def _backbone(
    structure: Structure, x_peak: Array, mode: int, num_harmonics: int, max_turns: int
) -> tuple[ModalBackbone, Array]:
    """The backbone at every amplitude, and whether it was found."""
    flat = x_peak.ravel()
    order = jnp.argsort(flat)
    options = mode, num_harmonics, max_turns
    points, good = _followed(options, structure, flat[order])
    back = jnp.argsort(order)
    points, good = points[back], good[back]
    backbone = jax.vmap(partial(_backbone_point, options, structure))(points, flat)
    backbone = jax.tree.map(lambda leaf: jnp.where(_like(good, leaf), leaf, jnp.nan), backbone)
    shape = x_peak.shape
    return jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]), (backbone, good))


def _like(good: Array, leaf: Array) -> Array:
    return good.reshape(-1, *(1,) * (leaf.ndim - 1))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _followed(options: tuple, structure: Structure, x_peak: Array) -> tuple[Array, Array]:
    """Points of the branch at rising amplitudes, each from the one before, and which were found."""
    first = jnp.zeros(2 * options[1]).at[0].set(1.0)
    first = first.at[1].set(structure.zeta[options[0]])  # pyright: ignore[reportIndexIssue]

    def onward(carry, target):
        at, point, good = carry
        x_reached, point = _to(options, structure, at, point, target)
        good = good & (x_reached == target)
        return (x_reached, point, good), (point, good)

    start = jnp.zeros_like(x_peak[0]), first, jnp.asarray(True)
    return jax.lax.scan(onward, start, x_peak)[1]


@_followed.defjvp
def _followed_jvp(options, primals, tangents):
    """Implicit differentiation, amplitude by amplitude."""
    structure, x_peak = primals
    points, good = _followed(options, structure, x_peak)

    def slope(point, x_peak, x_dot):
        _, change = jax.jvp(
            lambda structure, x_peak: _imbalance(options, structure, point, x_peak),
            (structure, x_peak),
            (tangents[0], x_dot),
        )
        jacobian = jax.jacfwd(lambda point: _imbalance(options, structure, point, x_peak))(point)
        return -jnp.linalg.solve(jacobian, change)

    points_dot = jax.vmap(slope)(points, x_peak, tangents[1])
    return (points, good), (points_dot, np.zeros(good.shape, jax.dtypes.float0))


def _to(
    options: tuple, structure: Structure, at: Array, point: Point, target: Array
) -> tuple[Array, Point]:
    """From one amplitude to another by steps, halved where Newton fails or goes far."""

    def unfinished(state):
        at, step, *_, tries = state
        return (at < target) & (tries < _MAX_STEPS) & (step > _LEAST_STEP * target)

    def advance(state):
        at, step, point, last_at, last, tries = state
        following = jnp.minimum(at + step, target)
        width = jnp.where(at > last_at, at - last_at, 1.0)
        ahead = point + (following - at) / width * (point - last)  # the secant
        tried, ok = _newton(options, structure, ahead, following)
        ok = ok & (jnp.max(jnp.abs(tried - point)) < _MOST_CHANGE)
        outcomes = (following, 2.0 * step, tried, at, point), (at, 0.5 * step, point, last_at, last)
        return *(jnp.where(ok, a, b) for a, b in zip(*outcomes, strict=True)), tries + 1

    state = at, target - at, point, at, point, 0
    x_reached, _, point, *_ = jax.lax.while_loop(unfinished, advance, state)
    return x_reached, point


def _newton(options: tuple, structure: Structure, start: Point, x_peak: Array):
    """Newton's iteration at one amplitude."""
    solution = optimistix.root_find(
        lambda point, args: _imbalance(options, args[0], point, args[1]),
        optimistix.Newton(rtol=_TOLERANCE, atol=_TOLERANCE),
        start,
        (structure, x_peak),
        max_steps=_MAX_NEWTON,
        throw=False,
    )
    converged = solution.result == optimistix.RESULTS.successful
    return solution.value, converged & jnp.all(jnp.isfinite(solution.value))


def _motion(options: tuple, structure: Structure, point: Point) -> tuple[Array, Array, Array]:
    """Frequency, equivalent damping and harmonics over X of a point."""
    omega = point[0] * structure.omega_n[options[0]]  # pyright: ignore[reportIndexIssue]
    higher = point[2:].reshape(-1, 2)
    shape = jnp.concatenate([jnp.ones(1, complex), higher[:, 0] + 1j * higher[:, 1]])
    return omega, point[1], shape


def _imbalance(options: tuple, structure: Structure, point: Point, x_peak: Scalar) -> Point:
    """Residual of the balance at a point; the first harmonic multiplied by d of the mode."""
    mode, num_harmonics, max_turns = options
    omega, zeta, shape = _motion(options, structure, point)
    unit = structure.omega_n[mode] ** 2  # pyright: ignore[reportIndexIssue]
    d = dynamic_stiffness(structure, omega, num_harmonics, zeta) / unit
    laws = tuple(law.scaled(x_peak, unit) for law in structure.laws)
    r = joint_force(laws, omega, shape, max_turns)
    hp = structure.h * structure.p
    # At zero amplitude d of the mode vanishes: no division by it in the first harmonic.
    others = hp.at[mode].set(0.0)[:, None] / d.at[mode, 0].set(1.0)  # pyright: ignore
    first = d[mode, 0] * (shape[0] + jnp.sum(others[:, 0]) * r[0]) + hp[mode] * r[0]  # pyright: ignore
    higher = shape[1:] + (hp @ (1.0 / d.at[:, 0].set(1.0)))[1:] * r[1:]
    imbalance = jnp.concatenate([first[None], higher])
    return jnp.stack([imbalance.real, imbalance.imag], axis=1).ravel()


def _backbone_point(
    options: tuple, structure: Structure, point: Point, x_peak: Array
) -> ModalBackbone:
    """Frequency, damping and harmonics of a point of the backbone."""
    mode, num_harmonics, max_turns = options
    omega, zeta, shape = _motion(options, structure, point)
    unit = structure.omega_n[mode] ** 2  # pyright: ignore[reportIndexIssue]
    laws = tuple(law.scaled(x_peak, unit) for law in structure.laws)
    r = joint_force(laws, omega, shape, max_turns)
    d = dynamic_stiffness(structure, omega, num_harmonics, zeta) / unit
    relative = -structure.p[:, None] * r / d.at[mode, 0].set(1.0)  # pyright: ignore
    # The mode's own first harmonic from that of the joint, which holds at zero amplitude too.
    other_modes = structure.h @ relative[:, 0] - structure.h[mode] * relative[mode, 0]  # pyright: ignore
    relative = relative.at[mode, 0].set((shape[0] - other_modes) / structure.h[mode])  # pyright: ignore
    q = x_peak * relative
    return ModalBackbone(x_peak, omega, zeta, relative[:, 0], x_peak * shape, q, structure.c @ q)  # pyright: ignore[reportArgumentType]
