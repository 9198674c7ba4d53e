r"""Periodic response by shooting over half a period: an alternative to harmonic balance."""

from functools import partial
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix
from jaxtyping import Array, Complex, Float

from jbw.errors import ModelError
from jbw.oscillator.checks import (
    is_concrete,
    require_at_least,
    require_finite,
    require_float64,
    require_periodic,
)
from jbw.oscillator.dimensionless import dimensionless
from jbw.oscillator.laws.hysteresis import hysteresis_rate
from jbw.oscillator.oscillator import BoucWen
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.steady.waveform import orders

_MAX_STEPS = 16384
_MAX_NEWTON = 32
# Above the integration's noise (1e-13), which an orbit near a fold magnifies; Newton's last step
# gains the digits beyond.
_TOLERANCE = 1e-8

State = Float[Array, "3"]


class PeriodicOrbit(eqx.Module):
    """Periodic response to u = A cos(omega t), found in time.

    Attributes:
        initial: (y [m], v [m/s], z [N/kg]) at t = 0.
        harmonics: Complex peak amplitudes of orders 1, 3, 5, ... [m].
        multipliers: Eigenvalues of the half-period map x -> -x(T/2) about the orbit [-]; the orbit
            is stable where all lie inside the unit circle.
    """

    initial: State
    harmonics: Complex[Array, " harmonic"]
    multipliers: Complex[Array, "3"]


def shooting(
    joint: BoucWen,
    omega: Scalar,
    amplitude: Scalar,
    num_harmonics: int = 8,
    *,
    initial: tuple[Scalar, Scalar, Scalar] | None = None,
    rtol: float = 1e-12,
) -> PeriodicOrbit:
    r"""Periodic response to a tone by shooting over half a period.

    $$x(T/2; x_0) = -x_0, \qquad x = (y, v, z), \quad T = 2\pi/\omega$$

    The rates (1)-(2) are integrated by Dormand and Prince's eighth-order method under a tight
    tolerance, and the harmonics as integrals beside them; no closed form of the hysteresis and no
    truncation enters, so this is independent of `steady_state`. One
    tone a call (`jax.vmap` for more); differentiable in forward mode.

    Args:
        joint: Bouc-Wen parameters, scalars, with nu = 1.
        omega: Angular frequency of the tone [rad/s].
        amplitude: Amplitude A of the force [N/kg]; not zero.
        num_harmonics: Number of odd harmonics to report; has no influence on the orbit.
        initial: (y, v, z) to start Newton's iteration from; the linear response if None.
        rtol: Relative tolerance of the time integration.

    Returns:
        The orbit; NaN where the iteration did not converge.

    Raises:
        ModelError: The iteration did not converge, nu is not 1, the restoring force has an
            even part, or an argument is not finite.
        ConfigError: An argument is not positive, or JAX runs in float32.

    Reference:
        Eqs. (1), (2), as printed.
    """
    require_periodic(joint)
    require_finite(joint, omega=omega, amplitude=amplitude)
    require_at_least("omega", omega, 0.0, open_end=True)
    require_at_least("amplitude", amplitude, 0.0, open_end=True)
    require_float64()
    orbit = _shoot(joint, omega, amplitude, initial, num_harmonics, rtol)
    if is_concrete(orbit) and bool(jnp.isnan(orbit.initial).any()):
        raise ModelError(
            f"Shooting did not converge at omega = {omega}, amplitude = {amplitude}.",
            remedy="Give `initial` near the orbit, as from a lower amplitude.",
        )
    return orbit


@partial(jax.jit, static_argnums=(4, 5))
def _shoot(
    joint: BoucWen,
    omega: Scalar,
    amplitude: Scalar,
    initial: tuple[Scalar, Scalar, Scalar] | None,
    num_harmonics: int,
    rtol: float,
) -> PeriodicOrbit:
    joint, omega, amplitude = jax.tree.map(
        lambda x: jnp.asarray(x, float), (joint, omega, amplitude)
    )
    unit, ratio, length = dimensionless(joint, omega, amplitude)
    # y, y' and z/alpha over the length; the derivative is by theta = omega t.
    scale = length * jnp.stack([jnp.ones_like(omega), omega, joint.alpha])
    if initial is None:
        q = 1.0 / (1.0 - ratio**2 + 2j * unit.zeta * ratio)
        start = jnp.stack([q.real, -q.imag, q.real])
    else:
        start = jnp.stack([jnp.asarray(x, float) for x in initial]) / scale

    def mismatch(x: State, problem: tuple[BoucWen, Scalar]) -> State:
        return _half_period(x, problem, 0, rtol)[0] + x

    solution = optimistix.root_find(
        mismatch,
        optimistix.Newton(rtol=_TOLERANCE, atol=_TOLERANCE),
        jax.lax.stop_gradient(start),
        (unit, ratio),
        max_steps=_MAX_NEWTON,
        throw=False,
    )
    converged = solution.result == optimistix.RESULTS.successful
    x = jnp.where(converged, solution.value, jnp.nan)
    _, harmonics = _half_period(solution.value, (unit, ratio), num_harmonics, rtol)
    slope = jax.jacfwd(lambda x: -_half_period(x, (unit, ratio), 0, rtol)[0])(solution.value)
    return PeriodicOrbit(
        initial=x * scale,
        harmonics=jnp.where(converged, length * harmonics, jnp.nan),
        multipliers=jnp.where(converged, jnp.linalg.eigvals(slope), jnp.nan),
    )


def _half_period(
    x: State, problem: tuple[BoucWen, Scalar], num_harmonics: int, rtol: float
) -> tuple[State, Complex[Array, " harmonic"]]:
    """State after half a period, and the harmonics of y as integrals over it."""
    unit, ratio = problem
    unity = jnp.ones_like(ratio)
    law = BoucWen(unity, unity, unity, unit.delta, unit.gamma)
    n = orders(num_harmonics)

    def rate(theta: Any, state: tuple, _: None) -> tuple:
        (y, p, z), _, _ = state
        force = jnp.cos(theta) - (1.0 - unit.alpha) * y - unit.alpha * z
        if unit.restoring is not None:
            force = force - unit.restoring(y)
        curvature = (force - 2.0 * unit.zeta * ratio * p) / ratio**2
        motion = jnp.stack([p, curvature, hysteresis_rate(law, p, z)])
        weight = 2.0 / jnp.pi * y
        return motion, weight * jnp.cos(n * theta), -weight * jnp.sin(n * theta)

    none = jnp.zeros(num_harmonics)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rate),
        diffrax.Dopri8(),
        t0=0.0,
        t1=jnp.pi,
        dt0=None,
        y0=(x, none, none),
        stepsize_controller=diffrax.PIDController(rtol=rtol, atol=rtol * jnp.max(jnp.abs(x))),
        adjoint=diffrax.ForwardMode(),
        max_steps=_MAX_STEPS,
        throw=False,
    )
    final, cosines, sines = (part[-1] for part in solution.ys)  # pyright: ignore
    return final, jax.lax.complex(cosines, sines)
