r"""Exact motion of a linear oscillator over one time step, by a power series.

The input within a step is a polynomial, $f(s) = \sum_j f_j (s/h)^j$; its effect is a sum of
moments of the impulse response.
"""

from math import comb, factorial

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.oscillator.parameters import Scalar

_NUM_TERMS = 16
_NUM_DOUBLINGS = 4


class Moments(eqx.Module):
    r"""Free motion and effect of the input for $\ddot y + c\dot y + \kappa y = f$ in one step h.

    $$q(h) = E\,q(0) + \sum_j W_j f_j, \qquad q = (y, v)$$

    Attributes:
        f_11: Entry of F = E - 1, E = exp(L h) [-]. E itself would lose the phase of a short step in
            the rounding of its ones.
        f_12: Entry of F [s].
        f_21: Entry of F [1/s].
        f_22: Entry of F [-].
        y: Displacement part of W_j [s^2], last axis j.
        v: Velocity part of W_j [s], last axis j.
    """

    f_11: Scalar
    f_12: Scalar
    f_21: Scalar
    f_22: Scalar
    y: Float[Array, "... moment"]
    v: Float[Array, "... moment"]


def impulse_moments(stiffness: Scalar, damping: Scalar, dt: Scalar, num: int) -> Moments:
    r"""Return the moments of the impulse response over one time step, for any damping.

    $$W_j = \int_0^h e^{L(h-s)} \begin{bmatrix}0\\1\end{bmatrix} (s/h)^j ds
          = h \sum_k \frac{j!}{(j+k+1)!} (Lh)^k \begin{bmatrix}0\\1\end{bmatrix},
      \quad L = \begin{bmatrix}0&1\\-\kappa&-c\end{bmatrix}$$

    The series is summed for h/16 and the step doubled four times, which keeps full precision up
    to about omega h = 8; it works in (y, h v), whose entries are all of order one.
    """
    part = dt / 2**_NUM_DOUBLINGS
    kappa, c = stiffness * part**2, damping * part
    terms = [(jnp.zeros_like(kappa), jnp.ones_like(kappa))]
    for _ in range(_NUM_TERMS - 1):
        y, v = terms[-1]
        terms.append((v, -kappa * y - c * v))  # pyright: ignore[reportArgumentType]
    y, v = (jnp.stack(entries, axis=-1) for entries in zip(*terms, strict=True))
    free = np.array([0.0] + [1.0 / factorial(k) for k in range(1, _NUM_TERMS)])
    weights = np.array(
        [[factorial(j) / factorial(j + k + 1) for j in range(num)] for k in range(_NUM_TERMS)]
    )
    f_12, f_22 = y @ free, v @ free
    w_y, w_v = y @ weights, v @ weights
    for _ in range(_NUM_DOUBLINGS):
        f_12, f_22, w_y, w_v = _double(kappa, c, f_12, f_22, w_y, w_v)
        kappa, c = 4.0 * kappa, 2.0 * c
    f_11, f_21 = f_22 + c * f_12, -kappa * f_12
    dt = jnp.asarray(dt)
    return Moments(f_11, dt * f_12, f_21 / dt, f_22, dt[..., None] ** 2 * w_y, dt[..., None] * w_v)


def _double(kappa, c, f_12, f_22, w_y, w_v):
    r"""Return the moments W_j of two steps: $W_j \leftarrow 2^{-j}(E W_j+\sum_i \binom{j}{i} W_i)$.

    The state is scaled to (y, h v); its unit of velocity doubles with the step.
    """
    num = w_y.shape[-1]
    shift = np.array([[comb(j, i) for j in range(num)] for i in range(num)], float)
    halves = 0.5 ** np.arange(num)
    f_11, f_21 = f_22 + c * f_12, -kappa * f_12
    moved_y = w_y + f_11[..., None] * w_y + f_12[..., None] * w_v
    moved_v = w_v + f_21[..., None] * w_y + f_22[..., None] * w_v
    w_y, w_v = halves * (moved_y + w_y @ shift), halves * (moved_v + w_v @ shift)
    # E^2 - 1 = F^2 + 2 F. For the doubled step, the state (y, h v) becomes (y, 2 h v), and moments
    # in units of h^2 become moments in units of 4 h^2.
    doubled_12 = f_12 * (2.0 + f_11 + f_22)
    doubled_22 = f_21 * f_12 + f_22 * (2.0 + f_22)
    return doubled_12 / 2.0, doubled_22, w_y / 4.0, w_v / 2.0
