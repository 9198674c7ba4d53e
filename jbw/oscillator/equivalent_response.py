"""Time response of the equivalent system, through diffrax."""

from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from jbw.errors import ConfigError
from jbw.oscillator.checks import require_at_least, require_finite
from jbw.oscillator.equivalent import equivalent_acceleration, equivalent_force
from jbw.oscillator.parameters import BoucWen, Scalar
from jbw.oscillator.smoothing import Smoothing

InputFunction = Callable[[Float[Array, ""]], Float[Array, ""]]


class EquivalentResponse(eqx.Module):
    """Response of the equivalent system at the sampling instants.

    Attributes:
        t: Time [s].
        y: Displacement [m].
        v: Velocity [m/s].
        z: Smoothed hysteretic force, u_0 included [N/kg].
        a: Acceleration [m/s^2].
    """

    t: Float[Array, "time"]
    y: Float[Array, "time"]
    v: Float[Array, "time"]
    z: Float[Array, "time"]
    a: Float[Array, "time"]


def simulate_equivalent(
    joint: BoucWen,
    smoothing: Smoothing,
    u: Float[ArrayLike, "time"] | InputFunction,
    fs: float,
    *,
    u_0: InputFunction | None = None,
    initial: tuple[Scalar, Scalar] = (0.0, 0.0),
    substeps: int = 4,
    num_samples: int | None = None,
    adjoint: diffrax.AbstractAdjoint | None = None,
) -> EquivalentResponse:
    """Time response of the equivalent system.

    Tsit5 with a fixed step of 1/(substeps fs); a sampled input is linear between its samples. The
    force jumps at every turning point, by 2 (lambda_0 - lambda_2 y^2): little near the peak Y of
    the fit, more elsewhere, and there the error falls with the first power of the step only.

    Args:
        joint: Bouc-Wen parameters; k, zeta, omega_n and `restoring` are used.
        smoothing: Scalar coefficients of the smoothed force.
        u: Samples of the input [N/kg], or a function of time [s].
        fs: Sampling frequency [Hz].
        u_0: Switched force as a function of time [N/kg], say that of `square_wave`; lambda_0 sgn(v)
            when None.
        initial: Displacement [m] and velocity [m/s] at t = 0.
        substeps: Steps per sample.
        num_samples: Number of samples out; needed with a function, and the input's own otherwise.
        adjoint: How diffrax differentiates; for forward mode pass `diffrax.ForwardMode()`.

    Returns:
        Response at t = n/fs, sample 0 being `initial`.

    Raises:
        ModelError: A concrete argument is not finite.
        ConfigError: An argument is out of range, or `num_samples` is missing or not that of `u`.

    Reference:
        Eq. (14).
    """
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
    # As arrays the numbers are traced: other values do not compile again.
    joint, smoothing, rate, state = jax.tree.map(
        lambda x: jnp.asarray(x, float), (joint, smoothing, fs, initial)
    )
    return _simulate(joint, smoothing, rate, state, u, u_0, substeps, num_samples, adjoint)


def _length(u: Array, num_samples: int | None) -> int:
    """Number of samples of a sampled input."""
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


@eqx.filter_jit
def _simulate(
    joint: BoucWen,
    smoothing: Smoothing,
    fs: Array,
    initial: tuple[Array, Array],
    u: Array | InputFunction,
    u_0: InputFunction | None,
    substeps: int,
    num_samples: int,
    adjoint: diffrax.AbstractAdjoint,
) -> EquivalentResponse:
    # Time counts steps: it stays a whole number, so no rounding piles up over a long record.
    rate = substeps * fs

    def force(step: Array) -> Array:
        return u(step / rate) if callable(u) else _interpolate(u, step / substeps)

    def switched(step: Array) -> Array | None:
        return None if u_0 is None else u_0(step / rate)

    def field(step: Any, state: tuple[Array, Array], _: Any) -> tuple[Array, Array]:
        y, v = state
        a = equivalent_acceleration(joint, smoothing, y, v, force(step), switched(step))
        return v / rate, a / rate

    num_steps = (num_samples - 1) * substeps
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
    y, v = jax.tree.map(lambda x: x[::substeps], solution.ys)
    step = jnp.arange(num_samples, dtype=y.dtype) * substeps
    held = None if u_0 is None else jax.vmap(u_0)(step / rate)
    a = equivalent_acceleration(joint, smoothing, y, v, jax.vmap(force)(step), held)
    z = equivalent_force(smoothing, y, v, held)
    return EquivalentResponse(t=step / rate, y=y, v=v, z=z, a=a)


def _interpolate(u: Array, position: Array) -> Array:
    """Linear interpolation of samples by index arithmetic, many times faster than a search."""
    index = jnp.clip(jnp.floor(position).astype(int), 0, u.size - 2)
    return u[index] + (position - index) * (u[index + 1] - u[index])
