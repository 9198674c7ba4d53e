r"""The periodic response of the joint to a tone, by harmonic balance."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, overload

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Complex, Float, Inexact, Int, Real

from jbw.oscillator.checks import (
    is_concrete,
    require_converged,
    require_periodic,
    require_sense,
)
from jbw.oscillator.modes.balance import StructureHarmonics
from jbw.oscillator.modes.structure import Structure
from jbw.oscillator.oscillator import Joint, Oscillator, as_oscillator
from jbw.oscillator.parameters import batched
from jbw.oscillator.steady.balance import dimensionless, linear_response, tone_from
from jbw.oscillator.steady.modal import modal_tones
from jbw.oscillator.steady.waveform import synthesis

# Numbers of turning points per period that are tried if two do not suffice.
MANY_TURNS = 10


class SteadyCycle(NamedTuple):
    """One period of the steady motion.

    Attributes:
        theta: Phase omega t [rad].
        y: Displacement [m].
        v: Velocity [m/s].
        a: Acceleration [m/s^2].
        z: Force of all laws with a memory, the hysteretic ones [N/kg].
    """

    theta: Float[Array, " time"]
    y: Float[Array, "... time"]
    v: Float[Array, "... time"]
    a: Float[Array, "... time"]
    z: Float[Array, "... time"]


@overload
def steady_state(
    joint: Structure, omega: ArrayLike, amplitude: ArrayLike, num_harmonics: int = 8, **options: Any
) -> StructureHarmonics: ...
@overload
def steady_state(
    joint: Joint, omega: ArrayLike, amplitude: ArrayLike, num_harmonics: int = 8, **options: Any
) -> Complex[Array, "... harmonic"]: ...
def steady_state(  # pyright: ignore[reportInconsistentOverload]
    joint: Joint | Structure,
    omega: Real[ArrayLike, "..."],
    amplitude: Real[ArrayLike, "..."],
    num_harmonics: int = 8,
    *,
    max_turns: int = 2,
) -> Complex[Array, "... harmonic"] | StructureHarmonics:
    r"""Return odd harmonics Y_1, Y_3, Y_5, ... of the periodic response to u = A cos(omega t).

    $$(k - n^2\omega^2 + 2j\zeta\omega_n n\omega)\,Y_n + \sum F_n(Y) = A\,\delta_{n1}, \qquad
      y = \mathrm{Re}\sum_n Y_n e^{jn\omega t}$$

    The even harmonics vanish because the joint is odd. Bouc-Wen's z is exact between its turning
    points, and its periodicity is solved for. The relative errors of (Y_1, Y_3) from the omitted
    harmonics are 8e-6 and 3e-4 with 2 harmonics, 1e-6 and 3e-6 with 4, 4e-8 and 6e-8 with 8, for
    the joint of Teloli et al. between 5 and 19 Hz.

    Newton's iteration starts from the fully stuck joint; where it fails, the load is raised in
    steps. Where several periodic responses exist (a joint that softens faster than it dissipates)
    one of them is returned; `response_curve` follows them all. Derivatives by every parameter,
    `omega` and `amplitude` are implicit, under jit, vmap, grad and jvp. For a `Structure` the
    unknowns are those of the joint's displacement alone, whatever the number of modes.

    Args:
        joint: A `BoucWen` with nu = 1, an `Oscillator` with any laws, or a `Structure`.
        omega: Angular frequency of the tone [rad/s].
        amplitude: Amplitude A of the force [N/kg].
        num_harmonics: Number of odd harmonics.
        max_turns: Turning points of y allowed in a period, even. An eager call that meets more
            than 2 tries again with 10; under `jit` the result is NaN beyond `max_turns`.

    Returns:
        Complex peak amplitudes of orders 1, 3, ..., 2 num_harmonics - 1 [m], along a new last axis
        behind the broadcast shape of `joint`, `omega` and `amplitude`; NaN where the iteration did
        not converge. For a `Structure`, the harmonics of joint, modes and outputs.

    Raises:
        ModelError: Some response did not converge, nu is not 1, or an argument is not finite.
        ConfigError: An argument is out of its range, or JAX runs in float32.

    Reference:
        In place of Eqs. (19)-(31), which hold for weak nonlinearity.

    Examples:
        The amplitude of a linear oscillator at resonance is A / (2 zeta omega_n^2):

        >>> import jbw; jbw.enable_x64()
        >>> linear = jbw.Oscillator(omega_n=100.0, zeta=0.01)
        >>> y = jbw.steady_state(linear, omega=100.0, amplitude=1.0)
        >>> print(f"{1e3 * abs(y[0]):.3f} mm")
        5.000 mm
    """
    if isinstance(joint, Structure):
        return modal_tones(joint, omega, amplitude, num_harmonics, max_turns, swept=False)
    require_sense(joint, omega, amplitude, num_harmonics, max_turns)
    solve = partial(_steady, as_oscillator(joint), omega, amplitude, num_harmonics)
    return converged(solve, joint, omega, amplitude, max_turns)


def converged(
    solve: Callable[[int], tuple[Array, Array]],
    joint: Joint,
    omega: ArrayLike,
    amplitude: ArrayLike,
    max_turns: int,
) -> Complex[Array, "... harmonic"]:
    """Return the harmonics from `solve`; retry with more turning points, then raise an error."""
    harmonics, turns = solve(max_turns)
    if not is_concrete(joint, omega, amplitude, harmonics):
        return harmonics
    if max_turns == 2 and np.any(np.asarray(turns) > 2):
        harmonics, turns = solve(MANY_TURNS)
    require_converged(joint, omega, amplitude, harmonics, turns)
    return harmonics


def steady_cycle(
    joint: Joint,
    harmonics: Inexact[ArrayLike, "... harmonic"],
    omega: Real[ArrayLike, "..."],
    num_points: int = 256,
    *,
    max_turns: int = 2,
) -> SteadyCycle:
    r"""Return one period of the motion with given harmonics, with its hysteretic force.

    $$y = \mathrm{Re}\sum_n Y_n e^{jn\theta}, \quad v = \omega\,y', \quad a = \omega^2 y''$$

    z is the exact steady force along y, closed over the period.

    Args:
        joint: A `BoucWen` with nu = 1, or an `Oscillator` with any laws.
        harmonics: Complex peak amplitudes of orders 1, 3, 5, ... [m], as of `steady_state`.
        omega: Angular frequency of the tone [rad/s].
        num_points: Number of equally spaced phases.
        max_turns: Largest number of turning points of y in a period.

    Returns:
        The cycle, from theta = 0; batch axes lie before time.

    Raises:
        ModelError: nu is not 1, or a spring has an even part.

    Examples:
        A linear oscillator far below resonance follows the force, y = A / omega_n^2:

        >>> import jbw; jbw.enable_x64()
        >>> linear = jbw.Oscillator(omega_n=100.0, zeta=0.01)
        >>> y = jbw.steady_state(linear, omega=1.0, amplitude=2.0)
        >>> cycle = jbw.steady_cycle(linear, y, omega=1.0)
        >>> print(f"{1e3 * cycle.y.max():.3f} mm, {1e3 * cycle.v.max():.3f} mm/s")
        0.200 mm, 0.200 mm/s
    """
    joint = as_oscillator(joint)
    require_periodic(joint)
    theta = 2.0 * jnp.pi * jnp.arange(num_points) / num_points
    harmonics = jnp.asarray(harmonics, complex)

    def cycle(joint: Oscillator, omega: Array, *parts: Array) -> tuple[Array, ...]:
        q = jax.lax.complex(jnp.stack(parts[::2]), jnp.stack(parts[1::2]))
        motion = (omega**m * synthesis(q, theta, m) for m in range(3))
        z = jnp.zeros_like(theta)
        for law in joint.laws:
            if law.remembers:
                z = z + law.force_over_period(q, theta, max_turns, omega)
        return (*motion, z)

    orders_apart = [part for q in jnp.moveaxis(harmonics, -1, 0) for part in (q.real, q.imag)]
    return SteadyCycle(theta, *batched(cycle, joint, omega, *orders_apart))


@partial(jax.jit, static_argnums=(3, 4))
def _steady(
    joint: Oscillator, omega: ArrayLike, amplitude: ArrayLike, num_harmonics: int, max_turns: int
) -> tuple[Complex[Array, "... harmonic"], Int[Array, "..."]]:
    """Return harmonics and turning points of a batch; NaN where invalid."""

    def tone(joint: Oscillator, omega: Array, amplitude: Array) -> tuple[Array, Array]:
        unit, ratio, length = dimensionless(joint, omega, amplitude)
        start = linear_response(unit, ratio, num_harmonics)
        return tone_from(start, unit, ratio, length, max_turns)[1]

    return batched(tone, joint, omega, amplitude)
