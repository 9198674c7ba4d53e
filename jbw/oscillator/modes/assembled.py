r"""Structures with several joints, built from parameters by name.

The frequencies and damping ratios of the modes that tests drive come first, under their usual
names; all other numbers belong to the reduced model and are fixed:

$$\ddot q_i + 2\zeta_i\omega_i\dot q_i + \omega_i^2q_i + \sum_jH_{ji}r_j = \frac{g}{b_1c_1}b_iu,
  \qquad x_j = \sum_iH_{ji}q_i, \qquad y_o = \sum_ic_{oi}q_i$$

`push_i` is b_i, `seen_i` is c_i of the first point, `seen_i@tip` that of another point, and
`motion_i@bolt_1` is H_ji of the model. It is multiplied by `motion_factor_i@bolt_1` where the
model's shapes are uncertain. `model_omega_i` and `model_zeta_i` belong to the reduced model, and
apply to the modes after the driven ones, including residual modes. The `gain` g is that of the
first mode, as in a structure of one joint: g = b_1 c_1 where the source is a force.
`stiffness@bolt_1` is k_j of the fully stuck joint.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.oscillator.law import Law
from jbw.oscillator.laws import laws_named
from jbw.oscillator.modes.structure import Structure
from jbw.quantities import MOTION_FACTOR, joints_of, name_at, split

PUSH, SEEN, MOTION, STIFFNESS = "push", "seen", "motion", "stiffness"
OMEGA, ZETA = "model_omega", "model_zeta"


def numbered(name: str, mode: int) -> str:
    """Return the name of a mode's parameter; `mode` is 1 for the first."""
    return f"{name}_{mode}"


FIRST_PUSH = numbered(PUSH, 1)


def held_numbers(
    omega: Float[np.ndarray, " mode"],
    zeta: Float[np.ndarray, " mode"],
    H: Mapping[str, Float[np.ndarray, " mode"]],
    stiffness: Mapping[str, float],
    b: Float[np.ndarray, " mode"],
    c: Mapping[str, Float[np.ndarray, " mode"]],
) -> dict[str, float]:
    """Return the fixed numbers of a reduced model by name, with the driven modes first.

    Args:
        omega: Natural frequencies [rad/s].
        zeta: Damping ratios [-].
        H: Motion of every joint in each mode, by joint label.
        stiffness: Stiffness of every fully stuck joint, by label [N/m].
        b: Effect of the input on each mode.
        c: Motion of each measured point in each mode, by name; the first point's name is empty.
    """
    numbers: dict[str, float] = {}
    for i in range(len(omega)):
        mode = i + 1
        numbers |= {numbered(OMEGA, mode): omega[i], numbered(ZETA, mode): zeta[i]}
        numbers[numbered(PUSH, mode)] = b[i]
        numbers |= {seen_name(mode, point): row[i] for point, row in c.items()}
        numbers |= {motion_name(mode, joint): row[i] for joint, row in H.items()}
    numbers |= {name_at(STIFFNESS, joint): k for joint, k in stiffness.items()}
    return {name: float(value) for name, value in numbers.items()}


def seen_name(mode: int, point: str = "") -> str:
    """Return the parameter name of the motion of a measured point in a mode."""
    return name_at(numbered(SEEN, mode), point) if point else numbered(SEEN, mode)


def motion_name(mode: int, joint: str) -> str:
    """Return the parameter name of the motion of a joint in a mode."""
    return name_at(numbered(MOTION, mode), joint)


def factor_name(mode: int, joint: str) -> str:
    """Return the parameter name of the factor on a joint's motion in a mode."""
    return name_at(numbered(MOTION_FACTOR, mode), joint)


def motion_in(theta: Mapping[str, Any], mode: int, joint: str) -> Any:
    """Return a joint's motion in a mode, H_ji: the model's value, times a factor if given."""
    return theta[motion_name(mode, joint)] * theta.get(factor_name(mode, joint), 1.0)


def is_assembled(names: Any) -> bool:
    """Return whether the parameters include the numbers of a reduced model."""
    return FIRST_PUSH in names


def num_modes(theta: Mapping[str, Any]) -> int:
    """Return the number of modes, including residual modes."""
    return next(i for i in range(1, len(theta) + 2) if numbered(PUSH, i) not in theta) - 1


def rows(theta: Mapping[str, Any], names: Sequence[str]) -> Float[Array, " mode"]:
    """Return the values of one quantity in all modes, from the names of its parameters."""
    return _stacked([theta[name] for name in names])


def _stacked(values: Sequence[Any]) -> Float[Array, " mode"]:
    return jnp.stack(jnp.broadcast_arrays(*(jnp.asarray(value, float) for value in values)))


def assembled_structure(
    theta: Mapping[str, Any],
    laws: tuple[str, ...],
    driven: Sequence[tuple[str, ...]],
) -> Structure:
    """Return the structure of several joints from parameters by name.

    Args:
        theta: Parameters by name.
        laws: Names of the joints' laws; without any, the joints are stuck.
        driven: Names of the frequency and damping ratio of each mode that tests may drive, in
            order.
    """
    modes = range(1, num_modes(theta) + 1)
    pairs = [pair for pair in driven if pair[0] in theta]
    omega, zeta = (
        rows(
            theta, [*(pair[k] for pair in pairs), *(numbered(name, i) for i in modes[len(pairs) :])]
        )
        for k, name in enumerate((OMEGA, ZETA))
    )
    joints = joints_of(laws) or joints_in(theta)[:1]
    H = jnp.stack([_stacked([motion_in(theta, i, joint) for i in modes]) for joint in joints])
    b = rows(theta, [numbered(PUSH, i) for i in modes])
    c = rows(theta, [seen_name(i) for i in modes])
    b = b / (b[0] * theta[seen_name(1)])
    of_joints = tuple(laws_at(theta, laws, joint) for joint in joints)
    return Structure(omega, zeta, H, H.T, b, c, of_joints)


def seen_by(theta: Mapping[str, Any]) -> Float[Array, "point mode"]:
    """Return the motion of every measured point in all modes; all but the first are sorted by name.

    JAX sorts the names of parameters that it traces, so that no other order can be kept.
    """
    modes, stem = range(1, num_modes(theta) + 1), seen_name(1, "") + "@"
    points = ["", *sorted(name.removeprefix(stem) for name in theta if name.startswith(stem))]
    return jnp.stack([rows(theta, [seen_name(i, point) for i in modes]) for point in points])


def laws_at(theta: Mapping[str, Any], laws: tuple[str, ...], joint: str) -> tuple[Law, ...]:
    """Return the laws of one joint, with parameters from theta."""
    kinds: Any = laws_named(laws)
    return tuple(
        kind.unnamed(theta)
        for name, kind in zip(laws, kinds, strict=True)
        if joint in split(name)[1]
    )


def joints_in(theta: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the labels of all joints in a parameter dictionary, with laws or without."""
    stem = motion_name(1, "")
    return tuple(name.removeprefix(stem) for name in theta if name.startswith(stem))


def first_mode_laws(theta: Mapping[str, Any], laws: tuple[str, ...]) -> tuple[Law, ...]:
    r"""Return the joints' laws as functions of the first mode's displacement y at the first point.

    $$\ddot y + 2\zeta_1\omega_1\dot y + \omega_1^2y + \sum_jc_1H_{j1}r_j(H_{j1}y/c_1) = gu$$
    """
    c = theta[seen_name(1)]
    felt = []
    for joint in joints_of(laws):
        h = motion_in(theta, 1, joint)
        felt += [law.scaled(jnp.abs(h / c), h**-2.0) for law in laws_at(theta, laws, joint)]
    return tuple(felt)
