"""The specimen on its bench: the joint answers an analog force, integrated far finer than sampled.

Nothing here is shared with the solvers of the identification: classical Runge-Kutta steps, sixteen
to a sample, under the force as it is between the samples, not under any hold of the samples. With
the paper's joint the velocity of a sweep is right to 2e-7 of its rms, at most 0.02 um/s in the
laboratory's: 300 times below what 48 averaged repeats of a laser with 50 um/s can resolve.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jbw.errors import ModelError
from jbw.oscillator.parameters import BoucWen

SUBSTEPS = 16
"""Runge-Kutta steps in a sample."""
GRID = 2 * SUBSTEPS
"""Values of the force in a sample: at the ends and in the middle of each step."""
BLOCK = 16_384
"""Samples in one compiled call: bounds the memory of the force, keeps one compilation for all."""

Scalar = Float[Array, ""]
State = tuple[Scalar, Scalar, Scalar]
Force = Callable[[int, int], NDArray[np.float64]]
"""force(i, j): the force [N/kg] at grid points i .. j - 1, GRID points to a sample from t = 0."""


def respond(
    joint: BoucWen, force: Force, num_samples: int, fs: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Response of the joint from rest to an analog force.

    Args:
        joint: Parameters, scalars, nu = 1.
        force: Force per unit mass on the grid of `GRID` points a sample [N/kg].
        num_samples: Samples to return; the first is the state of rest at t = 0.
        fs: Sampling frequency [Hz].

    Returns:
        Displacement [m], velocity [m/s] and hysteretic force z [N/kg], each `(num_samples,)`.

    Raises:
        ModelError: When JAX works in float32, nu is not 1, another force stands beside the joint,
            or the response is not finite.
    """
    _require(joint)
    leaves = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), joint)
    state: State = (jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))
    saved = []
    for first in range(0, num_samples, BLOCK):
        u = force(first * GRID, (first + BLOCK) * GRID + 1)
        state, block = _advance(leaves, state, u, 1.0 / (fs * SUBSTEPS))
        saved.append(np.stack(block))
    y, v, z = np.concatenate(saved, axis=1)[:, :num_samples]
    if not np.isfinite(v).all():
        raise ModelError(
            f"The response of `joint` must stay finite, but it is not from sample "
            f"{int(np.argmin(np.isfinite(v)))} on.",
            remedy="Check the joint's parameters, the gain and the sampling frequency.",
        )
    return y, v, z


@jax.jit
def _advance(
    joint: BoucWen, state: State, u: Float[Array, " grid"], h: float
) -> tuple[State, tuple[Array, Array, Array]]:
    """Runs one block; returns its final state and the states at the start of each sample."""

    def substep(i: Array, carry: tuple[Array, State]) -> tuple[Array, State]:
        start, now = carry
        at = start + 2 * i
        return start, _rk4(joint, now, u[at], u[at + 1], u[at + 2], h)

    def sample(now: State, n: Array) -> tuple[State, State]:
        _, after = lax.fori_loop(0, SUBSTEPS, substep, (GRID * n, now))
        return after, now

    return lax.scan(sample, state, jnp.arange(u.shape[0] // GRID))


def _rk4(joint: BoucWen, now: State, u_0: Array, u_half: Array, u_1: Array, h: float) -> State:
    """One classical Runge-Kutta step of length h [s]."""
    rate = partial(_rate, joint)
    k_1 = rate(now, u_0)
    k_2 = rate(_moved(now, h / 2, k_1), u_half)
    k_3 = rate(_moved(now, h / 2, k_2), u_half)
    k_4 = rate(_moved(now, h, k_3), u_1)
    y, v, z = (
        x + h / 6 * (a + 2 * b + 2 * c + d)
        for x, a, b, c, d in zip(now, k_1, k_2, k_3, k_4, strict=True)
    )
    return y, v, z


def _rate(joint: BoucWen, now: State, u: Array) -> State:
    """Right-hand side of Eqs. (1), (2) at nu = 1."""
    y, v, z = now
    a = u - 2 * joint.zeta * joint.omega_n * v - joint.k * y - z
    return v, a, joint.alpha * v - joint.gamma * abs(v) * z - joint.delta * v * abs(z)


def _moved(now: State, h: float, rate: State) -> State:
    y, v, z = (x + h * slope for x, slope in zip(now, rate, strict=True))
    return y, v, z


def _require(joint: BoucWen) -> None:
    if not jax.config.jax_enable_x64:
        raise ModelError(
            "The rig must be simulated in float64, but JAX works in float32.",
            remedy="Call jbw.enable_x64() before any array is made.",
        )
    if joint.nu != 1.0:
        raise ModelError(f"Parameter `joint.nu` of the rig must be 1, but is {joint.nu}.")
    if joint.restoring is not None:
        raise ModelError(
            "Parameter `joint.restoring` of the rig must be None, but is of kind "
            f"{type(joint.restoring).__name__}.",
            why="The rig integrates the hysteretic force and a linear spring by a code of its own.",
            remedy="Make records with `simulate`, which takes every restoring force.",
        )
