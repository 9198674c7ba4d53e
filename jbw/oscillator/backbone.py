r"""How resonance moves with amplitude, and frequency responses over frequency and level."""

from functools import partial
from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Complex, Float, Real

from jbw.oscillator.batching import batched
from jbw.oscillator.checks import is_concrete
from jbw.oscillator.dimensionless import ScaledForce, dimensionless
from jbw.oscillator.harmonic_balance import (
    Packed,
    balance,
    linear_response,
    unpack,
)
from jbw.oscillator.hysteresis import steady_loop
from jbw.oscillator.parameters import BoucWen, Restoring
from jbw.oscillator.restoring import require_odd
from jbw.oscillator.steady import MANY_TURNS
from jbw.oscillator.steady_checks import require_converged, require_sense
from jbw.oscillator.waveform import num_turns, odd_harmonics


class Backbone(eqx.Module):
    """Resonance of the joint against amplitude.

    Attributes:
        y_peak: Displacement amplitude Y [m].
        omega: Resonance frequency, where y lags the force by 90 degrees [rad/s].
        zeta: Equivalent damping ratio there, viscous and hysteretic [-].
        amplitude: Force amplitude that drives Y there [N/kg].
    """

    y_peak: Float[Array, "..."]
    omega: Float[Array, "..."]
    zeta: Float[Array, "..."]
    amplitude: Float[Array, "..."]


def backbone(joint: BoucWen, y_peak: Real[ArrayLike, "..."]) -> Backbone:
    r"""Resonance frequency and equivalent damping against amplitude, from the steady loop.

    For y = Y cos(theta) and the balance of the first harmonic alone, phase resonance needs

    $$\omega^2 = k + \frac{\mathrm{Re}\,Z_1 + f_1}{Y}, \qquad
      A = 2\zeta\omega_n\omega Y + \frac{E}{\pi Y} = 2\zeta_{eq}\,\omega^2 Y$$
    $$\zeta_{eq} = \zeta\,\frac{\omega_n}{\omega} + \frac{E}{2\pi\omega^2 Y^2}$$

    with E the energy that the loop dissipates per cycle and f_1 the first harmonic of the restoring
    force beside it, 3 lambda_3 Y^3/4 for a cubic one. Leaving the higher harmonics out costs
    2e-5 to 2.5e-4 in Y at the paper's parameters.

    Args:
        joint: Bouc-Wen parameters with nu = 1.
        y_peak: Displacement amplitudes Y [m]; at 0 the sticking joint.

    Returns:
        The backbone at each amplitude.

    Raises:
        ModelError: `nu` is not 1, the restoring force has an even part, or a concrete argument is
            not finite.
        ConfigError: `y_peak` is negative.

    Reference:
        Z_1 and E close Eqs. (3)-(6).
    """
    require_odd(joint)
    loop = steady_loop(joint, y_peak)
    omega_squared = joint.k + loop.k_eq
    if joint.restoring is not None:
        omega_squared = omega_squared + batched(_equivalent_stiffness, joint, y_peak)
    omega = jnp.sqrt(omega_squared)
    zeta = joint.zeta * joint.omega_n / omega + loop.c_eq_omega / (2.0 * omega_squared)
    y_peak = jnp.asarray(y_peak, float)
    amplitude = 2.0 * zeta * omega_squared * y_peak
    return Backbone(*jnp.broadcast_arrays(y_peak, omega, zeta, amplitude))


def _equivalent_stiffness(joint: BoucWen, y_peak: Array) -> Array:
    """First harmonic of the restoring force along y = Y cos(theta), over Y [1/s^2]."""
    force = ScaledForce(cast(Restoring, joint.restoring), y_peak, 1.0)
    return odd_harmonics(force, jnp.ones(1, complex))[0].real


def frequency_response(
    joint: BoucWen,
    omega: Float[Array, "freq"],
    amplitude: Real[ArrayLike, "..."],
    num_harmonics: int = 8,
    *,
    max_turns: int = 2,
) -> Complex[Array, "... freq harmonic"]:
    r"""Odd harmonics of the response over frequency, each tone started from its neighbour.

    The same solutions as `steady_state`, reached as a slow stepped sine reaches them: Newton's
    iteration starts from the harmonics at the frequency before, or raises the load in steps
    where that fails. Where several responses exist the order of `omega` decides, so a falling
    sweep may differ from a rising one, as on the rig. Differentiable like `steady_state`.

    Args:
        joint: Bouc-Wen parameters with nu = 1; its leaves broadcast against `amplitude`.
        omega: Angular frequencies in the order of the sweep [rad/s].
        amplitude: Force amplitudes A of the levels [N/kg].
        num_harmonics: Number of odd harmonics.
        max_turns: Turning points of y allowed in a period, as for `steady_state`.

    Returns:
        Complex peak amplitudes of orders 1, 3, 5, ... [m]; NaN where not converged.

    Raises:
        ModelError, ConfigError: As for `steady_state`.

    Reference:
        In place of Eqs. (19)-(31).
    """
    omega = jnp.asarray(omega, float)
    require_sense(joint, omega, amplitude, num_harmonics, max_turns)
    harmonics, turns = _sweep(joint, omega, amplitude, num_harmonics, max_turns)
    if not is_concrete(joint, omega, amplitude):
        return harmonics
    if max_turns == 2 and bool(jnp.any(turns > 2)):
        harmonics, turns = _sweep(joint, omega, amplitude, num_harmonics, MANY_TURNS)
    level = jax.tree.map(lambda leaf: jnp.asarray(leaf)[..., None], (joint, amplitude))
    require_converged(level[0], omega, level[1], harmonics, turns)
    return harmonics


@partial(jax.jit, static_argnums=(3, 4))
def _sweep(
    joint: BoucWen,
    omega: Float[Array, "freq"],
    amplitude: ArrayLike,
    num_harmonics: int,
    max_turns: int,
) -> tuple[Array, Array]:
    def level(joint: BoucWen, amplitude: Array) -> tuple[Array, Array]:
        unit, ratio, length = dimensionless(joint, omega, amplitude)

        def tone(before: Packed, ratio: Array) -> tuple[Packed, tuple[Array, Array]]:
            packed, load = balance(unit, ratio, before, max_turns)
            q = unpack(packed)
            turns = num_turns(q)
            good = (load == 1.0) & (turns <= max_turns)
            return packed, (jnp.where(good, length * q, jnp.nan), turns)

        return jax.lax.scan(tone, linear_response(unit, ratio[0], num_harmonics), ratio)[1]

    return batched(level, joint, amplitude)
