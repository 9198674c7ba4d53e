r"""Branches of the steady hysteresis loop: closed forms and Taylor polynomials, Eqs. (3)-(6)."""

import math
from typing import Literal

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Real

from jbw.errors import ConfigError
from jbw.oscillator.checks import require_closed_form, require_finite
from jbw.oscillator.laws.relaxation import phi
from jbw.oscillator.parameters import Hysteresis, Scalar

Path = Literal[1, 2, 3, 4]


def branch(
    joint: Hysteresis,
    y: Real[ArrayLike, "..."],
    y_open: Real[ArrayLike, "..."],
    path: Path,
    order: int | None = None,
) -> Float[Array, "..."]:
    r"""Hysteretic force Z_i(y) on one of the four paths of the loop.

    $$Z_1 = \alpha\,\phi(\delta-\gamma, y-y_0), \quad Z_2 = -\alpha\,\phi(\delta+\gamma, y_0-y)$$
    $$Z_3 = -\alpha\,\phi(\delta-\gamma, -y_0-y), \quad Z_4 = \alpha\,\phi(\delta+\gamma, y+y_0)$$

    with phi(c, x) = (1 - exp(-c x))/c, the closed form of the paper's infinite sums. Unloading
    runs over Z_1 (path AC, z > 0) and Z_2 (CD, z < 0), loading over Z_3 (DB) and Z_4 (BA); each
    formula may be evaluated off its own path.

    Args:
        joint: Bouc-Wen parameters with nu = 1.
        y: Displacement [m].
        y_open: Threshold y_0 at which z vanishes on unloading [m].
        path: 1 to 4, as in the equations.
        order: Degree of the Taylor polynomial about the threshold (the paper uses 3); None for
            the closed form.

    Returns:
        Hysteretic force [N/kg].

    Raises:
        ModelError: `nu` is not 1, or a concrete argument is not finite.
        ConfigError: `path` is not 1 to 4, or `order` is below 1.

    Reference:
        Eqs. (3)-(6), as printed.
    """
    require_closed_form(joint)
    require_finite(joint, y=y, y_open=y_open)
    if path not in (1, 2, 3, 4):
        raise ConfigError(f"Argument `path` must be 1, 2, 3 or 4, but it is {path}.")
    if order is not None and order < 1:
        raise ConfigError(f"Argument `order` must be at least 1, but it is {order}.")
    y, y_open = jnp.asarray(y), jnp.asarray(y_open)
    rate = joint.delta - joint.gamma if path in (1, 3) else joint.delta + joint.gamma
    sign = 1.0 if path in (1, 4) else -1.0
    distance = {1: y - y_open, 2: y_open - y, 3: -y_open - y, 4: y + y_open}[path]
    relaxed = phi(rate, distance) if order is None else _taylor(rate, distance, order)
    return jnp.asarray(sign * joint.alpha * relaxed)


def _taylor(c: Scalar, x: Array, order: int) -> Array:
    """Taylor polynomial of phi(c, x) about x = 0, the sum of (-c)^(n-1) x^n / n!."""
    c = jnp.asarray(c)
    terms = ((-c) ** (n - 1) * x**n / math.factorial(n) for n in range(1, order + 1))
    return sum(terms, jnp.zeros_like(x))
