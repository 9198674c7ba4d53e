r"""The receptance and the third-order kernel of the joint, Eqs. (23)-(31).

Both are predicted from parameters and estimated from harmonics. Amplitudes are complex peak
amplitudes, with $e^{+j\omega t}$. Kernels are symmetric in their frequencies, and the frequencies
of one call broadcast.
"""

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Complex, Float, Inexact

from jbw.errors import ConfigError, DataError
from jbw.oscillator.checks import is_concrete, require_none
from jbw.oscillator.laws.hysteresis import steady_loop
from jbw.oscillator.oscillator import BoucWen
from jbw.paper.coefficients import Variant, smoothing
from jbw.paper.polynomial import require_no_pole

Real = Float[ArrayLike, "..."]
Kernel = Complex[Array, "..."]
Values = Inexact[ArrayLike, "..."]


def h1(omega: Real, omega_n: Real, zeta: Real) -> Kernel:
    r"""Return the receptance of the linear oscillator, per unit modal mass.

    $$H_1(\omega) = \frac{1}{\omega_n^2 - \omega^2 + 2j\zeta\omega_n\omega}$$

    Args:
        omega: Angular frequency [rad/s].
        omega_n: Natural frequency [rad/s].
        zeta: Viscous damping ratio [-].

    Returns:
        Receptance [s^2], complex.

    Raises:
        ModelError: `zeta` is zero and a concrete `omega` is the natural frequency.

    Reference:
        Eq. (23), as printed: omega_n stands for omega_0, which lambda_1 lowers a little.

    Examples:
        The receptance at resonance is 1 / (2j zeta omega_n^2):

        >>> import jbw; jbw.enable_x64()
        >>> print(f"{jbw.h1(omega=100.0, omega_n=100.0, zeta=0.01).imag:.4f} s^2")
        -0.0050 s^2
    """
    require_no_pole(jnp.square(omega_n), zeta, omega)
    return 1.0 / (jnp.square(omega_n) - jnp.square(omega) + 2j * zeta * omega_n * omega)


def cubic_kernel(omega: Real, omega_n: Real, zeta: Real, lambda_3: Real) -> Kernel:
    r"""Return the third-order kernel of a cubic oscillator on its leading diagonal.

    $$H_3(\omega) = -\lambda_3\,H_1(\omega)^3\,H_1(3\omega)$$

    Args:
        omega: Angular frequency [rad/s].
        omega_n: Natural frequency of the linear part [rad/s].
        zeta: Viscous damping ratio [-].
        lambda_3: Cubic stiffness [1/(m^2 s^2)].

    Returns:
        Kernel [m^-2 s^6], complex.

    Reference:
        Eqs. (28), (31), as printed.
    """
    superharmonic = h1(3.0 * jnp.asarray(omega), omega_n, zeta)
    return -jnp.asarray(lambda_3) * h1(omega, omega_n, zeta) ** 3 * superharmonic


def h3(
    joint: BoucWen,
    omega: Real,
    y_peak: Real,
    variant: Variant = "least_squares",
) -> Kernel:
    r"""Return the third-order kernel of the nearly closed loop, on its leading diagonal.

    $$H_3(\omega) = -\lambda_3(Y)\,H_1(\omega)^3\,H_1(3\omega)$$

    H_1 uses omega_n, as in the paper; the shift of omega_0 by lambda_1 is neglected. The formula
    holds where the loop hardly opens (below resonance, around omega_n / 3). At the paper's probing
    frequencies and 0.8 mm the exact kernel of the joint differs from it by up to 12 % and 8
    degrees, and by 25 degrees at omega_n / 3. `third_harmonic` is the accurate formula.

    Args:
        joint: Bouc-Wen parameters.
        omega: Angular frequency [rad/s].
        y_peak: Largest displacement of the test at each frequency [m].
        variant: "printed" is the paper's (25), lambda_3 = alpha (delta^2/6 - 35 delta/(96 Y)), in
            which `gamma` has no influence; the others are those of `smoothing`.

    Returns:
        Kernel [m^-2 s^6], complex.

    Raises:
        ConfigError: `variant` is unknown, or a concrete `y_peak` is not positive.
        ModelError: nu is not 1, the joint has another restoring force next to the hysteretic one,
            or a concrete argument is not finite.

    Reference:
        Eqs. (25), (31), corrected: lambda_3 keeps gamma; printed by variant="printed". The error
        is 12 % and 8 degrees with either lambda_3.

    Examples:
        The printed lambda_3 is alpha (delta^2 / 6 - 35 delta / (96 Y)), and the kernel divided by
        H_1(omega)^3 H_1(3 omega) is -lambda_3:

        >>> import jbw; jbw.enable_x64()
        >>> joint = jbw.BoucWen(omega_n=118.12, zeta=0.00444, alpha=497.4, delta=340.2, gamma=32.8)
        >>> kernel = jbw.h3(joint, omega=37.7, y_peak=0.8e-3, variant="printed")
        >>> h_1, h_1_of_3 = (jbw.h1(order * 37.7, joint.omega_n, joint.zeta) for order in (1, 3))
        >>> print(f"{(kernel / (h_1**3 * h_1_of_3)).real:.4g} 1/(m^2 s^2)")
        6.752e+07 1/(m^2 s^2)
    """
    require_none(joint, "h3")
    closed: Variant = "printed_closed" if variant == "printed" else variant
    lambda_3 = smoothing(joint, y_peak, variant=closed).lambda_3
    return cubic_kernel(omega, joint.omega_n, joint.zeta, lambda_3)


def third_harmonic(
    joint: BoucWen, omega: Real, y_1: Inexact[ArrayLike, "..."]
) -> Complex[Array, "..."]:
    r"""Return the third harmonic of displacement from the first, under a tone without harmonics.

    $$Y(3\omega) = -\frac{Z_3(|Y_1|)\,(Y_1/|Y_1|)^3}{1/H_1(3\omega) - 2\alpha\delta|Y_1|/\pi}$$

    Z_3 is that of the exact loop, so that its phase depends on gamma. The correction of the
    denominator is the mean softening for a ripple at 3 omega. The result is accurate to 0.6 % and
    0.3 degrees while delta |Y_1| is small, away from 3 omega = omega_n; there to 1.2 % and 5
    degrees. The steady state by harmonic balance is exact.

    Args:
        joint: Bouc-Wen parameters.
        omega: Angular frequency of the tone [rad/s].
        y_1: Complex peak amplitude of the displacement at `omega` [m]; not zero.

    Returns:
        Complex peak amplitude at 3 omega [m].

    Raises:
        ModelError: The joint has another restoring force next to the hysteretic one, or for reasons
            that `steady_loop` states.

    Reference:
        Eq. (29), replaced: the third harmonic of the loop itself, which depends on gamma.

    Examples:
        The formula agrees with harmonic balance away from a third of the resonance:

        >>> import jbw; jbw.enable_x64()
        >>> joint = jbw.BoucWen(omega_n=118.12, zeta=0.00444, alpha=497.4, delta=340.2, gamma=32.8)
        >>> y = jbw.steady_state(joint, omega=30.0, amplitude=5.0)
        >>> estimate = jbw.third_harmonic(joint, omega=30.0, y_1=y[0])
        >>> print(f"{1e6 * abs(estimate):.2f} um, {1e6 * abs(y[1]):.2f} um")
        0.34 um, 0.34 um
    """
    require_none(joint, "third_harmonic")
    y_peak = jnp.abs(y_1)
    softening = 2.0 * joint.alpha * joint.delta * y_peak / jnp.pi
    turn = (y_1 / y_peak) ** 3
    ripple = softened_receptance(3.0 * jnp.asarray(omega), joint.omega_n, joint.zeta, softening)
    return -steady_loop(joint, y_peak).z_3 * turn * ripple


def softened_receptance(omega: Real, omega_n: Real, zeta: Real, softening: Real) -> Kernel:
    r"""Return the receptance of a joint that is softened by a tone, for a small additional motion.

    $$H(\omega) = \frac{1}{1/H_1(\omega) - s}, \qquad s = \frac{2\,\alpha\delta\,|Y_1|}{\pi}$$

    s is the mean of alpha delta |y| over a period, which reduces the stiffness by Eq. (2) to first
    order.

    Args:
        omega: Angular frequency of the ripple, such as three times the tone's [rad/s].
        omega_n: Natural frequency at small amplitude [rad/s].
        zeta: Viscous damping ratio [-].
        softening: s [1/s^2].

    Returns:
        Receptance [s^2], complex.

    Reference:
        Eq. (23), corrected: omega_0 falls with the motion; the print keeps omega_n.
    """
    return 1.0 / (1.0 / h1(omega, omega_n, zeta) - jnp.asarray(softening))


def cubic_stiffness(
    h_3: Inexact[ArrayLike, "..."], omega: Real, omega_n: Real, zeta: Real
) -> Array:
    r"""Return the cubic stiffness from a third-order kernel, as the inverse of `cubic_kernel`.

    $$\lambda_3 = -\mathrm{Re}\,\frac{H_3(\omega)}{H_1(\omega)^3\,H_1(3\omega)}$$

    Args:
        h_3: Kernel on its leading diagonal [m^-2 s^6].
        omega: Angular frequency [rad/s].
        omega_n: Natural frequency of the linear part [rad/s].
        zeta: Viscous damping ratio [-].

    Returns:
        lambda_3 [1/(m^2 s^2)].

    Reference:
        Eq. (28), as printed, solved for lambda_3.
    """
    unit = cubic_kernel(omega, omega_n, zeta, 1.0)
    return jnp.real(jnp.asarray(h_3) / unit)


def harmonic_response(
    h_1: Values, h_3: Values, amplitude: Values
) -> tuple[Complex[Array, "..."], Complex[Array, "..."]]:
    r"""Return the first and third harmonics of the response to a tone, from the leading kernels.

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
    r"""Fit the complex peak amplitudes of a tone's harmonics to a record by least squares.

    $$x(t) \approx X_0 + \mathrm{Re}\sum_{n=1}^{N} X_n\,e^{jn\omega t}$$

    `jbw.harmonics` does the same in NumPy for records with other tones, and estimates the noise.

    Args:
        x: Record with time on its last axis, from t = 0.
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
    r"""Estimate the third-order kernel's leading diagonal from a measured third harmonic.

    $$H_3(\omega) = \frac{4\,Y(3\omega)}{A^3}$$

    For a Bouc-Wen joint it depends on the amplitude: store the displacement with it.
    `jbw.third_order_kernel` first removes the third harmonic of the source itself.

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
