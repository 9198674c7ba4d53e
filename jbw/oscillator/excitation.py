"""Excitations of tests: tone, multisine, swept sine and band noise (`jbw.excitation`).

`tone`, `multisine` and `sweep` return functions of time; `sampled` returns the record of such a
function. Random inputs take a key first and are one period of a periodic signal.

Examples:
    A sweep of 16 s from 10 to 25 Hz is followed by 4 s of rest:

    >>> import jbw; jbw.enable_x64()
    >>> sweep = jbw.excitation.sweep(0.2, start_hz=10.0, end_hz=25.0, duration=16.0, fade=1.0)
    >>> u = jbw.excitation.sampled(sweep, fs=1024.0, num_samples=20 * 1024)
    >>> print(f"{abs(u).max():.2f} N/kg, {abs(u[16 * 1024:]).max():.2f} N/kg")
    0.20 N/kg, 0.00 N/kg
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.errors import ConfigError
from jbw.oscillator.hold import line_frequencies
from jbw.oscillator.parameters import Scalar

__all__ = ["band_noise", "multisine", "sampled", "sweep", "tone"]

Input = Callable[[Scalar], Scalar]


def sampled(u: Input, fs: float, num_samples: int) -> Float[Array, " time"]:
    """Return the values of an input function at t = n / fs.

    Args:
        u: Input as a function of time [s].
        fs: Sampling rate [Hz].
        num_samples: Number of samples.

    Returns:
        Samples, in the unit of u.
    """
    return jnp.asarray(jax.vmap(u)(jnp.arange(num_samples) / fs))


def tone(amplitude: Scalar, omega: Scalar, phase: Scalar = 0.0) -> Input:
    r"""Return a single-tone input, $u(t) = A\cos(\omega t + \varphi)$.

    Args:
        amplitude: Peak amplitude A [N/kg].
        omega: Angular frequency [rad/s].
        phase: Phase [rad].

    Returns:
        The input as a function of time [s].
    """
    return lambda t: amplitude * jnp.cos(omega * t + phase)


def multisine(
    amplitudes: Float[Array, " tone"], omegas: Float[Array, " tone"], phases: Float[Array, " tone"]
) -> Input:
    r"""Return a sum of tones, $u(t) = \sum_i A_i\cos(\omega_i t + \varphi_i)$.

    Args:
        amplitudes: Peak amplitudes A_i [N/kg].
        omegas: Angular frequencies [rad/s].
        phases: Phases [rad].

    Returns:
        The input as a function of time [s].
    """
    return lambda t: jnp.sum(amplitudes * jnp.cos(omegas * t + phases))


def sweep(
    amplitude: Scalar,
    start_hz: Scalar,
    end_hz: Scalar,
    duration: Scalar,
    *,
    fade: Scalar = 0.0,
) -> Input:
    r"""Return a linearly swept sine that is zero after its end.

    $$u(t) = A\,g(t)\sin 2\pi\left(f_0 t + \frac{f_1 - f_0}{2T} t^2\right), \quad 0 \le t < T$$

    Over the last `fade` seconds the gain g falls from 1 to 0 as half a cosine, so that the burst
    ends without a step, which no band-limited record could represent.

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
        remaining = duration - t
        faded = 0.5 - 0.5 * jnp.cos(jnp.pi * remaining / jnp.where(fade > 0.0, fade, 1.0))
        gain = jnp.where(remaining < fade, faded, 1.0)
        return amplitude * jnp.where(remaining > 0.0, gain * jnp.sin(2.0 * jnp.pi * cycles), 0.0)

    return u


def band_noise(
    key: Array,
    rms: Scalar,
    band_hz: tuple[float, float],
    fs: float,
    num_samples: int,
    *,
    gaussian: bool = True,
) -> Float[Array, " time"]:
    """Draw one period of periodic noise in a band, with lines at multiples of fs / N.

    Args:
        key: Random key.
        rms: Root mean square [N/kg]; for Gaussian noise that of the ensemble, otherwise of each
            period.
        band_hz: Lowest and highest frequency [Hz], below fs / 2; the mean (0 Hz) is excluded.
        fs: Sampling rate [Hz].
        num_samples: Number of samples N of the period.
        gaussian: Whether the lines are complex Gaussian (noise) or have equal amplitudes and
            random phases (a random-phase multisine).

    Returns:
        Samples [N/kg].

    Raises:
        ConfigError: No line of the record lies in the band.
    """

    # If `xp` is jax.numpy, a compiled program computes this mask instead of storing it.
    def inside(xp: Any) -> Any:
        frequencies = line_frequencies(num_samples, 1.0 / fs, xp)
        beside_ends = (frequencies > 0.0) & (frequencies < 0.5 * fs * (1.0 - 1e-12))
        return (frequencies >= band_hz[0]) & (frequencies <= band_hz[1]) & beside_ends

    num_lines, size = int(np.sum(inside(np))), num_samples // 2 + 1
    if num_lines == 0:
        raise ConfigError(
            "Argument `band_hz` must contain a line of the record, a multiple of "
            f"fs/num_samples = {fs / num_samples:g} Hz below fs/2 = {fs / 2:g} Hz, but is "
            f"{band_hz}.",
            remedy="Widen the band or lengthen the record.",
        )
    # A line of spectrum X has mean square 2 |X|^2 / N^2.
    amplitude = num_samples * rms / jnp.sqrt(2.0 * num_lines)
    if gaussian:
        real, imag = jax.random.normal(key, (2, size)) / jnp.sqrt(2.0)
        lines = real + 1j * imag
    else:
        lines = jnp.exp(1j * jax.random.uniform(key, (size,), maxval=2.0 * jnp.pi))
    return jnp.fft.irfft(jnp.where(inside(jnp), amplitude * lines, 0.0), n=num_samples)
