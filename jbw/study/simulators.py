r"""Records as the world makes them, to test likelihoods by: the joint is the rig's, not theirs.

A simulator takes a key, the true parameters and a design, which is reduced data of which only what
the test prescribes is used: inputs, repeats, noise, laws. It returns reduced data of the same form.
The rig has its own code for every law that it knows, so that a factor that a likelihood drops is
not dropped here with it.
"""

from collections.abc import Iterable
from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from jbw.inference.space.problem import Theta
from jbw.observables.records import Records
from jbw.oscillator.oscillator import oscillator_of
from jbw.quantities import DEFAULT_LAWS
from jbw.rig.integrator import Specimen, State, doubles, forces_of, runge_kutta

STEPS = 8  # Runge-Kutta steps between two samples


def measured_records(key: Key[Array, ""], theta: Theta, design: Records) -> Records:
    r"""Repeats of every level with white noise, reduced to mean and scatter.

    $$\bar v = v + \sigma\,\eta / \sqrt K, \qquad S \sim \sigma^2 \chi^2_{N (K - 1)}$$
    """
    key_mean, key_within = jax.random.split(key)
    count, size = design.repeats.num_repeats, design.source.shape[-1]
    noise_std = design.repeats.noise_std
    column = ("displacement", "velocity").index(design.response)
    force = theta["gain"] * design.source
    clean = jax.vmap(lambda u: motion(theta, u, design.fs, design.laws)[:, column])(force)
    error = jax.random.normal(key_mean, clean.shape)
    mean = clean + (noise_std / jnp.sqrt(count))[:, None] * error
    within = noise_std**2 * 2 * jax.random.gamma(key_within, size * (count - 1) / 2)
    scatter = jnp.sqrt(within / (size * (count - 1)))
    return replace(design, mean=mean).with_repeats(within=within, noise_std=scatter)


def motion(
    theta: Theta,
    force: Float[Array, " time"],
    fs: float,
    laws: Iterable[str] = DEFAULT_LAWS,
) -> Float[Array, "time 2"]:
    """Displacement and velocity under a force [N/kg] from rest, by classical Runge-Kutta steps.

    The force between the samples is what their spectrum stands for; at rest at both ends.

    Raises:
        ModelError: For a law that the rig does not know.

    Reference:
        Eqs. (1), (2) with nu = 1, for Bouc-Wen's law.
    """
    joint = oscillator_of(theta, laws)
    specimen = Specimen(joint.omega_n, joint.zeta, forces_of(joint.laws, jnp.asarray))
    h, size = 1 / (fs * STEPS), force.shape[-1]
    # The spectrum filled up with zeros gives the input at both ends and middles of the steps.
    fine = jnp.fft.irfft(jnp.fft.rfft(force), 2 * STEPS * size) * 2 * STEPS
    ends = jnp.concatenate([fine, fine[:1]])
    at = jnp.stack([ends[:-1:2], ends[1::2], ends[2::2]], axis=-1).reshape(size, STEPS, 3)

    def step(state: State, u: Float[Array, "3"]) -> tuple[State, None]:
        inputs = (u[0], u[1], u[2])
        return runge_kutta(specimen.state_rate, specimen.settle, state, inputs, h), None

    def sample(state: State, u: Float[Array, "step 3"]) -> tuple[State, Float[Array, "2"]]:
        return jax.lax.scan(step, state, u)[0], jnp.stack(state[:2])

    start = doubles((0.0, 0.0, specimen.at_rest()))
    return jax.lax.scan(sample, start, at)[1]
