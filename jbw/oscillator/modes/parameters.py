r"""Structures of several modes, built from parameters by name.

The first mode has the parameter names of a single mode, and the laws are in its units: $h_1 = p_1 =
1$. For every other mode, observed at the one output with $c_i = 1$,

$$h_i = s_i |h_i|, \qquad \kappa_i = |p_i| h_i^2, \qquad s_i = \pm 1$$

`shape_i` is $|h_i|$, `sign_i` is $s_i$ and `coupling_i` is $\kappa_i$, by which that mode alone
softens: $\alpha_i\delta_i = \kappa_i\,\alpha\delta$. By reciprocity $h_i p_i > 0$. A missing name
has a meaning too: without a coupling the output is where the source pushes, $p_i = h_i b_i/b_1$;
without a shape the mode is linear and does not move the joint. Additional points where the response
is measured observe $y_o = \sum_i c_{oi} q_i$, `point_o_i` is $c_{oi}$.

Uncoupled modes have separate laws (modal models): `alpha_mode_2` has the meaning of `alpha` in an
oscillator with the second mode's frequency.

Reference:
    Segalman (2010), SAND2010-4763, for modes with separate laws.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jbw.oscillator.laws import laws_named, quantities_of
from jbw.oscillator.modes.assembled import assembled_structure, is_assembled, seen_by
from jbw.oscillator.modes.structure import Structure
from jbw.oscillator.oscillator import Oscillator, oscillator_of
from jbw.quantities import AT, MODES, POINTS, Quantity


class Names(NamedTuple):
    """The parameter names of one mode, for modes after the first."""

    omega: str
    zeta: str
    ratio: str
    shape: str
    coupling: str
    sign: str


NAMES = tuple(Names(*(quantity.name for quantity in mode)) for mode in MODES)
SEEN = tuple(tuple(quantity.name for quantity in point) for point in POINTS)


# Names of the frequency and the damping ratio of each driven mode.
DRIVEN = (("omega_n", "zeta"), *(names[:2] for names in NAMES))


def model_of(theta: Mapping[str, Any], laws: tuple[str, ...]) -> Oscillator | Structure:
    """Return the oscillator, or the structure of several modes, with parameters given by name."""
    return structure_of(theta, laws) if has_further_modes(theta) else oscillator_of(theta, laws)


def has_further_modes(names: Any) -> bool:
    """Return whether parameters include those of a second mode or of several joints."""
    at_joints = any(AT in str(name) for name in names)  # draws do not contain fixed parameters
    return NAMES[0].omega in names or is_assembled(names) or at_joints


def structure_of(theta: Mapping[str, Any], laws: tuple[str, ...]) -> Structure:
    """Return the structure with parameters given by name; gains are relative to that of mode 1.

    For several joints, b and c are those of the reduced model (`jbw.oscillator.modes.assembled`).

    Examples:
        A second mode without `shape_2` is a linear neighbour, whose h is 0:

        >>> import jbw; jbw.enable_x64()
        >>> theta = {"omega_n": 118.1, "zeta": 0.004, "alpha": 497.4, "delta": 340.2, "gamma": 32.8}
        >>> theta |= {"omega_2": 360.0, "zeta_2": 0.006, "gain_ratio_2": 0.7}
        >>> structure = jbw.structure_of(theta, ("bouc_wen",))
        >>> print(structure.omega_n, structure.b, structure.h)
        [118.1 360. ] [1.  0.7] [1. 0.]
    """
    if is_assembled(theta):
        return assembled_structure(theta, laws, DRIVEN)
    first = (theta["omega_n"], theta["zeta"], 1.0, 1.0, 1.0)
    others = (_mode(theta, names) for names in NAMES if names.omega in theta)
    fields = (jnp.stack(jnp.broadcast_arrays(*field)) for field in zip(first, *others, strict=True))
    omega_n, zeta, h, p, b = fields
    forces = tuple(law.build(theta) for law in laws_named(laws))
    return Structure(omega_n, zeta, h, p, b, jnp.ones_like(b), forces)


def own_name(name: str, mode: int) -> str:
    """Return the name of a law's parameter in a later mode; `mode` is 2 for the second mode."""
    return f"{name}_mode_{mode}"


def own_quantities(laws: tuple[str, ...], num_modes: int = 1 + len(MODES)) -> list[Quantity]:
    """Return the quantities of the separate laws of uncoupled modes after the first."""
    return [
        quantity._replace(
            name=own_name(quantity.name, mode), symbol=f"{quantity.symbol}({mode})",
            meaning=f"{quantity.meaning}, mode {mode}",
        )
        for mode in range(2, num_modes + 1)
        for quantity in quantities_of(laws)
    ]  # fmt: skip


def modes_apart(theta: Mapping[str, Any], laws: tuple[str, ...]) -> tuple[Oscillator, ...] | None:
    """Return an oscillator with its own laws for each uncoupled mode; None without such modes."""
    law_names = [quantity.name for quantity in quantities_of(laws)]
    if not law_names or own_name(law_names[0], 2) not in theta:
        return None
    oscillators = [oscillator_of(theta, laws)]
    for mode, names in enumerate(NAMES, 2):
        if names.omega in theta:
            linear = {"omega_n": theta[names.omega], "zeta": theta[names.zeta]}
            law = {name: theta[own_name(name, mode)] for name in law_names}
            oscillators.append(oscillator_of(linear | law, laws))
    return tuple(oscillators)


def modal_structure_of(theta: Mapping[str, Any], laws: tuple[str, ...]) -> Structure:
    """Return the structure of several modes; each uncoupled mode has its own joint and laws."""
    apart = modes_apart(theta, laws)
    if apart is None:
        return structure_of(theta, laws)
    omega_n, zeta = (
        jnp.stack([one.omega_n for one in apart]),
        jnp.stack([one.zeta for one in apart]),
    )
    own = jnp.eye(len(apart))
    b = jnp.stack([jnp.asarray(ratio, float) for ratio in gain_ratios(theta)])
    return Structure(omega_n, zeta, own, own, b, jnp.ones_like(b), [one.laws for one in apart])


def gain_ratios(theta: Mapping[str, Any]) -> list[Any]:
    """Return the ratio of every mode's gain to that of the first mode."""
    return [1.0, *(theta[names.ratio] for names in NAMES if names.omega in theta)]


def seen_by_points(theta: Mapping[str, Any], num_modes: int) -> Float[Array, "point mode"]:
    """Return the motion of each measured point in all modes, the first point first."""
    others = (point[:num_modes] for point in SEEN if point[0] in theta)
    rows = (jnp.stack([theta[name] for name in names]) for names in others)
    return jnp.stack(jnp.broadcast_arrays(jnp.ones(num_modes), *rows))


def at_points(theta: Mapping[str, Any], structure: Structure) -> Structure:
    """Return the structure with one output for every measured point."""
    if is_assembled(theta):
        return replace(structure, c=seen_by(theta))
    return replace(structure, c=seen_by_points(theta, jnp.size(structure.omega_n)))


def _mode(theta: Mapping[str, Any], names: Names) -> tuple[Any, ...]:
    """Return frequency, damping, joint motion h, coupling p and input gain b of a later mode."""
    linear, b = (theta[names.omega], theta[names.zeta]), theta[names.ratio]
    if names.shape not in theta:
        return *linear, 0.0, 0.0, b
    h = theta[names.sign] * theta[names.shape]
    has_coupling = names.coupling in theta
    p = theta[names.sign] * theta[names.coupling] / h**2 if has_coupling else h * b
    return *linear, h, p, b
