r"""Volterra response of the polynomial oscillator to any record, Eqs. (16), (17).

Three routes to $y = y_1 + y_2 + y_3 + \dots$: the multiple convolutions with the kernels in time,
which are the definition and cost memory^order a sample; the cascade of linear oscillators to which
they reduce for this system, which costs a few linear responses; and the same cascade in frequency,
for one period of a periodic record.
"""

from functools import partial
from typing import Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Complex, Float

from jbw.errors import ConfigError, DataError
from jbw.oscillator.checks import is_concrete
from jbw.oscillator.linear import Moments, impulse_moments
from jbw.oscillator.parameters import Scalar
from jbw.paper.impulse import impulse_1, impulse_2, impulse_3
from jbw.paper.polynomial import PolynomialOscillator, kernel_1, nonlinear_force

Hold = Literal["first", "zero"]


class VolterraResponse(eqx.Module):
    """Homogeneous parts of a response; their sum over orders is the response.

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
        Eq. (16), corrected: y_0 there is the mean and not the threshold of the loop; here zero.
        Eq. (17), corrected: the printed product sign is superfluous.
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
    step = dt / substeps
    moments = impulse_moments(system.stiffness, system.damping, step, 4)
    y, v = _propagate(moments, _held(_refined(u, hold, substeps), hold))
    parts, rates = [y], [v]
    while len(parts) < max_order:
        force, rate = jax.jvp(lambda *y: nonlinear_force(system, y), tuple(parts), tuple(rates))
        y, v = _propagate(moments, -_hermite(force, step * rate))
        parts, rates = [*parts, y], [*rates, v]
    return jnp.stack(parts)[:, ::substeps], jnp.stack(rates)[:, ::substeps]


def _held(f: Float[Array, " time"], hold: Hold) -> Float[Array, "step 4"]:
    """Polynomials in each step of an input that is held ("zero") or joined by lines ("first")."""
    slope = f[1:] - f[:-1] if hold == "first" else jnp.zeros_like(f[1:])
    none = jnp.zeros_like(slope)
    return jnp.stack([f[:-1], slope, none, none], axis=-1)


def _hermite(f: Float[Array, " time"], rise: Float[Array, " time"]) -> Float[Array, "step 4"]:
    """Cubics in each step of an input that is known with its rise over a step at each sample."""
    change, start, end = f[1:] - f[:-1], rise[:-1], rise[1:]
    return jnp.stack([f[:-1], start, 3 * change - 2 * start - end, start + end - 2 * change], -1)


def _propagate(
    moments: Moments, polynomials: Float[Array, "step 4"]
) -> tuple[Float[Array, " time"], Float[Array, " time"]]:
    """Displacement and velocity at the samples, from rest, under a polynomial in each step."""
    push = polynomials @ moments.y, polynomials @ moments.v

    def advance(state: tuple, push: tuple) -> tuple:
        (y, v), (push_y, push_v) = state, push
        after_y = y + moments.f_11 * y + moments.f_12 * v + push_y
        after_v = v + moments.f_21 * y + moments.f_22 * v + push_v
        return (after_y, after_v), (after_y, after_v)

    rest = jnp.zeros((), polynomials.dtype)
    _, (y, v) = jax.lax.scan(advance, (rest, rest), push)
    return jnp.concatenate([rest[None], y]), jnp.concatenate([rest[None], v])


def periodic_response(
    system: PolynomialOscillator, u: Float[ArrayLike, "..."], fs: float, *, max_order: int = 3
) -> VolterraResponse:
    r"""Steady Volterra response to one period of a periodic, band-limited record, in frequency.

    $$Y_1 = H_1 U, \qquad Y_\eta(\omega) = -H_1(\omega)\,\mathcal F\bigl[\rho \sum y_i y_k
      + \lambda_3 \sum y_i y_k y_l\bigr](\omega)$$

    which sums H_eta over every way to make omega of eta lines of U. The products are taken on a
    grid max_order + 1 times as fine, so that no line of them folds back; at the samples the
    response is that of the input between them, joined by its own Fourier series.

    Args:
        system: Polynomial oscillator.
        u: Input at the samples of one period [N/kg].
        fs: Sampling rate [Hz].
        max_order: Highest order returned.

    Returns:
        Time, and displacement and velocity of each order, at the samples.

    Raises:
        ConfigError: `max_order` is less than 1.
        DataError: `u` is not one finite record of at least two samples.
        ModelError: The oscillator has no damping and a line of the record is its pole.

    Reference:
        Eq. (16), as printed; every term is (17) transformed by (18).
    """
    if max_order < 1:
        raise ConfigError(f"`max_order` must be 1 or more, but is {max_order}.")
    u = _record(u)
    fine = (max_order + 1) * u.size
    omega = 2 * jnp.pi * fs * jnp.arange(fine // 2 + 1) / u.size
    y, v = _lines_response(kernel_1(system, omega), omega, u, system, max_order)
    return VolterraResponse(jnp.arange(u.size) / fs, y, v)


@partial(jax.jit, static_argnames="max_order")
def _lines_response(
    receptance: Complex[Array, " line"],
    omega: Float[Array, " line"],
    u: Float[Array, " time"],
    system: PolynomialOscillator,
    max_order: int,
) -> tuple[Float[Array, "order time"], Float[Array, "order time"]]:
    """Displacement and velocity of each order at the samples, from the lines of the input."""
    oversampling, fine = max_order + 1, (max_order + 1) * u.size
    lines = jnp.fft.rfft(u) * oversampling
    if u.size % 2 == 0:  # the line at the old Nyquist frequency has a partner on the finer grid
        lines = lines.at[-1].divide(2.0)
    spectrum = jnp.zeros(omega.size, lines.dtype).at[: lines.size].set(lines)
    parts, rates = [], []
    while len(parts) < max_order:
        moved = receptance * spectrum
        parts.append(jnp.fft.irfft(moved, fine))
        rates.append(jnp.fft.irfft(1j * omega * moved, fine))
        spectrum = -jnp.fft.rfft(nonlinear_force(system, parts))
    return jnp.stack(parts)[:, ::oversampling], jnp.stack(rates)[:, ::oversampling]


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
        Eq. (17), corrected: the printed product sign is superfluous.
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
