r"""Data as the world makes them, to test likelihoods by: nothing here is shared with them.

A simulator takes a key, the true parameters and a design, which is reduced data of which only what
the test prescribes is used: frequencies, inputs, repeats, noise. It returns reduced data of the
same form. Formulas stand here a second time on purpose: a factor that a likelihood drops is not
dropped here with it.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float, Key

from jbw.identification.paper.kernel import KernelData
from jbw.observables.records import Records
from jbw.rig.integrator import runge_kutta

UNKNOWN = 4.0
STEPS = 8  # Runge-Kutta steps between two samples
Theta = Mapping[str, Array]
State = Float[Array, "3"]


def measured_kernel(
    key: Key[Array, ""],
    theta: Theta,
    design: KernelData,
    num_repeats: int,
    *,
    known_noise: bool = False,
) -> KernelData:
    r"""Repeats of the third-order kernel, noise in real and imaginary part, reduced as in Step 3.

    As in a campaign nobody is told the noise. It is drawn for every frequency, uniformly in its
    logarithm over a factor `UNKNOWN` to either side of the design's: that is the prior 1/sigma of a
    likelihood that integrates it out, but for its two ends. What least squares weigh by is

    $$\hat\sigma_i^2 = \frac{1}{2(K - 1)} \sum_k |H_{ik} - \bar H_i|^2$$

    With `known_noise` it is the design's and the likelihood is told, as (36) supposes.
    """
    noise_std = design.noise_std
    if not known_noise:
        key, key_size = jax.random.split(key)
        spread = jax.random.uniform(key_size, (design.omega.size,), minval=-1.0)
        noise_std = noise_std * UNKNOWN**spread
    noise = jax.random.normal(key, (2, num_repeats, design.omega.size)) * noise_std
    repeats = kernel_values(theta, design) + noise[0] + 1j * noise[1]
    mean = jnp.mean(repeats, axis=0)
    within = jnp.sum(jnp.abs(repeats - mean) ** 2, axis=0)
    scatter = jnp.sqrt(within / (2 * (num_repeats - 1)))
    return replace(
        design, mean=mean, within=within, noise_std=noise_std if known_noise else scatter
    )


def kernel_values(theta: Theta, design: KernelData) -> Complex[Array, " freq"]:
    r"""The paper's third-order kernel, written out.

    $$H_3(\omega) = \frac{-\alpha\,(\delta^2/6 - 35\,\delta/(96 Y))}
      {(\omega_n^2 - \omega^2 + 2j\zeta\omega_n\omega)^3\,
       (\omega_n^2 - 9\omega^2 + 6j\zeta\omega_n\omega)}$$

    Returns:
        Kernel [m^-2 s^6].

    Reference:
        Eqs. (23), (25), (31).
    """
    zeta, alpha, delta = (theta[name] for name in ("zeta", "alpha", "delta"))
    omega, omega_n = design.omega, design.omega_n
    first = omega_n**2 - omega**2 + 2j * zeta * omega_n * omega
    third = omega_n**2 - 9 * omega**2 + 6j * zeta * omega_n * omega
    cubic = alpha * delta**2 / 6 - 35 * alpha * delta / (96 * design.y_peak)
    return -cubic / (first**3 * third)


def measured_records(key: Key[Array, ""], theta: Theta, design: Records) -> Records:
    r"""Repeats of every level with white noise, reduced to mean and scatter.

    $$\bar v = v + \sigma\,\eta / \sqrt K, \qquad S \sim \sigma^2 \chi^2_{N (K - 1)}$$
    """
    key_mean, key_within = jax.random.split(key)
    count, size = design.repeats.num_repeats, design.source.shape[-1]
    noise_std = design.repeats.noise_std
    column = ("displacement", "velocity").index(design.response)
    force = theta["gain"] * design.source
    clean = jax.vmap(lambda u: motion(theta, u, design.fs)[:, column])(force)
    error = jax.random.normal(key_mean, clean.shape)
    mean = clean + (noise_std / jnp.sqrt(count))[:, None] * error
    within = noise_std**2 * 2 * jax.random.gamma(key_within, size * (count - 1) / 2)
    scatter = jnp.sqrt(within / (size * (count - 1)))
    return replace(design, mean=mean).with_repeats(within=within, noise_std=scatter)


def motion(theta: Theta, force: Float[Array, " time"], fs: float) -> Float[Array, "time 3"]:
    r"""Displacement, velocity and hysteretic force from rest, by classical Runge-Kutta steps.

    The input between the samples is what their spectrum stands for.

    $$\ddot y + 2\zeta\omega_n\dot y + (\omega_n^2 - \alpha)\,y + Z = u, \qquad
    \dot Z = \alpha\dot y - \gamma|\dot y|Z - \delta\dot y|Z|$$

    Args:
        theta: omega_n, zeta, alpha, delta, gamma.
        force: Force per unit mass at the samples, at rest at both ends [N/kg].
        fs: Sampling frequency [Hz].

    Reference:
        Eqs. (1), (2) with nu = 1.
    """
    h, size = 1 / (fs * STEPS), force.shape[-1]
    # The spectrum filled up with zeros gives the input at both ends and middles of the steps.
    fine = jnp.fft.irfft(jnp.fft.rfft(force), 2 * STEPS * size) * 2 * STEPS
    ends = jnp.concatenate([fine, fine[:1]])
    at = jnp.stack([ends[:-1:2], ends[1::2], ends[2::2]], axis=-1).reshape(size, STEPS, 3)

    def rate(state: State, u: Array) -> State:
        y, v, z = state
        spring = (theta["omega_n"] ** 2 - theta["alpha"]) * y
        a = u - 2 * theta["zeta"] * theta["omega_n"] * v - spring - z
        slip = theta["gamma"] * jnp.abs(v) * z + theta["delta"] * v * jnp.abs(z)
        return jnp.stack([v, a, theta["alpha"] * v - slip])

    def step(state: State, u: Float[Array, "3"]) -> tuple[State, None]:
        return runge_kutta(rate, lambda _, after: after, state, (u[0], u[1], u[2]), h), None

    def sample(state: State, u: Float[Array, "step 3"]) -> tuple[State, State]:
        return jax.lax.scan(step, state, u)[0], state

    start: Any = jnp.zeros(3)
    return jax.lax.scan(sample, start, at)[1]
