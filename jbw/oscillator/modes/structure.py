"""Several modes of a structure that are coupled by one joint, and the checks of their numbers."""

import warnings
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jbw.errors import ConfigError, ModelError
from jbw.oscillator.checks import is_concrete, require_finite
from jbw.oscillator.law import Law, Memory
from jbw.oscillator.parameters import Scalar

_PER_MODE = ("omega_n", "zeta", "h", "p", "b")
# Of two modes; further apart the higher harmonics of the one do not reach the other.
_NEAR = 0.05
_ORDERS = (3, 5)


class Structure(eqx.Module):
    r"""Modes of a structure with one joint, each per unit modal mass.

    $$\ddot q_i + 2\zeta_i\omega_i\dot q_i + \omega_i^2 q_i + p_i r = b_i u, \qquad
      x = \sum_i h_i q_i, \qquad y_o = \sum_i c_{oi} q_i$$

    with r = sum (F - K x), the laws' forces at the joint's relative displacement x less their
    stiffness of rest: the modes are those of the sticking joint. The motion stays the same under
    h -> s h, p -> s p with laws rescaled, and under b_i, p_i -> t b_i, t p_i with
    c_i, h_i -> c_i/t, h_i/t. With h_1 = p_1 = 1 the laws have the meaning and the units that they
    have about mode 1 alone; that choice is the caller's. A field is an array of a number a mode, or
    one number where there is one mode. Further joints, as a batch, by `jax.vmap`.

    Attributes:
        omega_n: Natural frequencies, the joint sticking [rad/s].
        zeta: Viscous damping ratios [-].
        h: What a unit of each mode moves the joint [-].
        p: What the joint's force does to each mode [-].
        b: What the input does to each mode [-].
        c: What each output sees of the modes [-]; one output, or outputs along the first axis.
        laws: The forces across the joint.
    """

    omega_n: Scalar
    zeta: Scalar
    h: Scalar
    p: Scalar
    b: Scalar
    c: Scalar
    laws: tuple[Law, ...] = eqx.field(default=(), converter=tuple)

    def at_rest(self) -> tuple[Memory, ...]:
        """Memories of the laws before any motion."""
        return tuple(law.at_rest() for law in self.laws)


class Commensurate(NamedTuple):
    """Two modes of which one is near an odd multiple of the other.

    Attributes:
        mode: Index of the lower mode, from 0.
        other: Index of the higher mode.
        order: Odd harmonic of the lower mode that is near the higher one.
        detuning: Frequency of the higher mode over that of the harmonic, less 1 [-].
    """

    mode: int
    other: int
    order: int
    detuning: float


def admitted(structure: Structure) -> Structure:
    """The structure with an array for every number; raises where it is invalid.

    Raises:
        ConfigError: Shapes differ, or nothing of the first mode reaches the joint.
        ModelError: A frequency or damping ratio that no mode has, or a number is not finite.
    """
    values = {name: jnp.asarray(getattr(structure, name), float) for name in (*_PER_MODE, "c")}
    shapes = {name: values[name].shape for name in _PER_MODE}
    distinct_shapes = {shape for shape in shapes.values() if shape}
    if len(distinct_shapes) > 1 or any(len(shape) > 1 for shape in distinct_shapes):
        raise ConfigError(
            f"The fields {', '.join(_PER_MODE)} of a `Structure` must hold one number a mode each, "
            f"but have the shapes {', '.join(map(str, shapes.values()))}.",
            remedy="Give every mode all five; for a batch of structures use `jax.vmap`.",
        )
    modes = next(iter(distinct_shapes), (1,))
    if any(not shape for shape in shapes.values()) and modes != (1,):
        bare = next(name for name, shape in shapes.items() if not shape)
        raise ConfigError(
            f"Field `{bare}` of a `Structure` must hold {modes[0]} numbers, one a mode, but is one "
            "number.",
            remedy="Say the number of every mode.",
        )
    if modes == (0,):
        raise ConfigError("A `Structure` must have at least one mode, but its fields are empty.")
    for name in _PER_MODE:
        values[name] = values[name].reshape(modes)
    if not values["c"].shape:
        values["c"] = values["c"].reshape(1)
    if values["c"].ndim > 2 or values["c"].shape[-1:] != modes:
        raise ConfigError(
            f"Field `c` of a `Structure` must hold {modes[0]} numbers, one a mode, for every "
            f"output, but has the shape {values['c'].shape}.",
            remedy="Give one row an output.",
        )
    _require_modes(structure, values)
    return Structure(*(values[name] for name in (*_PER_MODE, "c")), structure.laws)  # pyright: ignore[reportCallIssue]


def _require_modes(structure: Structure, values: dict[str, Array]) -> None:
    """Raise for numbers that no mode has; tracers are trusted."""
    require_finite(structure)
    concrete = {name: np.asarray(x) for name, x in values.items() if is_concrete(x)}
    for name, least, allowed in (("omega_n", 0.0, False), ("zeta", 0.0, True)):
        x = concrete.get(name, np.ones(1))
        bad = x < least if allowed else x <= least
        if np.any(bad):
            relation = "at least" if allowed else "greater than"
            raise ModelError(
                f"Field `{name}` of a `Structure` must be {relation} {least:g} for every mode, but "
                f"that of mode {int(np.argmax(bad))} is {x[np.argmax(bad)]:g}."
            )
    for name in ("h", "p"):
        if name in concrete and concrete[name][0] == 0.0:
            raise ConfigError(
                f"Field `{name}` of a `Structure` must not be 0 for the first mode, but it is.",
                why="The laws are in units of what that mode does to the joint.",
                remedy=f"Put a mode that reaches the joint first, with {name}[0] = 1.",
            )


def require_sampled(structure: Structure, fs: Any, substeps: int) -> None:
    """Refuse steps longer than half a period of the highest mode, warn of some shorter ones."""
    if not is_concrete(structure.omega_n, fs):
        return
    highest = float(np.max(np.asarray(structure.omega_n)))
    angle = highest / (float(fs) * substeps)
    motion_in_step = (
        f"The highest mode, at {highest / (2 * np.pi):.4g} Hz, moves by {angle:.3g} rad in a step "
        f"of `fs` = {float(fs):g} Hz and `substeps` = {substeps}"
    )
    remedy = "Raise `substeps`, sample the input faster, or leave the mode out."
    if angle > np.pi:
        raise ConfigError(f"{motion_in_step}, but at most pi can be followed.", remedy=remedy)
    if angle > 1.0:
        warnings.warn(
            f"{motion_in_step}; beyond 1 the joint's motion is coarse. {remedy}", stacklevel=4
        )


def internal_resonances(
    structure: Structure,
    *,
    within: float = _NEAR,
    orders: tuple[int, ...] = _ORDERS,
) -> tuple[Commensurate, ...]:
    r"""Which modes an odd harmonic of a lower mode comes near, $\omega_j \approx n\,\omega_i$.

    The joint radiates at n omega; a mode there takes energy up, so that a backbone of one mode and
    one harmonic is off by per cents in damping. A softening joint lowers omega_i with amplitude.

    Args:
        structure: The modes.
        within: Largest |omega_j / (n omega_i) - 1| [-].
        orders: Odd orders n.

    Returns:
        Pairs of modes, the nearest first.

    Raises:
        ConfigError: The frequencies are traced, or as for every door that takes a `Structure`.
    """
    if not is_concrete(structure.omega_n, within):
        raise ConfigError(
            "`internal_resonances` cannot be traced, as by jit, grad or vmap.",
            why="How many pairs it returns depends on the frequencies.",
            remedy="Call it outside.",
        )
    omega = np.asarray(admitted(structure).omega_n)
    pairs = [
        Commensurate(i, j, n, float(omega[j] / (n * omega[i]) - 1.0))
        for i in range(omega.size)
        for j in range(omega.size)
        for n in orders
        if i != j and abs(omega[j] / (n * omega[i]) - 1.0) <= within
    ]
    return tuple(sorted(pairs, key=lambda pair: abs(pair.detuning)))
