r"""A structure by the names of its parameters, as a campaign's posterior has them.

The first mode has the names of one mode, and the laws are in its units: $h_1 = p_1 = 1$. Of every
other one, seen by the one output with $c_i = 1$,

$$h_i = s_i |h_i|, \qquad \kappa_i = |p_i| h_i^2, \qquad s_i = \pm 1$$

`shape_i` is $|h_i|$, `sign_i` is $s_i$ and `coupling_i` is $\kappa_i$, by which that mode alone
softens: $\alpha_i\delta_i = \kappa_i\,\alpha\delta$. By reciprocity $h_i p_i > 0$. Names that are
absent say something too: without a coupling the output is where the source pushes, $p_i = h_i
b_i/b_1$; without a shape the mode is a linear one, which the joint does not feel. Further points
where the response is measured see $y_o = \sum_i c_{oi} q_i$, `point_o_i` is $c_{oi}$.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp

from jbw.oscillator.laws import laws_named
from jbw.oscillator.modes.structure import Structure
from jbw.oscillator.oscillator import Oscillator, oscillator_of
from jbw.quantities import MODES, POINTS


class Names(NamedTuple):
    """Names of the parameters of a mode beside the first."""

    omega: str
    zeta: str
    ratio: str
    shape: str
    coupling: str
    sign: str


NAMES = tuple(Names(*(quantity.name for quantity in mode)) for mode in MODES)
SEEN = tuple(tuple(quantity.name for quantity in point) for point in POINTS)


def model_of(theta: Mapping[str, Any], laws: tuple[str, ...]) -> Oscillator | Structure:
    """The oscillator of a dictionary of parameters, or the structure where it has further modes."""
    return structure_of(theta, laws) if NAMES[0].omega in theta else oscillator_of(theta, laws)


def structure_of(theta: Mapping[str, Any], laws: tuple[str, ...]) -> Structure:
    """The structure of a dictionary of parameters; b is over the first mode's gain, c is one."""
    first = (theta["omega_n"], theta["zeta"], 1.0, 1.0, 1.0)
    others = (_mode(theta, names) for names in NAMES if names.omega in theta)
    fields = (jnp.stack(jnp.broadcast_arrays(*field)) for field in zip(first, *others, strict=True))
    omega_n, zeta, h, p, b = fields
    forces = tuple(law.of(theta) for law in laws_named(laws))
    return Structure(omega_n, zeta, h, p, b, jnp.ones_like(b), forces)


def at_points(theta: Mapping[str, Any], structure: Structure) -> Structure:
    """The structure with an output for every point: the first, then the further ones in order."""
    first = structure.c
    others = (point[: first.shape[-1]] for point in SEEN if point[0] in theta)
    rows = [first, *(jnp.stack([theta[name] for name in names]) for names in others)]
    return replace(structure, c=jnp.stack(jnp.broadcast_arrays(*rows)))


def _mode(theta: Mapping[str, Any], names: Names) -> tuple[Any, ...]:
    """omega, zeta, h, p and b of a further mode."""
    linear, b = (theta[names.omega], theta[names.zeta]), theta[names.ratio]
    if names.shape not in theta:
        return *linear, 0.0, 0.0, b
    h = theta[names.sign] * theta[names.shape]
    known = names.coupling in theta
    p = theta[names.sign] * theta[names.coupling] / h**2 if known else h * b
    return *linear, h, p, b
