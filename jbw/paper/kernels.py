r"""Receptance and third-order kernel of the joint, Eqs. (23)-(31).

Peak complex amplitudes and $e^{+j\omega t}$ throughout. Kernels are symmetric in their
frequencies, and the frequencies of one call broadcast.
"""

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Complex, Float, Inexact

from jbw.oscillator.checks import require_none
from jbw.oscillator.laws.hysteresis import steady_loop
from jbw.oscillator.oscillator import BoucWen
from jbw.paper.coefficients import Variant, smoothing
from jbw.paper.polynomial import require_no_pole

Real = Float[ArrayLike, "..."]
Kernel = Complex[Array, "..."]


def h1(omega: Real, omega_n: Real, zeta: Real) -> Kernel:
    r"""Receptance of the linear oscillator, per unit modal mass.

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
    """
    require_no_pole(jnp.square(omega_n), zeta, omega)
    return 1.0 / (jnp.square(omega_n) - jnp.square(omega) + 2j * zeta * omega_n * omega)


def cubic_kernel(omega: Real, omega_n: Real, zeta: Real, lambda_3: Real) -> Kernel:
    r"""Third-order kernel of a cubic oscillator on its leading diagonal.

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
    r"""Third-order kernel of the nearly closed loop, on its leading diagonal.

    $$H_3(\omega) = -\lambda_3(Y)\,H_1(\omega)^3\,H_1(3\omega)$$

    H_1 takes omega_n, as in the paper; the shift of omega_0 by lambda_1 is left out. Holds where
    the loop hardly opens (below resonance, around omega_n / 3); at 0.8 mm it is off by up to 14 %
    and 8 degrees, and 25 degrees at omega_n / 3. `third_harmonic` is the accurate formula.

    Args:
        joint: Bouc-Wen parameters.
        omega: Angular frequency [rad/s].
        y_peak: Largest displacement of the test at each frequency [m].
        variant: "printed" is the paper's (25), lambda_3 = alpha (delta^2/6 - 35 delta/(96 Y)), in
            which `gamma` has no influence; the others are those of `smoothing`.

    Returns:
        Kernel [m^-2 s^6], complex.

    Raises:
        ConfigError: If `variant` is unknown, or a concrete `y_peak` is not positive.
        ModelError: If nu is not 1, the joint has a restoring force beside the hysteretic one, or a
            concrete argument is not finite.

    Reference:
        Eqs. (25), (31), corrected: lambda_3 keeps gamma; printed by variant="printed". For the
        true joint the kernel is off by up to 14 % whichever lambda_3 it takes.
    """
    require_none(joint, "h3")
    closed: Variant = "printed_closed" if variant == "printed" else variant
    lambda_3 = smoothing(joint, y_peak, variant=closed).lambda_3
    return cubic_kernel(omega, joint.omega_n, joint.zeta, lambda_3)


def third_harmonic(
    joint: BoucWen, omega: Real, y_1: Inexact[ArrayLike, "..."]
) -> Complex[Array, "..."]:
    r"""Third harmonic of the displacement, from the first, under a tone without harmonics.

    $$Y(3\omega) = -\frac{Z_3(|Y_1|)\,(Y_1/|Y_1|)^3}{1/H_1(3\omega) - 2\alpha\delta|Y_1|/\pi}$$

    Z_3 is that of the exact loop, so its phase carries gamma; the correction of the denominator is
    the mean softening that the ripple at 3 omega sees. Good to 0.6 % and 0.3 degrees while
    delta |Y_1| is small, away from 3 omega = omega_n; there to 1.2 % and 5 degrees. The steady
    state by harmonic balance is exact.

    Args:
        joint: Bouc-Wen parameters.
        omega: Angular frequency of the tone [rad/s].
        y_1: Complex peak amplitude of the displacement at `omega` [m]; not zero.

    Returns:
        Complex peak amplitude at 3 omega [m].

    Raises:
        ModelError: The joint has a restoring force beside the hysteretic one, or as `steady_loop`.

    Reference:
        Eq. (29), replaced: the third harmonic of the loop itself, which knows gamma.
    """
    require_none(joint, "third_harmonic")
    y_peak = jnp.abs(y_1)
    softening = 2.0 * joint.alpha * joint.delta * y_peak / jnp.pi
    turn = (y_1 / y_peak) ** 3
    ripple = softened_receptance(3.0 * jnp.asarray(omega), joint.omega_n, joint.zeta, softening)
    return -steady_loop(joint, y_peak).z_3 * turn * ripple


def softened_receptance(omega: Real, omega_n: Real, zeta: Real, softening: Real) -> Kernel:
    r"""Receptance that a small ripple sees while the joint moves under a tone.

    $$H(\omega) = \frac{1}{1/H_1(\omega) - s}, \qquad s = \frac{2\,\alpha\delta\,|Y_1|}{\pi}$$

    s is what the mean of alpha delta |y| over a period takes from the stiffness, by Eq. (2) to
    first order.

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
    r"""Cubic stiffness that gives a third-order kernel: the inverse of `cubic_kernel`.

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
