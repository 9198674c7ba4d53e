"""Prediction of free decays: the one decay that every record of a joint enters somewhere."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from jbw.observables.decay import LETTER, Decays
from jbw.observables.joint import joint_of
from jbw.oscillator.hysteresis import steady_loop
from jbw.oscillator.response import simulate


def decay_of(theta: Mapping[str, Array], data: Decays) -> Complex[Array, " step"]:
    r"""Logarithm of the envelope of the joint's free decay, through the band's filter.

    Begun at rest at its greatest displacement, with z on the steady loop of that amplitude.

    Args:
        theta: As `joint_of`.
        data: The reduced decays.

    Returns:
        log |X| + j arg X at steps of `step_s`, the phase without jumps.

    Reference:
        Eqs. (1), (2) with u = 0.
    """
    joint = joint_of(theta)
    z = steady_loop(joint, data.y_start).z_max
    free = simulate(
        joint,
        jnp.zeros(data.num_samples),
        data.fs,
        hold="zero",
        initial=(data.y_start, jnp.zeros(()), z),
        substeps=data.substeps,
    )
    kernel = jnp.stack([data.taps.real, data.taps.imag])[:, None, :]
    x = getattr(free, LETTER[data.response])[None, None, :]
    parts = jax.lax.conv_general_dilated(x, kernel, (data.stride,), "VALID")[0]
    envelope = jax.lax.complex(parts[0], parts[1])
    turns = jnp.angle(envelope[1:] * jnp.conj(envelope[:-1]) * data.rotation)
    phase = jnp.concatenate([jnp.zeros(1), jnp.cumsum(turns)])
    return jax.lax.complex(jnp.log(jnp.abs(envelope)), phase)


def along(
    decay: Complex[Array, " step"], place: Float[Array, " time"]
) -> tuple[Complex[Array, " time"], Complex[Array, " time"]]:
    """The decay and its slope between its steps, by cubics; by straight lines beyond its ends.

    Args:
        decay: From `decay_of`.
        place: Where to look, in steps.

    Returns:
        Logarithm of the envelope, and its derivative by the place.
    """
    whole = jax.lax.stop_gradient(jnp.floor(place))
    f = place - whole
    index = whole.astype(int)[:, None] + jnp.arange(-1, 3)
    inside = jnp.clip(index, 0, len(decay) - 1)
    ends = jnp.where(index < 0, decay[1] - decay[0], decay[-1] - decay[-2])
    values = decay[inside] + (index - inside) * ends
    weights = jnp.stack(
        [
            -f * (f - 1) * (f - 2) / 6,
            (f + 1) * (f - 1) * (f - 2) / 2,
            -(f + 1) * f * (f - 2) / 2,
            (f + 1) * f * (f - 1) / 6,
        ],
        axis=-1,
    )
    slopes = jnp.stack(
        [
            -(3 * f**2 - 6 * f + 2) / 6,
            (3 * f**2 - 4 * f - 1) / 2,
            -(3 * f**2 - 2 * f - 2) / 2,
            (3 * f**2 - 1) / 6,
        ],
        axis=-1,
    )
    return jnp.sum(weights * values, axis=-1), jnp.sum(slopes * values, axis=-1)
