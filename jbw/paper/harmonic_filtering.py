r"""Harmonics of a measured response, and the third-order kernel that they give, Eqs. (29), (30)."""

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Complex, Float, Inexact

from jbw.errors import ConfigError, DataError
from jbw.oscillator.checks import is_concrete

Values = Inexact[ArrayLike, "..."]


def harmonic_response(
    h_1: Values, h_3: Values, amplitude: Values
) -> tuple[Complex[Array, "..."], Complex[Array, "..."]]:
    r"""First and third harmonic of the response to a tone, by the leading kernels.

    $$y(t) = \mathrm{Re}\,[Y(\omega)\,e^{j\omega t} + Y(3\omega)\,e^{3j\omega t}], \qquad
      Y(\omega) = A\,H_1(\omega), \quad Y(3\omega) = \tfrac14 A^3 H_3(\omega,\omega,\omega)$$

    Args:
        h_1: Receptance at omega [s^2].
        h_3: Third-order kernel on its leading diagonal at omega [m^-2 s^6].
        amplitude: Complex peak amplitude A of the input [N/kg].

    Returns:
        Complex peak amplitudes Y(omega) and Y(3 omega) [m].

    Reference:
        Eq. (29), as printed: what it leaves out is lambda_3 A^2 |H1|^2 H1(3 omega) of Y(3 omega).
    """
    h_1, h_3, amplitude = jnp.asarray(h_1), jnp.asarray(h_3), jnp.asarray(amplitude)
    return amplitude * h_1 + 0j, amplitude**3 * h_3 / 4.0 + 0j


def harmonic_amplitudes(
    x: Float[ArrayLike, "... time"],
    fs: float,
    omega: Float[ArrayLike, ""],
    num_harmonics: int = 7,
) -> Complex[Array, "... harmonic"]:
    r"""Harmonic filter: complex peak amplitudes of a tone's harmonics, by least squares.

    $$x(t) \approx X_0 + \mathrm{Re}\sum_{n=1}^{N} X_n\,e^{jn\omega t}$$

    `jbw.harmonics` does the same for records with other tones and a noise to be judged, in NumPy.

    Args:
        x: Record, the time on its last axis, from t = 0.
        fs: Sampling rate [Hz].
        omega: Angular frequency of the tone [rad/s].
        num_harmonics: Highest order N fitted.

    Returns:
        Amplitudes of orders 1 to N, in the unit of x.

    Raises:
        ConfigError: `num_harmonics` is below 1, or its order is at the Nyquist frequency or above.
        DataError: The record has fewer samples than there are unknowns.

    Reference:
        Eq. (29), as printed: the harmonics that it takes from the measured response.
    """
    x = jnp.asarray(x, float)
    if num_harmonics < 1:
        raise ConfigError(f"`num_harmonics` must be 1 or more, but is {num_harmonics}.")
    hertz = jnp.asarray(omega) / (2 * jnp.pi)
    if is_concrete(hertz, fs) and not float(num_harmonics * hertz) < fs / 2:
        raise ConfigError(
            f"Harmonic {num_harmonics} of {float(hertz):g} Hz must lie below the "
            f"Nyquist frequency, but fs is {fs:g} Hz.",
            remedy="Lower `num_harmonics`.",
        )
    if x.shape[-1] < 2 * num_harmonics + 1:
        raise DataError(
            f"A fit of {num_harmonics} harmonics needs {2 * num_harmonics + 1} samples, "
            f"but the record has {x.shape[-1]}."
        )
    phase = jnp.asarray(omega) * jnp.arange(x.shape[-1]) / fs
    orders = jnp.arange(1, num_harmonics + 1)[:, None]
    basis = jnp.concatenate(
        [jnp.ones_like(phase)[None], jnp.cos(orders * phase), jnp.sin(orders * phase)]
    )
    fitted = jnp.linalg.solve(basis @ basis.T, basis @ x[..., None])[..., 0]
    cosines, sines = fitted[..., 1 : num_harmonics + 1], fitted[..., num_harmonics + 1 :]
    return cosines - 1j * sines


def estimated_kernel(y_3: Values, amplitude: Values) -> Complex[Array, "..."]:
    r"""Third-order kernel on its leading diagonal, from a measured third harmonic.

    $$H_3(\omega) = \frac{4\,Y(3\omega)}{A^3}$$

    Of a joint by Bouc and Wen it changes with the amplitude: keep the displacement beside it.
    `jbw.third_order_kernel` takes the source's own third harmonic out first.

    Args:
        y_3: Complex peak amplitude of the response at 3 omega [m].
        amplitude: Complex peak amplitude A of the input at omega [N/kg]; not zero.

    Returns:
        Kernel [m^-2 s^6].

    Raises:
        DataError: A concrete `amplitude` is zero.

    Reference:
        Eq. (30), as printed.
    """
    amplitude = jnp.asarray(amplitude)
    if is_concrete(amplitude) and bool(jnp.any(amplitude == 0)):
        raise DataError("The input's amplitude must not be zero to estimate a kernel, but it is.")
    return 4.0 * jnp.asarray(y_3) / amplitude**3 + 0j
