r"""The least-squares objectives of Steps 3 and 4, constraints, and conv(n), Eqs. (38)-(42)."""

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Inexact

from jbw.errors import DataError
from jbw.oscillator.checks import is_concrete, require_at_least
from jbw.paper.equivalent import Variant, require_variant

Bounds = dict[str, tuple[float, float]]
MAX_DELTA = 500.0  # upper bound of delta in (39) [1/m]


def kernel_residual(
    measured: Inexact[ArrayLike, " freq"],
    model: Inexact[ArrayLike, " freq"],
    weight: Float[ArrayLike, "..."] = 1.0,
) -> Float[Array, " values"]:
    r"""Return the residuals of a kernel: measured minus model, real parts, then imaginary parts.

    $$r_i = w_i\,\bigl(H_3(\omega_i) - H_3(\omega_i; \theta)\bigr)$$

    Args:
        measured: Measured kernel at the probing frequencies [m^-2 s^6].
        model: Kernel of the model [m^-2 s^6].
        weight: Weight of each frequency, one over its standard error; 1 as printed.

    Returns:
        Residuals, twice as many as frequencies.

    Reference:
        Eq. (38), as printed for unit weight.
    """
    residual = (jnp.asarray(measured) - jnp.asarray(model)) * jnp.asarray(weight)
    return jnp.concatenate([residual.real, residual.imag])


def kernel_objective(
    measured: Inexact[ArrayLike, " freq"],
    model: Inexact[ArrayLike, " freq"],
    weight: Float[ArrayLike, "..."] = 1.0,
) -> Float[Array, ""]:
    r"""Return the sum of squares that Step 3 minimises, $J = \sum_i w_i^2\,|H_3 - H_3(\theta)|^2$.

    Args:
        measured: Measured kernel at the probing frequencies [m^-2 s^6].
        model: Kernel of the model [m^-2 s^6].
        weight: Weight of each frequency, one over its standard error; 1 as printed.

    Returns:
        Objective J.

    Reference:
        Eq. (38), as printed for unit weight.
    """
    return jnp.sum(kernel_residual(measured, model, weight) ** 2)


def kernel_constraints(omega_n: float) -> Bounds:
    r"""Return the bounds of Step 3: $0 < \alpha \le \omega_n^2$ and $0 < \delta \le 500$.

    With these bounds k = omega_n^2 - alpha is not negative.

    Args:
        omega_n: Natural frequency at small amplitude [rad/s].

    Returns:
        Bounds of alpha [1/s^2] and delta [1/m].

    Raises:
        ConfigError: `omega_n` is not positive.

    Reference:
        Eq. (39), as printed.
    """
    require_at_least("omega_n", omega_n, 0.0, open_end=True)
    return {"alpha": (0.0, float(omega_n) ** 2), "delta": (0.0, MAX_DELTA)}


def kernel_energy(
    h_3: Inexact[ArrayLike, "... freq"], omega: Float[ArrayLike, " freq"]
) -> Float[Array, "..."]:
    r"""Return the energy of a kernel over the band of the tones, $\int_B |H_3(\omega)|^2\,d\omega$.

    Args:
        h_3: Kernel of every draw at the probing frequencies [m^-2 s^6].
        omega: The probing frequencies, rising [rad/s].

    Returns:
        Energy of each draw, by the trapezoid rule [rad s^11/m^4].

    Reference:
        Eq. (40), as printed: the integral of its sum.
    """
    return jnp.trapezoid(jnp.abs(jnp.asarray(h_3)) ** 2, jnp.asarray(omega), axis=-1)


def convergence(energy: Float[ArrayLike, "... draw"]) -> Float[Array, "... draw"]:
    r"""Return the running mean over the draws, $\mathrm{conv}(n) = \frac1n \sum_{i \le n} E_i$.

    Args:
        energy: Energy of each draw, as `kernel_energy` returns it.

    Returns:
        Mean of the first n draws, for every n.

    Reference:
        Eq. (40), corrected: a flat running mean is no test of convergence; look at the R-hat of
        several chains and the effective number of draws.
    """
    energy = jnp.asarray(energy)
    return jnp.cumsum(energy, axis=-1) / jnp.arange(1, energy.shape[-1] + 1)


def response_misfit(
    measured: Float[ArrayLike, "... time"],
    model: Float[ArrayLike, "... time"],
) -> Float[Array, "..."]:
    r"""Return the relative velocity misfit that Step 4 minimises.

    $$J = \sqrt{\frac{\sum_n (v_n - v_n(\theta))^2}{N\,\mathrm{var}(v)}}$$

    J^2 N var(v)/(2 sigma^2) is the negative log likelihood (37), up to a constant.

    Args:
        measured: Measured velocity [m/s].
        model: Velocity of the model [m/s].

    Returns:
        Misfit [-].

    Raises:
        DataError: A concrete measured velocity is constant.

    Reference:
        Eq. (41), as printed.
    """
    measured, model = jnp.asarray(measured), jnp.asarray(model)
    variance = jnp.var(measured, axis=-1)
    if is_concrete(variance) and bool(jnp.any(variance == 0.0)):
        raise DataError("The measured velocity must vary to normalise a misfit, but is constant.")
    return jnp.sqrt(jnp.mean((measured - model) ** 2, axis=-1) / variance)


def opening_constraints(delta: float, variant: Variant = "corrected") -> Bounds:
    r"""Bound gamma in Step 4: printed $0 < \gamma \le \delta$, corrected $\gamma > -\delta$.

    Args:
        delta: Softening of the joint [1/m].
        variant: "corrected", which suffices for a bounded force, or "printed".

    Returns:
        Bounds of gamma [1/m].

    Raises:
        ConfigError: The variant is unknown.

    Reference:
        Eq. (42), corrected: gamma + delta > 0 bounds the force; neither this order of gamma and
        delta nor the opposite one is needed. Printed by variant="printed".
    """
    require_variant(variant)
    delta = float(delta)
    return {"gamma": (0.0, delta) if variant == "printed" else (-delta, float("inf"))}
