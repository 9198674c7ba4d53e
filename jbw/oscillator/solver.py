r"""The Bouc-Wen oscillator under a sampled input, for diffrax.

Time counts samples, $\tau = t f_s$, so that no rounding of 1/fs accumulates over a record.
`HysteresisExact` steps with the exact hysteresis map; stock solvers integrate `oscillate`.
"""

from collections.abc import Callable
from typing import ClassVar

import diffrax
import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jbw.oscillator.exact_step import ExactStep, Push, State, advance, exact_step
from jbw.oscillator.parameters import BoucWen, Scalar
from jbw.oscillator.reconstruction import substep_matrices


class Stepping(eqx.Module):
    """All that the hysteresis-exact stepping of a record needs.

    Attributes:
        step: Constants of the step.
        push: What the input adds to y [m] and to v [m/s] in each substep, in order of time, and
            the input at its start [N/kg].
    """

    step: ExactStep
    push: tuple[Float[Array, " substep"], Float[Array, " substep"], Float[Array, " substep"]]


def stepping(
    joint: BoucWen, polynomials: Float[Array, "interval power"], fs: Scalar, substeps: int
) -> Stepping:
    r"""Constants of the step, and the input's part of every substep, $p = \sum_j W_j c_j$.

    Args:
        joint: Bouc-Wen parameters, nu = 1.
        polynomials: Coefficients c_j of the input in each sample interval [N/kg].
        fs: Sampling rate [Hz].
        substeps: Steps per sample interval.

    Returns:
        The stepping.
    """
    step, moments_y, moments_v = exact_step(joint, 1.0 / (fs * substeps))
    num_powers = polynomials.shape[-1]
    parts = substep_matrices(num_powers, substeps)

    def weighted(weights: Float[Array, "power"]) -> Float[Array, " substep"]:
        weights = jnp.einsum("l,ilj->ij", weights, parts)
        return jnp.einsum("nj,ij->ni", polynomials, weights).reshape(-1)

    push_y, push_v = (weighted(moments[:num_powers]) for moments in (moments_y, moments_v))
    start = weighted(jnp.zeros(num_powers).at[0].set(1.0))
    return Stepping(step, (push_y, push_v, start))


def sampled_input(polynomials: Float[Array, "interval power"], tau: Scalar) -> Scalar:
    """Input at time tau [samples], its interval found by index [N/kg]."""
    interval = jnp.clip(jnp.floor(tau).astype(jnp.int32), 0, polynomials.shape[0] - 1)
    s = tau - interval
    value = polynomials[interval, -1]
    for power in range(polynomials.shape[-1] - 2, -1, -1):
        value = value * s + polynomials[interval, power]
    return value


def oscillate(joint: BoucWen, u: Scalar, state: State) -> State:
    r"""Rates of (y, v, z) [per s], any nu; differentiable at z = 0.

    $$\dot v = u - 2\zeta\omega_n v - k y - z - f(y), \qquad
      \dot z = \alpha v - (\gamma |v| \,\mathrm{sgn}\,z + \delta v) |z|^\nu$$

    Reference:
        Eqs. (1), (2), (39).
    """
    y, v, z = state
    dv = u - 2.0 * joint.zeta * joint.omega_n * v - joint.k * y - z
    if joint.restoring is not None:
        dv = dv - joint.restoring(y)
    if joint.nu == 1.0:
        saturation = joint.gamma * jnp.abs(v) * z + joint.delta * v * jnp.abs(z)
    else:
        # |z|^nu has a NaN derivative in nu and z at z = 0 under AD unless that point is set apart.
        size = jnp.where(z == 0.0, 0.0, jnp.where(z == 0.0, 1.0, jnp.abs(z)) ** joint.nu)
        saturation = (joint.gamma * jnp.abs(v) * jnp.sign(z) + joint.delta * v) * size
    return v, dv, joint.alpha * v - saturation


class HysteresisExact(diffrax.AbstractSolver):
    """Hysteresis-exact step as a diffrax solver, for nu = 1 and a sampled input.

    Takes a `Stepping` as `args`, which holds the law and the input; the n-th step uses the n-th
    push, and the vector field is never evaluated. For `diffrax.ConstantStepSize`.
    """

    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Callable[..., diffrax.LocalLinearInterpolation]] = (
        diffrax.LocalLinearInterpolation
    )

    def order(self, terms) -> int:
        """Global order of the method."""
        return 4

    def init(self, terms, t0, t1, y0, args):
        """Index of the next substep."""
        return jnp.zeros((), jnp.int32)

    def step(self, terms, t0, t1, y0, args: Stepping, solver_state, made_jump):
        """One substep."""
        push_y, push_v, u = args.push
        push: Push = push_y[solver_state], push_v[solver_state], u[solver_state]
        y1 = advance(args.step, y0, push, branch=True)
        dense_info = dict(y0=y0, y1=y1)
        return y1, None, dense_info, solver_state + 1, diffrax.RESULTS.successful

    def func(self, terms, t0, y0, args):
        """The vector field."""
        return terms.vf(t0, y0, args)
