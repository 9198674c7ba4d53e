"""The equivalent system, where a switched polynomial replaces the hysteresis, Eqs. (14), (15)."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Literal, get_args

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Complex, Float, Real

from jbw.errors import ConfigError
from jbw.oscillator.checks import require_at_least, require_finite
from jbw.oscillator.oscillator import BoucWen
from jbw.oscillator.parameters import Scalar
from jbw.paper.coefficients import Smoothing, smoothed_force, switch

Variant = Literal["corrected", "printed"]


def square_wave(
    lambda_0: Scalar,
    theta: Real[ArrayLike, "..."],
    variant: Variant = "corrected",
    num_terms: int = 2,
) -> Float[Array, "..."]:
    r"""Return the Fourier series of the force u_0 = lambda_0 sgn(v), for y = Y cos(theta).

    $$u_0 = -\frac{4\lambda_0}{\pi} \sum_{m = 1, 3, \dots} \frac{\sin m\theta}{m}$$

    Two terms contain 90.1 % of the square wave's power. The printed series has the opposite sign,
    and so has the lambda_0 of Eq. (10): the two printed signs cancel. theta is the phase of y; the
    paper's phase of u is the same only below resonance.

    Args:
        lambda_0: Force at y = 0 [N/kg].
        theta: Phase of the displacement [rad].
        variant: Sign of the series: "corrected" as above, or "printed".
        num_terms: Number of odd harmonics kept.

    Returns:
        Force u_0, on the side of the restoring forces [N/kg].

    Raises:
        ConfigError: The variant is unknown or `num_terms` is below 1.

    Reference:
        Eq. (15), corrected: the opposite sign, theta the phase of y, printed that of u.
    """
    require_variant(variant)
    require_at_least("num_terms", num_terms, 1)
    sign = -1.0 if variant == "corrected" else 1.0
    m = 2.0 * jnp.arange(num_terms) + 1.0
    series = jnp.sum(jnp.sin(m * jnp.asarray(theta)[..., None]) / m, axis=-1)
    return sign * 4.0 / jnp.pi * jnp.asarray(lambda_0) * series


def require_variant(variant: str) -> None:
    """Raise an error unless the variant is "corrected" or "printed"."""
    if variant not in get_args(Variant):
        raise ConfigError(
            f'Argument `variant` must be "corrected" or "printed", but it is "{variant}".'
        )


def smoothed_harmonics(
    smoothing: Smoothing, y_peak: Real[ArrayLike, "..."]
) -> tuple[Complex[Array, "..."], Complex[Array, "..."]]:
    r"""Return the first and third harmonics of the smoothed force for y = Y cos(theta).

    $$Z_1 = \lambda_1 Y + \tfrac34 \lambda_3 Y^3
      + \frac{4j}{\pi}\left(\lambda_0 - \tfrac13 \lambda_2 Y^2\right)$$
    $$Z_3 = \tfrac14 \lambda_3 Y^3
      + \frac{4j}{3\pi}\left(\lambda_0 - \tfrac75 \lambda_2 Y^2\right)$$

    Args:
        smoothing: Coefficients of the smoothed force.
        y_peak: Amplitude Y [m].

    Returns:
        Peak complex amplitudes Z_1 and Z_3 [N/kg].

    Reference:
        Eq. (14), corrected: its switched terms in steady motion, by the sign of dy/dt.
    """
    y = jnp.asarray(y_peak)
    cubic, opening = smoothing.lambda_3 * y**3, smoothing.lambda_2 * y**2
    sine_1 = 4.0 / jnp.pi * (smoothing.lambda_0 - opening / 3.0)
    sine_3 = 4.0 / (3.0 * jnp.pi) * (smoothing.lambda_0 - 7.0 / 5.0 * opening)
    first = smoothing.lambda_1 * y + 0.75 * cubic + 1j * sine_1
    return jnp.asarray(first), jnp.asarray(0.25 * cubic + 1j * sine_3)


def equivalent_force(
    smoothing: Smoothing,
    y: Real[ArrayLike, "..."],
    v: Real[ArrayLike, "..."],
    u_0: Real[ArrayLike, "..."] | None = None,
    *,
    width: Scalar = 0.0,
) -> Float[Array, "..."]:
    r"""Return the smoothed hysteretic force; `u_0` may replace its part lambda_0 sgn(v).

    $$Z = \lambda_1 y + \rho\,y^2 + \lambda_3 y^3 + u_0, \qquad \rho = -\lambda_2\,\mathrm{sgn}(v)$$

    Args:
        smoothing: Coefficients of the smoothed force.
        y: Displacement [m].
        v: Velocity [m/s], or another signal whose sign switches the branches.
        u_0: Switched force [N/kg]; lambda_0 sgn(v) when None.
        width: Width of the switching, as in `smoothed_force`; 0 for a jump.

    Returns:
        Force [N/kg].

    Reference:
        Eq. (14), corrected: rho switches with the sign of dy/dt, printed du/dt.
    """
    force = smoothed_force(smoothing, y, v, width=width)
    return force if u_0 is None else force - smoothing.lambda_0 * switch(v, width) + u_0  # pyright: ignore[reportReturnType]


def equivalent_acceleration(
    joint: BoucWen,
    smoothing: Smoothing,
    y: Real[ArrayLike, "..."],
    v: Real[ArrayLike, "..."],
    u: Real[ArrayLike, "..."],
    u_0: Real[ArrayLike, "..."] | None = None,
    *,
    direction: Real[ArrayLike, "..."] | None = None,
    width: Scalar = 0.0,
) -> Float[Array, "..."]:
    r"""Return the acceleration of the equivalent system, in which a polynomial replaces hysteresis.

    $$\ddot y = u - 2\zeta\omega_n\dot y - (k+\lambda_1)\,y - \rho\,y^2 - \lambda_3 y^3 - u_0$$

    minus the restoring force f(y) of the joint, where it has one.

    Args:
        joint: Bouc-Wen parameters; k, zeta, omega_n and `restoring` are used.
        smoothing: Coefficients of the smoothed force.
        y: Displacement [m].
        v: Velocity [m/s].
        u: Input [N/kg].
        u_0: Switched force [N/kg]; lambda_0 sgn(v) when None.
        direction: Signal whose sign switches the branches; v when None, du/dt as printed.
        width: Width of the switching, as in `smoothed_force`; 0 for a jump.

    Returns:
        Acceleration [m/s^2].

    Reference:
        Eq. (14), corrected: the branches switch with the sign of dy/dt, printed du/dt.
    """
    y, v, u = jnp.asarray(y), jnp.asarray(v), jnp.asarray(u)
    viscous = 2.0 * joint.zeta * joint.omega_n * v
    direction = v if direction is None else direction
    a = u - viscous - joint.k * y - equivalent_force(smoothing, y, direction, u_0, width=width)
    return a if joint.restoring is None else a - joint.restoring(y)


InputFunction = Callable[[Float[Array, ""]], Float[Array, ""]]


class Switching(eqx.Module):
    """The rule by which the branches of the equivalent system switch.

    Attributes:
        variant: "corrected" for the sign of dy/dt, "printed" for that of du/dt.
        width: Width of the switching [m/s; N/(kg s) when printed]; 0 for a jump.
        u_0: Switched force as a function of time [N/kg]; lambda_0 sgn(v) when None.
    """

    variant: Variant = eqx.field(default="corrected", static=True)
    width: Scalar = 0.0
    u_0: InputFunction | None = None

    def __check_init__(self) -> None:
        """Raise an error if the variant or the width is invalid."""
        require_variant(self.variant)
        require_at_least("width", self.width, 0.0)


class EquivalentResponse(eqx.Module):
    """The response of the equivalent system at the sampling instants.

    Attributes:
        t: Time [s].
        y: Displacement [m].
        v: Velocity [m/s].
        z: Smoothed hysteretic force, u_0 included [N/kg].
        a: Acceleration [m/s^2].
    """

    t: Float[Array, " time"]
    y: Float[Array, " time"]
    v: Float[Array, " time"]
    z: Float[Array, " time"]
    a: Float[Array, " time"]


def simulate_equivalent(
    joint: BoucWen,
    smoothing: Smoothing,
    u: Float[ArrayLike, "..."] | InputFunction,
    fs: float,
    *,
    initial: tuple[Scalar, Scalar] = (0.0, 0.0),
    substeps: int = 4,
    num_samples: int | None = None,
    adjoint: diffrax.AbstractAdjoint | None = None,
    **switching: Any,
) -> EquivalentResponse:
    """Integrate the equivalent system in time, where a switching polynomial replaces hysteresis.

    The method is Tsit5 with a fixed step of 1/(substeps fs); a sampled input is linear between its
    samples. The force jumps at every turning point, by 2 (lambda_0 - lambda_2 y^2). That is little
    near the peak Y of the fit and more elsewhere, where the error decreases only with the first
    power of the step.

    Args:
        joint: Bouc-Wen parameters; k, zeta, omega_n and `restoring` are used.
        smoothing: Scalar coefficients of the smoothed force.
        u: Samples of the input [N/kg], or a function of time [s].
        fs: Sampling frequency [Hz].
        initial: Displacement [m] and velocity [m/s] at t = 0.
        substeps: Steps per sample.
        num_samples: Number of output samples; required for a function, otherwise that of the input.
        adjoint: Method by which diffrax differentiates; for forward mode pass
            `diffrax.ForwardMode()`.
        **switching: Rule by which the branches switch. `variant`: "corrected" (the default) with
            the sign of dy/dt, "printed" with that of du/dt, which dissipates nothing at resonance
            and adds energy above it. `width`: width of the switching, as in `smoothed_force` [m/s;
            N/(kg s) when printed]; 0 (the default) for a jump. `u_0`: the switched force as a
            function of time [N/kg], such as `square_wave`; lambda_0 sgn(v) when None.

    Returns:
        Response at t = n/fs; sample 0 is `initial`.

    Raises:
        ModelError: A concrete argument is not finite.
        ConfigError: An argument is out of range, or `num_samples` is missing or not that of `u`.

    Reference:
        Eq. (14), corrected: the branches switch with the sign of dy/dt; printed by
        variant="printed".
    """
    branches = Switching(**switching)
    require_at_least("fs", fs, 0.0, open_end=True)
    require_at_least("substeps", substeps, 1)
    require_finite(joint, fs=fs, y=initial[0], v=initial[1])
    if callable(u):
        if num_samples is None:
            raise ConfigError("Argument `num_samples` must be given when `u` is a function.")
    else:
        require_finite(joint, u=u)
        u = jnp.asarray(u, float)
        num_samples = _length(u, num_samples)
    require_at_least("num_samples", num_samples, 2)
    adjoint = diffrax.RecursiveCheckpointAdjoint() if adjoint is None else adjoint
    # Numbers are put in arrays, which JAX traces, so that other values need no new compilation.
    joint, smoothing, rate, state, width = jax.tree.map(
        lambda x: jnp.asarray(x, float), (joint, smoothing, substeps * fs, initial, branches.width)
    )
    drive = _Drive(u, replace(branches, width=width), substeps, rate)
    return _simulate(joint, smoothing, drive, state, num_samples, adjoint)


def _length(u: Array, num_samples: int | None) -> int:
    """Return the number of samples of a sampled input; raise an error if it is invalid."""
    if u.ndim != 1:
        raise ConfigError(
            f"Argument `u` must have one axis, time, but its shape is {u.shape}.",
            remedy="Use `jax.vmap` for several inputs.",
        )
    if num_samples not in (None, u.size):
        raise ConfigError(
            f"Argument `num_samples` must equal the {u.size} samples of `u`, but it is "
            f"{num_samples}."
        )
    return u.size


class _Drive(eqx.Module):
    """The input, the switched force and the switching rule, as functions of the step's number.

    The number is whole, so that no rounding accumulates over a long record.
    """

    u: Array | InputFunction
    switching: Switching
    substeps: int = eqx.field(static=True)
    rate: Array  # number of steps per second [1/s]

    def force(self, step: Array) -> Array:
        """Return the input at a step [N/kg]."""
        if callable(self.u):
            return self.u(step / self.rate)
        return _interpolate(self.u, step / self.substeps)

    def switched(self, step: Array) -> Array | None:
        """Return the force that switches with the sign of v [N/kg], if it was supplied, or None."""
        u_0 = self.switching.u_0
        return None if u_0 is None else u_0(step / self.rate)

    def direction(self, step: Array, v: Array) -> Array:
        """Return the signal that selects the branch: v, or the input's rate (printed variant)."""
        if self.switching.variant == "corrected":
            return v
        _, slope = jax.jvp(self.force, (step,), (jnp.ones_like(step),))
        return slope * self.rate


@eqx.filter_jit
def _simulate(
    joint: BoucWen,
    smoothing: Smoothing,
    drive: _Drive,
    initial: tuple[Array, Array],
    num_samples: int,
    adjoint: diffrax.AbstractAdjoint,
) -> EquivalentResponse:
    acceleration = partial(equivalent_acceleration, joint, smoothing, width=drive.switching.width)

    def field(step: Any, state: tuple[Array, Array], _: Any) -> tuple[Array, Array]:
        y, v = state
        direction = drive.direction(step, v)
        a = acceleration(y, v, drive.force(step), drive.switched(step), direction=direction)
        return v / drive.rate, a / drive.rate

    num_steps = (num_samples - 1) * drive.substeps
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        diffrax.Tsit5(),
        t0=0.0,
        t1=float(num_steps),
        dt0=1.0,
        y0=initial,
        saveat=diffrax.SaveAt(t0=True, steps=True),
        max_steps=num_steps,
        adjoint=adjoint,
        throw=False,
    )
    y, v = jax.tree.map(lambda x: x[:: drive.substeps], solution.ys)
    step = jnp.arange(num_samples, dtype=y.dtype) * drive.substeps
    held = None if drive.switching.u_0 is None else jax.vmap(drive.switched)(step)
    direction = jax.vmap(drive.direction)(step, v)
    a = acceleration(y, v, jax.vmap(drive.force)(step), held, direction=direction)
    z = equivalent_force(smoothing, y, direction, held, width=drive.switching.width)
    return EquivalentResponse(t=step / drive.rate, y=y, v=v, z=z, a=a)


def _interpolate(u: Array, position: Array) -> Array:
    """Interpolate samples linearly by index arithmetic, which is faster than a search."""
    index = jnp.clip(jnp.floor(position).astype(int), 0, u.size - 2)
    return u[index] + (position - index) * (u[index + 1] - u[index])
