r"""Work that the joints' forces do over a motion."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial import Polynomial

from jbw.oscillator.modes.step import ModalState, ModalStepping
from jbw.oscillator.modes.structure import Structure
from jbw.oscillator.step import remainders


def _hermite(orders: tuple[int, int]) -> list[Polynomial]:
    """Polynomials of which one derivative at one end of [0, 1] is 1 and the others are 0.

    Up to the order given of the start, then of the end.
    """
    size = sum(orders)
    rows = [
        [Polynomial.basis(power).deriv(order)(at) if order else Polynomial.basis(power)(at)
         for power in range(size)]
        for at, num in zip((0.0, 1.0), orders, strict=True)
        for order in range(num)
    ]  # fmt: skip
    return [Polynomial(column) for column in np.linalg.inv(np.array(rows, float)).T]


def _weights() -> np.ndarray:
    r"""$\int_0^1 R_k X_m' ds$ of the cubic by r, r' and the quintic by x, x', x'' at both ends."""
    r, x = _hermite((2, 2)), _hermite((3, 3))
    products = [[(polynomial * other.deriv()).integ() for other in x] for polynomial in r]
    table = np.array([[integral(1.0) - integral(0.0) for integral in row] for row in products])
    # x enters by its rise, for its value at the start moves nothing.
    return np.concatenate([table[:, 1:3], table[:, 3:]], axis=1)


_WEIGHTS = (
    _weights()
)  # of r, r' at start and end by x', x'' at the start and rise, x', x'' at the end


def work_of_joints(
    structure: Structure, stepping: ModalStepping, states: ModalState, kicks: Any
) -> Float[Array, " joint"]:
    r"""Work of every joint's remainder over a solved motion, $W_j = \int r_j \dot x_j dt$ [J/kg].

    Within a step r is the cubic H through r and its rate and x the quintic through x, v and a; what
    H misses of kinks is what the kicks say,

    $$\int (r - H)\,v\,dt = -v_1 k_v + a_1 k_y$$

    Args:
        structure: Modes and joints, with an axis of joints.
        stepping: Constants and input of the steps.
        states: States at the start and after every step.
        kicks: Every joint's kicks on y and v after every step.
    """
    q, v = jnp.stack(states[0]), jnp.stack(states[1])
    gain, dt = stepping.gain, stepping.step.joints[0].dt
    u = gain * stepping.pieces[0], gain * sum(stepping.pieces)
    x, dx = structure.h @ q, structure.h @ v
    parts = [
        remainders(laws, dt, (x[j], dx[j], memory), _branches(laws, dx[j], memory))  # pyright: ignore
        for j, (laws, memory) in enumerate(zip(structure.laws, states[2], strict=True))
    ]
    r, rate = (jnp.stack(part) for part in zip(*parts, strict=True))
    start, end = (
        structure.h @ accelerations(structure, q[:, place], v[:, place], r[:, place], input_there)
        for place, input_there in zip((slice(-1), slice(1, None)), u, strict=True)
    )
    at = jnp.stack([r[:, :-1], rate[:, :-1], r[:, 1:], rate[:, 1:]])
    way = jnp.stack([dt * dx[:, :-1], dt**2 * start, jnp.diff(x), dt * dx[:, 1:], dt**2 * end])
    kick_y, kick_v = (jnp.stack(kick)[:, 1:] for kick in zip(*kicks, strict=True))
    smooth = jnp.einsum("kjt,km,mjt->j", at, _WEIGHTS, way)
    return smooth + jnp.sum(end * kick_y - dx[:, 1:] * kick_v, axis=-1)


def _branches(laws: Any, v: Array, memory: Any) -> tuple[Any, ...]:
    return tuple(law.branch(v, law_memory) for law, law_memory in zip(laws, memory, strict=True))


def accelerations(structure: Structure, q: Array, dq: Array, r: Array, u: Any) -> Array:
    """Modal accelerations under the joints' remainders r and the input u [m/s^2]."""
    omega, zeta, b = (
        jnp.asarray(x).reshape(-1, *(1,) * (q.ndim - 1))
        for x in (structure.omega_n, structure.zeta, structure.b)
    )
    return (
        b * u
        - 2.0 * zeta * omega * dq
        - omega**2 * q
        - jnp.tensordot(jnp.asarray(structure.p), r, 1)
    )
