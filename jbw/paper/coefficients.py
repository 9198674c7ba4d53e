r"""Branches of the steady loop, and the cubic polynomials that replace them, Eqs. (3)-(13).

Branches are closed forms or Taylor polynomials; the cubic polynomials bound the loop and replace
the hysteretic force.
"""

import math
import warnings
from functools import partial
from typing import Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Real

from jbw.errors import ConfigError, ModelError
from jbw.oscillator.checks import (
    is_concrete,
    require_at_least,
    require_closed_form,
    require_finite,
)
from jbw.oscillator.laws.hysteresis import steady_loop
from jbw.oscillator.laws.relaxation import phi, unloading_lag
from jbw.oscillator.oscillator import BoucWen
from jbw.oscillator.parameters import Hysteresis, Scalar
from jbw.oscillator.steady.waveform import gauss_legendre

Path = Literal[1, 2, 3, 4]
Variant = Literal["least_squares", "chebyshev", "taylor_least_squares", "printed", "printed_closed"]
_NUM_NODES = 48
_STRONG = 1.0  # value of delta Y above which the loop deviates strongly from a straight line
# The fits are in units of Y and alpha Y: d = delta Y, g = gamma Y, eta = y_open/Y, s = y/Y. They
# return the coefficients lambda_0..lambda_3 of s - eta - lag. Polynomials contain the straight
# line, so only the lag is fitted.
Coefficients = tuple[Array, Array, Array, Array]


def branch(
    joint: Hysteresis,
    y: Real[ArrayLike, "..."],
    y_open: Real[ArrayLike, "..."],
    path: Path,
    order: int | None = None,
) -> Float[Array, "..."]:
    r"""Return the hysteretic force Z_i(y) on one of the four branches of the loop.

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
    """Return the Taylor polynomial of phi(c, x) at x = 0, the sum of (-c)^(n-1) x^n / n!."""
    c = jnp.asarray(c)
    terms = ((-c) ** (n - 1) * x**n / math.factorial(n) for n in range(1, order + 1))
    return sum(terms, jnp.zeros_like(x))


class Smoothing(eqx.Module):
    """The coefficients of the smoothed hysteretic force, whose branch depends on the sign of v.

    Attributes:
        lambda_0: Force at y = 0, opposing the motion [N/kg].
        lambda_1: Linear stiffness [1/s^2].
        lambda_2: Quadratic coefficient [1/(m s^2)]; it opens the loop together with lambda_0.
        lambda_3: Cubic stiffness [1/(m^2 s^2)].
    """

    lambda_0: Scalar
    lambda_1: Scalar
    lambda_2: Scalar
    lambda_3: Scalar


def smoothing(
    joint: BoucWen,
    y_peak: Real[ArrayLike, "..."],
    variant: Variant = "least_squares",
    y_open: Real[ArrayLike, "..."] | None = None,
) -> Smoothing:
    r"""Return the coefficients lambda_0..lambda_3 of the polynomial that replaces Z for peak Y.

    The unloading force c_0 + c_1 y + c_2 y^2 + c_3 y^3 is fitted over [-Y, Y], and

    $$\lambda_0 = -c_0, \quad \lambda_1 = c_1, \quad \lambda_2 = c_2, \quad \lambda_3 = c_3$$

    as Eqs. (7), (8) and (14) need it. The variants:

    - `"least_squares"`: uniform weight, exact paths: Eq. (9) with the unloading polynomial in both
      of its integrands.
    - `"chebyshev"`: weight 1/sqrt(Y^2 - y^2), exact paths; keeps the first and third cosine
      harmonics of Z for y = Y cos(theta).
    - `"taylor_least_squares"`: uniform weight, paths cut after the cubic term; closed form.
    - `"printed"`: Eqs. (10)-(13) untouched, with + before 105 in (13). They keep single terms of
      the closed form above, and their lambda_0 and lambda_2 have the opposite sign.
    - `"printed_closed"`: Eqs. (24), (25), the printed ones for y_open = gamma = 0.

    Args:
        joint: Bouc-Wen parameters with nu = 1; omega_n, zeta and `restoring` have no influence.
        y_peak: Largest displacement Y of the loop [m].
        variant: One of the names above.
        y_open: Threshold y_0 of the loop [m], within (-Y, Y); that of `steady_loop` when None.

    Returns:
        Coefficients of the smoothed force.

    Warns:
        UserWarning: delta Y is above 1, where no cubic follows the loop closely.

    Raises:
        ModelError: `nu` is not 1, a concrete argument is not finite, or `y_open` lies outside the
            loop.
        ConfigError: The variant is unknown, or a concrete `y_peak` is not positive.

    Reference:
        Eq. (10), corrected: lambda_0 = -c_0 as (7), (8) need it; the printed sign is opposite and
        the terms in Y^3 are dropped.
        Eq. (11), corrected: less 5 alpha delta Y/32, which the print drops.
        Eq. (12), corrected: lambda_2 = +c_2; the printed sign is opposite, 5 alpha delta gamma Y/16
        is dropped.
        Eq. (13), corrected: with alpha gamma^2/6, and the plus sign that the print lost.
        Eq. (24), corrected: less 5 alpha delta Y/32.
        Eq. (25), corrected: with alpha gamma^2/6; lambda_3 stays negative where the force softens.

    Examples:
        Without gamma the paper's cubic stiffness is alpha (delta^2 / 6 - 35 delta / (96 Y)):

        >>> import jbw; jbw.enable_x64()
        >>> joint = jbw.BoucWen(omega_n=118.12, zeta=0.00444, alpha=497.4, delta=340.2, gamma=0.0)
        >>> found = jbw.smoothing(joint, y_peak=0.8e-3, variant="printed_closed")
        >>> print(f"{found.lambda_3:.4g} 1/(m^2 s^2)")
        -6.752e+07 1/(m^2 s^2)
    """
    if variant not in get_args(Variant):
        variants = ", ".join(f'"{name}"' for name in get_args(Variant))
        raise ConfigError(f'Argument `variant` must be one of {variants}, but it is "{variant}".')
    require_closed_form(joint)
    require_finite(joint, y_peak=y_peak)
    y_open = _threshold(joint, y_peak, y_open)
    _warn_of_strong_motion(joint, y_peak)
    return _smoothing(joint, y_peak, y_open, variant)


def _threshold(joint: BoucWen, y_peak: ArrayLike, y_open: ArrayLike | None) -> ArrayLike:
    """Return the threshold y_0 of a loop with peak Y: the given one, or that of the steady loop."""
    require_at_least("y_peak", y_peak, 0.0, open_end=True)
    if y_open is None:
        return steady_loop(joint, y_peak).y_open
    if is_concrete(y_open, y_peak) and not np.all(np.abs(y_open) < np.asarray(y_peak)):
        raise ModelError(
            f"Argument `y_open` must lie between -y_peak and y_peak, but y_open = {y_open} with "
            f"y_peak = {y_peak}.",
            remedy="Leave `y_open` out to take the threshold of the steady loop.",
        )
    return y_open


def _warn_of_strong_motion(joint: BoucWen, y_peak: ArrayLike) -> None:
    """Warn if a cubic polynomial cannot follow the open loop."""
    if not is_concrete(joint.delta, y_peak):
        return
    reach = float(np.max(np.abs(np.asarray(joint.delta)) * np.asarray(y_peak)))
    if reach > _STRONG:
        warnings.warn(
            f"The smoothing holds for weak hysteresis, delta*y_peak well below 1, but delta*y_peak "
            f"= {reach:.3g}: the cubic does not follow the loop there. Use `jbw.steady_state` or "
            "`jbw.simulate` at this amplitude.",
            stacklevel=3,
        )


@partial(jax.jit, static_argnames="variant")
def _smoothing(joint: BoucWen, y_peak: ArrayLike, y_open: ArrayLike, variant: Variant) -> Smoothing:
    alpha, d, g, eta, y_peak = jnp.broadcast_arrays(
        joint.alpha, joint.delta * y_peak, joint.gamma * y_peak, y_open / y_peak, y_peak
    )
    fit = {
        "least_squares": _least_squares,
        "chebyshev": _chebyshev,
        "taylor_least_squares": _taylor_least_squares,
        "printed": _printed,
        "printed_closed": _printed_closed,
    }[variant]
    lambda_0, lambda_1, lambda_2, lambda_3 = fit(d, g, eta)
    return Smoothing(
        lambda_0=alpha * y_peak * lambda_0,
        lambda_1=alpha * lambda_1,
        lambda_2=alpha / y_peak * lambda_2,
        lambda_3=alpha / y_peak**2 * lambda_3,
    )


def closed_loop_stiffness(
    alpha: Scalar, delta: Scalar, y_peak: Scalar, gamma: Scalar = 0.0
) -> Float[Array, "..."]:
    r"""Return the cubic stiffness of a nearly closed loop.

    $$\lambda_3 = \alpha\left(\frac{\delta^2 + \gamma^2}{6} - \frac{35\,\delta}{96\,Y}\right)$$

    Args:
        alpha: Stiffness of the hysteretic part [1/s^2].
        delta: Softening of the hysteresis [1/m].
        y_peak: Largest displacement Y [m].
        gamma: Opening of the loop [1/m]; the default 0 is that of the printed equation.

    Returns:
        lambda_3 [1/(m^2 s^2)].

    Reference:
        Eq. (25), corrected: with gamma^2/6; as printed for gamma = 0.
    """
    squares = (jnp.asarray(delta) ** 2 + jnp.asarray(gamma) ** 2) / 6
    return jnp.asarray(alpha * (squares - 35 * jnp.asarray(delta) / (96 * jnp.asarray(y_peak))))


def unloading_force(polynomial: Smoothing, y: Real[ArrayLike, "..."]) -> Float[Array, "..."]:
    r"""Return the smoothed force on unloading, dy/dt < 0.

    $$F(y) = -\lambda_0 + \lambda_1 y + \lambda_2 y^2 + \lambda_3 y^3$$

    Args:
        polynomial: Coefficients of the smoothed force, with the sign rule of `smoothing`.
        y: Displacement [m].

    Returns:
        Force [N/kg].

    Reference:
        Eq. (8), corrected: it holds where dy/dt < 0, printed du/dt < 0.
    """
    return smoothed_force(polynomial, y, -1.0)


def loading_force(polynomial: Smoothing, y: Real[ArrayLike, "..."]) -> Float[Array, "..."]:
    r"""Return the smoothed force on loading, dy/dt > 0: the mirror image of unloading.

    $$F(y) = \lambda_0 + \lambda_1 y - \lambda_2 y^2 + \lambda_3 y^3$$

    Args:
        polynomial: Coefficients of the smoothed force, with the sign rule of `smoothing`.
        y: Displacement [m].

    Returns:
        Force [N/kg].

    Reference:
        Eq. (7), corrected: it holds where dy/dt > 0, printed du/dt > 0.
    """
    return smoothed_force(polynomial, y, 1.0)


def smoothed_force(
    polynomial: Smoothing,
    y: Real[ArrayLike, "..."],
    v: Real[ArrayLike, "..."],
    *,
    width: Scalar = 0.0,
) -> Float[Array, "..."]:
    r"""Return the polynomial restoring force that replaces the hysteretic force Z on both branches.

    $$F(y, v) = \lambda_1 y + \lambda_3 y^3 + s(v)\,(\lambda_0 - \lambda_2 y^2), \qquad
      s(v) = \mathrm{sgn}(v) \;\text{ or }\; \tanh(v/w)$$

    Args:
        polynomial: Coefficients of the smoothed force, with the sign rule of `smoothing`.
        y: Displacement [m].
        v: Velocity, or another signal whose sign switches the branches; at zero the two are
            averaged.
        width: Width w of the transition between the branches, in the unit of `v`; 0 for a jump.

    Returns:
        Force [N/kg].

    Reference:
        Eqs. (7), (8), corrected: the branches switch with the sign of dy/dt, printed du/dt; the
        printed switching is that of v = du/dt.
    """
    y = jnp.asarray(y)
    elastic = (polynomial.lambda_1 + polynomial.lambda_3 * y**2) * y
    opening = polynomial.lambda_0 - polynomial.lambda_2 * y**2
    return jnp.asarray(elastic + switch(v, width) * opening)


def switch(v: Real[ArrayLike, "..."], width: Scalar = 0.0) -> Float[Array, "..."]:
    """Return the sign of the velocity v; for a positive `width`, return tanh(v/width)."""
    v, width = jnp.asarray(v, float), jnp.asarray(width, float)
    safe = jnp.where(width > 0.0, width, 1.0)
    return jnp.where(width > 0.0, jnp.tanh(v / safe), jnp.sign(v))


def smoothing_error(
    joint: BoucWen,
    polynomial: Smoothing,
    y_peak: Real[ArrayLike, "..."],
    y_open: Real[ArrayLike, "..."] | None = None,
) -> Float[Array, "..."]:
    r"""Return the squared error of the smoothed unloading force, which the fit minimises.

    $$J = \int_{-Y}^{y_0} (Z_2 - F)^2\,dy + \int_{y_0}^{Y} (Z_1 - F)^2\,dy$$

    Args:
        joint: Bouc-Wen parameters with nu = 1.
        polynomial: Coefficients of the smoothed force, with the sign rule of `smoothing`.
        y_peak: Largest displacement Y of the loop [m].
        y_open: Threshold y_0 of the loop [m], within (-Y, Y); that of `steady_loop` when None.

    Returns:
        Error J [N^2 m/kg^2].

    Raises:
        ModelError: `nu` is not 1, or `y_open` lies outside the loop.
        ConfigError: A concrete `y_peak` is not positive.

    Reference:
        Eq. (9), corrected: the unloading polynomial stands in both integrals; the print has two
        different functions.
    """
    require_closed_form(joint)
    y_peak = jnp.asarray(y_peak, float)
    y_open = _threshold(joint, y_peak, y_open)
    s, weights = gauss_legendre(_NUM_NODES, -1.0, jnp.asarray(y_open / y_peak), 1.0)
    broadcast = Smoothing(*(jnp.asarray(x)[..., None] for x in jax.tree.leaves(polynomial)))
    alpha, delta, gamma, peak, y_0 = (
        jnp.asarray(x)[..., None] for x in (joint.alpha, joint.delta, joint.gamma, y_peak, y_open)
    )
    y = s * peak
    z = alpha * (y - y_0 - unloading_lag(y, y_0, delta, gamma))
    return y_peak * jnp.sum(weights * (z - unloading_force(broadcast, y)) ** 2, axis=-1)


def _least_squares(d: Array, g: Array, eta: Array) -> Coefficients:
    """Return coefficients of the smoothed force from Legendre polynomials P_0..P_3 of the lag."""
    # The integral is split at the threshold, because the lag has a kink there.
    s, weights = gauss_legendre(_NUM_NODES, -1.0, eta, 1.0)
    lost = weights * unloading_lag(s, *(x[..., None] for x in (eta, d, g)))
    basis = (1.0, s, 1.5 * s**2 - 0.5, 2.5 * s**3 - 1.5 * s)
    p_0, p_1, p_2, p_3 = ((n + 0.5) * jnp.sum(lost * p, -1) for n, p in enumerate(basis))
    return eta + p_0 - 0.5 * p_2, 1.0 - p_1 + 1.5 * p_3, -1.5 * p_2, -2.5 * p_3


def _chebyshev(d: Array, g: Array, eta: Array) -> Coefficients:
    """Return coefficients of the smoothed force from a Chebyshev series T_0..T_3 of the lag."""
    theta, weights = gauss_legendre(_NUM_NODES, 0.0, jnp.arccos(eta), jnp.pi)
    lost = weights * unloading_lag(jnp.cos(theta), *(x[..., None] for x in (eta, d, g)))
    t_0, t_1, t_2, t_3 = (2.0 / jnp.pi * jnp.sum(lost * jnp.cos(n * theta), -1) for n in range(4))
    return eta + 0.5 * t_0 - t_2, 1.0 - t_1 + 3.0 * t_3, -2.0 * t_2, -4.0 * t_3


def _taylor_least_squares(d: Array, g: Array, eta: Array) -> Coefficients:
    """Return the coefficients that minimise Eq. (9) for branches truncated after the cubic term."""
    dg, dd_gg = d * g, d**2 + g**2
    c_0 = (
        (-eta + 3 * d * eta / 16 + g * eta**2 / 2 + dg / 48 - 3 * dg * eta**2 / 16)
        + (-dd_gg * eta**3 / 6 + 3 * d * eta**3 / 8 - 3 * dg * eta**4 / 16)
        + (-d * eta**5 / 16 + dg * eta**6 / 48)
    )
    c_1 = (
        (1 - 5 * d / 32 - g * eta + 5 * dg * eta / 16 + dd_gg * eta**2 / 2)
        + (-45 * d * eta**2 / 32 + 15 * dg * eta**3 / 16 + 25 * d * eta**4 / 32)
        + (-5 * dg * eta**5 / 16 - 7 * d * eta**6 / 32 + dg * eta**7 / 16)
    )
    c_2 = (
        (g / 2 - 5 * dg / 16 - dd_gg * eta / 2 + 15 * d * eta / 16 - 15 * dg * eta**2 / 16)
        + (-5 * d * eta**3 / 8 + 5 * dg * eta**4 / 16)
        + (3 * d * eta**5 / 16 - dg * eta**6 / 16)
    )
    c_3 = (
        (dd_gg / 6 - 35 * d / 96 + 35 * dg * eta / 48 + 35 * d * eta**2 / 32)
        + (-35 * dg * eta**3 / 48 - 35 * d * eta**4 / 32)
        + (7 * dg * eta**5 / 16 + 35 * d * eta**6 / 96 - 5 * dg * eta**7 / 48)
    )
    return -c_0, c_1, c_2, c_3


def _printed(d: Array, g: Array, eta: Array) -> Coefficients:
    """Return the coefficients of Eqs. (10)-(13) as printed: with wrong signs and missing terms."""
    dg, dd_gg = d * g, d**2 + g**2
    lambda_0 = -eta + 3 * d * eta / 16 + g * eta**2 / 2
    lambda_2 = -g / 2 + dd_gg * eta / 2 - 15 * d * eta / 16 + 15 * dg * eta**2 / 16
    lambda_3 = (
        d**2 / 6
        + (-35 * d + 105 * d * eta**2 - 105 * d * eta**4) / 96
        + 35 * dg * (eta - eta**3) / 48
    )
    return lambda_0, jnp.ones_like(d), lambda_2, lambda_3


def _printed_closed(d: Array, g: Array, eta: Array) -> Coefficients:
    """Return the coefficients of Eqs. (24), (25): the closed loop, only lambda_1 and lambda_3."""
    zero, unity = jnp.zeros_like(d), jnp.ones_like(d)
    return zero, unity, zero, closed_loop_stiffness(unity, d, unity)
