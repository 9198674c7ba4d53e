"""The swept sine of the tests, as a function of time; `sampled` makes a record of it."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.oscillator.parameters import Scalar

Input = Callable[[Scalar], Scalar]


def sampled(u: Input, fs: float, num_samples: int) -> Float[Array, " time"]:
    """Values of an input at t = n / fs.

    Args:
        u: Input as a function of time [s].
        fs: Sampling rate [Hz].
        num_samples: Number of samples.

    Returns:
        Samples, in the unit of u.
    """
    return jnp.asarray(jax.vmap(u)(jnp.asarray(np.arange(num_samples) / fs)))


def sweep(
    amplitude: Scalar,
    start_hz: Scalar,
    end_hz: Scalar,
    duration: Scalar,
    *,
    fade: Scalar = 0.0,
) -> Input:
    r"""Linearly swept sine, then nothing.

    $$u(t) = A\,g(t)\sin 2\pi\left(f_0 t + \frac{f_1 - f_0}{2T} t^2\right), \quad 0 \le t < T$$

    Over the last `fade` seconds the gain g falls from 1 to 0 as half a cosine, so that the burst
    ends without a step that no band-limited record could hold.

    Args:
        amplitude: Amplitude A [N/kg].
        start_hz: First frequency f_0 [Hz].
        end_hz: Last frequency f_1 [Hz].
        duration: Duration T [s].
        fade: Length of the fade at the end [s]; 0 for none.

    Returns:
        The input as a function of time [s].
    """

    def u(t):
        cycles = start_hz * t + 0.5 * (end_hz - start_hz) / duration * t**2
        left = duration - t
        faded = 0.5 - 0.5 * jnp.cos(jnp.pi * left / jnp.where(fade > 0.0, fade, 1.0))
        gain = jnp.where(left < fade, faded, 1.0)
        return amplitude * jnp.where(left > 0.0, gain * jnp.sin(2.0 * jnp.pi * cycles), 0.0)

    return u
