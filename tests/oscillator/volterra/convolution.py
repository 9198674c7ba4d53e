r"""Volterra response of the polynomial oscillator to an arbitrary record.

Two routes to $y = y_1 + y_2 + y_3$: the multiple convolutions with the kernels in time, which are
the definition and cost memory^order a sample; and the cascade of linear oscillators to which they
reduce for this system, which costs a few linear responses.
"""

from functools import partial
from typing import Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float
from volterra.impulse import impulse_1, impulse_2, impulse_3
from volterra.kernels import PolynomialOscillator, nonlinear_force
from volterra.propagator import held_input, hermite_input, propagate, propagator

from jbw.errors import ConfigError, DataError
from jbw.oscillator.checks import is_concrete
from jbw.oscillator.parameters import Scalar

Hold = Literal["first", "zero"]


class VolterraResponse(eqx.Module):
    """Homogeneous parts of a response from rest; their sum over orders is the response.

    Attributes:
        t: Time, from 0 at the first sample [s].
        y: Displacement of each order, from 1 up [m].
        v: Velocity of each order [m/s].
    """

    t: Float[Array, " time"]
    y: Float[Array, "order time"]
    v: Float[Array, "order time"]


def volterra_response(
    system: PolynomialOscillator,
    u: Float[ArrayLike, "..."],
    fs: float,
    *,
    hold: Hold = "first",
    substeps: int = 1,
    max_order: int = 3,
) -> VolterraResponse:
    r"""Volterra response to a record, from rest, as a cascade of linear oscillators.

    $$y_1 = h_1 * u, \quad y_2 = -h_1 * \rho y_1^2, \quad
      y_3 = -h_1 * (2\rho y_1 y_2 + \lambda_3 y_1^3)$$

    Equal to the convolutions with h_2 and h_3, whose kernels are those of this cascade. y_1 is
    exact for the held input. The drives of the higher orders are known at the samples with their
    rates and joined by cubics: their error falls as the fourth power of the step. With m steps to
    a cycle of omega_0, y_2 and y_3 are good to about (2.5/m)^4 of their peaks.

    Args:
        system: Polynomial oscillator.
        u: Input at the samples [N/kg].
        fs: Sampling rate [Hz].
        hold: Input between samples: "first" joins them by lines, "zero" keeps u[n] on [n, n + 1).
        substeps: Steps to a sample, of the same held input.
        max_order: Highest order returned.

    Returns:
        Time, and displacement and velocity of each order, at the samples.

    Raises:
        ConfigError: If `hold` is unknown, or `substeps` or `max_order` is less than 1.
        DataError: If `u` is not one finite record of at least two samples.

    Reference:
        Eqs. (16), (17).
    """
    if hold not in get_args(Hold):
        raise ConfigError(f'`hold` must be "first" or "zero", but is {hold!r}.')
    if substeps < 1 or max_order < 1:
        raise ConfigError(
            f"`substeps` and `max_order` must be 1 or more, but are {substeps} and {max_order}."
        )
    u = _record(u)
    y, v = _cascade(system, u, 1.0 / fs, hold, substeps, max_order)
    return VolterraResponse(jnp.arange(u.size) / fs, y, v)


@partial(jax.jit, static_argnames=("hold", "substeps", "max_order"))
def _cascade(
    system: PolynomialOscillator,
    u: Float[Array, " time"],
    dt: Scalar,
    hold: Hold,
    substeps: int,
    max_order: int,
) -> tuple[Float[Array, "order time"], Float[Array, "order time"]]:
    """Displacement and velocity of each order at the samples."""
    step = propagator(system.stiffness, system.damping, dt / substeps)
    y, v = propagate(step, held_input(_refined(u, hold, substeps), hold))
    parts, rates = [y], [v]
    while len(parts) < max_order:
        force, rate = jax.jvp(lambda *y: nonlinear_force(system, y), tuple(parts), tuple(rates))
        y, v = propagate(step, -hermite_input(force, rate, step.dt))
        parts, rates = [*parts, y], [*rates, v]
    return jnp.stack(parts)[:, ::substeps], jnp.stack(rates)[:, ::substeps]


def volterra_sums(
    system: PolynomialOscillator, u: Float[ArrayLike, "..."], fs: float, memory: int
) -> Float[Array, "order time"]:
    r"""First three orders of the response to a record, from rest, as multiple convolutions.

    $$y_\eta(t) = \int\!\cdots\!\int h_\eta(\tau_1,\dots,\tau_\eta)\,
      u(t-\tau_1)\cdots u(t-\tau_\eta)\,d\tau_1\cdots d\tau_\eta$$

    by the trapezoid rule at the samples, which suits an input joined by lines: the error falls as
    the square of the step. Work and memory grow as memory^3: for short records, to check or to
    teach; `volterra_response` is the route for data.

    Args:
        system: Polynomial oscillator, underdamped.
        u: Input at the samples, zero before the first [N/kg].
        fs: Sampling rate [Hz].
        memory: Samples kept of the kernels; as many as u has leave nothing out.

    Returns:
        Displacement of orders 1, 2 and 3 [m].

    Raises:
        ConfigError: If `memory` is less than 1.
        DataError: If `u` is not one finite record of at least two samples.

    Reference:
        Eqs. (16), (17).
    """
    if memory < 1:
        raise ConfigError(f"`memory` must be 1 sample or more, but is {memory}.")
    u = _record(u)
    return _sums(system, u, 1.0 / fs, memory)


@partial(jax.jit, static_argnames="memory")
def _sums(
    system: PolynomialOscillator, u: Float[Array, " time"], dt: Scalar, memory: int
) -> Float[Array, "order time"]:
    """The three convolutions over the last `memory` samples of each instant."""
    # The record starts at its first sample: the trapezoid there has one side only.
    padded = jnp.concatenate([jnp.zeros(memory - 1), u.at[0].divide(2.0)])
    past = dt * padded[jnp.arange(u.size)[:, None] + memory - 1 - jnp.arange(memory)]
    tau = dt * jnp.arange(memory)
    y_1 = past @ impulse_1(system, tau)
    y_2 = jnp.sum((past @ impulse_2(system, tau[:, None], tau)) * past, axis=1)
    inner = impulse_3(system, tau[:, None, None], tau[:, None], tau) @ past.T
    y_3 = jnp.einsum("ikn,ni,nk->n", inner, past, past)
    return jnp.stack([y_1, y_2, y_3])


def _record(u: Float[ArrayLike, "..."]) -> Float[Array, " time"]:
    """The record as an array, checked to be one."""
    u = jnp.asarray(u, dtype=float)
    if u.ndim != 1 or u.size < 2:
        raise DataError(
            f"`u` must be one record of at least two samples, but has shape {u.shape}.",
            remedy="Map over several records with jax.vmap.",
        )
    if is_concrete(u) and not bool(jnp.isfinite(u).all()):
        first = int(jnp.argmin(jnp.isfinite(u)))
        raise DataError(f"`u` must be finite, but `u[{first}]` is {u[first]}.")
    return u


def _refined(u: Float[Array, " time"], hold: Hold, substeps: int) -> Float[Array, " fine"]:
    """The held input on a grid `substeps` times as fine; the last sample stays the last."""
    if hold == "zero":
        return jnp.concatenate([jnp.repeat(u[:-1], substeps), u[-1:]])
    fine = u[:-1, None] + (u[1:] - u[:-1])[:, None] * jnp.arange(substeps) / substeps
    return jnp.concatenate([fine.ravel(), u[-1:]])
