r"""Exact propagation of a linear oscillator under an input that is a cubic within each step."""

from math import factorial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jbw.oscillator.parameters import Scalar


class Propagator(eqx.Module):
    r"""One step h of $\ddot y + c\dot y + \kappa y = f$ on the state q = (y, v).

    $$q(h) = E\,q(0) + \sum_j W_j f_j, \qquad f(s) = \sum_j f_j\,(s/h)^j$$

    Attributes:
        transition: E = exp(L h).
        moments: W_j in column j, j = 0..3: the response to (s/h)^j from rest.
        dt: Step h [s].
    """

    transition: Float[Array, "2 2"]
    moments: Float[Array, "2 4"]
    dt: Scalar


def propagator(stiffness: Scalar, damping: Scalar, dt: Scalar) -> Propagator:
    r"""Transition and input moments of the linear oscillator over one step.

    $$E = e^{Lh}, \quad W_j = \int_0^h e^{L(h-s)}\begin{bmatrix}0\\1\end{bmatrix}(s/h)^j\,ds,
      \quad L = \begin{bmatrix}0&1\\-\kappa&-c\end{bmatrix}$$

    Both come out of one exponential, of L joined to the chain that integrates the polynomial; so
    the critical and the undamped oscillator are ordinary cases.

    Args:
        stiffness: Stiffness kappa [1/s^2].
        damping: Damping c [1/s].
        dt: Step h [s].

    Returns:
        The propagator.
    """
    scaled = jnp.zeros((6, 6)).at[0, 1].set(1.0)
    scaled = scaled.at[1, :3].set(jnp.stack([-stiffness * dt**2, -damping * dt, 1.0]))
    scaled = scaled.at[jnp.array([2, 3, 4]), jnp.array([3, 4, 5])].set(1.0)
    exponential = jax.scipy.linalg.expm(scaled)
    # Back from (y, h v) and h^2 f: unscaled, the exponential would lose digits in y like 1/h^2.
    unit = jnp.stack([1.0, 1.0 / dt])
    transition = unit[:, None] * exponential[:2, :2] / unit
    powers = jnp.array([factorial(j) for j in range(4)], exponential.dtype)
    moments = dt**2 * unit[:, None] * exponential[:2, 2:] * powers
    return Propagator(transition, moments, dt)


def held_input(f: Float[Array, " time"], hold: str) -> Float[Array, "step 4"]:
    """Polynomials of an input that is held ("zero") or joined by lines ("first").

    Args:
        f: Samples of the input [N/kg].
        hold: "first" or "zero".

    Returns:
        Coefficients f_0..f_3 of each step [N/kg].
    """
    rise = f[1:] - f[:-1] if hold == "first" else jnp.zeros_like(f[1:])
    none = jnp.zeros_like(rise)
    return jnp.stack([f[:-1], rise, none, none], axis=-1)


def hermite_input(
    f: Float[Array, " time"], rate: Float[Array, " time"], dt: Scalar
) -> Float[Array, "step 4"]:
    """Cubic polynomials of an input known with its rate at each sample.

    Args:
        f: Samples of the input [N/kg].
        rate: Their rates [N/kg/s].
        dt: Step [s].

    Returns:
        Coefficients f_0..f_3 of each step [N/kg]; the error is dt^4 f''''/384.
    """
    rise, start, end = f[1:] - f[:-1], dt * rate[:-1], dt * rate[1:]
    return jnp.stack([f[:-1], start, 3 * rise - 2 * start - end, start + end - 2 * rise], axis=-1)


def propagate(
    step: Propagator, polynomials: Float[Array, "step 4"]
) -> tuple[Float[Array, " time"], Float[Array, " time"]]:
    """Displacement and velocity at the samples, from rest.

    Args:
        step: Propagator of the oscillator.
        polynomials: Coefficients f_0..f_3 of the input in each step [N/kg].

    Returns:
        y [m] and v [m/s], one more sample than there are steps.
    """
    (e11, e12), (e21, e22) = step.transition
    push = polynomials @ step.moments.T

    def advance(state, push):
        (y, v), (push_y, push_v) = state, push
        state = e11 * y + e12 * v + push_y, e21 * y + e22 * v + push_v
        return state, state

    rest = jnp.zeros((), push.dtype)
    _, (y, v) = jax.lax.scan(advance, (rest, rest), (push[:, 0], push[:, 1]))
    return jnp.concatenate([rest[None], y]), jnp.concatenate([rest[None], v])
