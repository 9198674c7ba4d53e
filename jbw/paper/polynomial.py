r"""The polynomial oscillator, and formulas of its Volterra kernels up to third order.

Amplitudes are complex peak amplitudes, with $e^{+j\omega t}$. Kernels are symmetric in their
frequencies, and the frequencies of one call broadcast.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Complex, Float, Inexact

from jbw.errors import ModelError
from jbw.oscillator.checks import is_concrete, require_none
from jbw.oscillator.oscillator import BoucWen
from jbw.oscillator.parameters import Scalar
from jbw.paper.coefficients import Smoothing

Real = Float[ArrayLike, "..."]
Kernel = Complex[Array, "..."]


class PolynomialOscillator(eqx.Module):
    r"""An oscillator with a quadratic and a cubic spring, per unit mass.

    $$\ddot y + 2\zeta\omega_n\dot y + \omega_0^2\,y + \rho\,y^2 + \lambda_3\,y^3 = u$$

    The coefficients are constant. In the smoothed joint `rho` switches with the sign of the
    velocity. A steady response has no even harmonics there, so that probing uses `rho = 0`.

    Attributes:
        damping: Viscous damping, 2 zeta omega_n [1/s]; omega_n need not be omega_0.
        stiffness: Linear stiffness, omega_0^2 = k + lambda_1 [1/s^2].
        rho: Quadratic stiffness [1/(m s^2)].
        lambda_3: Cubic stiffness [1/(m^2 s^2)].

    Reference:
        Eqs. (14), (26), as printed.
    """

    damping: Scalar
    stiffness: Scalar
    rho: Scalar
    lambda_3: Scalar


def cubic_oscillator(joint: BoucWen, polynomial: Smoothing) -> PolynomialOscillator:
    r"""Build the cubic oscillator equivalent to a joint with a nearly closed loop.

    $$\ddot y + 2\zeta\omega_n\dot y + (k + \lambda_1)\,y + \lambda_3\,y^3 = u$$

    Args:
        joint: Bouc-Wen parameters.
        polynomial: Coefficients that smooth the loop of the joint; only lambda_1 and lambda_3 are
            used.

    Returns:
        The cubic oscillator, with `rho` zero.

    Raises:
        ModelError: The joint has another restoring force next to the hysteretic one.

    Reference:
        Eq. (26), as printed.
    """
    require_none(joint, "cubic_oscillator")
    return PolynomialOscillator(
        damping=2.0 * joint.zeta * joint.omega_n,
        stiffness=joint.k + polynomial.lambda_1,
        rho=0.0,
        lambda_3=polynomial.lambda_3,
    )


def nonlinear_force(
    system: PolynomialOscillator, parts: Sequence[Inexact[Array, "..."]]
) -> Inexact[Array, "..."]:
    r"""Return the contribution of order n to the nonlinear force $\rho y^2 + \lambda_3 y^3$.

    $$f_n = \rho\sum_{i+k=n} y_i y_k + \lambda_3\sum_{i+k+l=n} y_i y_k y_l$$

    It needs only the lower orders of y, and drives the next one: $y_n = -h_1 * f_n$.

    Args:
        system: Polynomial oscillator.
        parts: Parts of y of orders 1 to n - 1 [m].

    Returns:
        Force of order n [N/kg].

    Reference:
        Eq. (17), corrected: the printed product sign is superfluous.
    """
    y, order = dict(enumerate(parts, start=1)), len(parts) + 1
    square = sum(y[i] * y[order - i] for i in y)
    cube = sum(y[i] * y[k] * y[order - i - k] for i in y for k in y if i + k < order)
    return jnp.asarray(system.rho * square + system.lambda_3 * cube)


def kernel_1(system: PolynomialOscillator, omega: Real) -> Kernel:
    r"""Return the receptance of the linear part of a polynomial oscillator.

    $$H_1(\omega) = \frac{1}{\omega_0^2 - \omega^2 + 2j\zeta\omega_n\omega}$$

    Args:
        system: Polynomial oscillator.
        omega: Angular frequency [rad/s].

    Returns:
        Receptance [s^2], complex.

    Raises:
        ModelError: The oscillator has no damping and a concrete `omega` is its natural frequency.

    Reference:
        Eq. (23), corrected: with lambda_1 of (11) in full, omega_0 lies below omega_n.
    """
    require_no_pole(system.stiffness, system.damping, omega)
    omega = jnp.asarray(omega)
    return jnp.asarray(1.0 / (system.stiffness - omega**2 + 1j * system.damping * omega))


def require_no_pole(stiffness: Real, damping: Real, omega: Real) -> None:
    """Raise an error if a frequency is a pole of the undamped receptance; skip traced values."""
    if not is_concrete(stiffness, damping, omega):
        return
    stiffness, damping, omega = (np.asarray(x) for x in (stiffness, damping, omega))
    # A sum of frequencies may differ from the pole by a few rounding errors.
    close = np.abs(stiffness - omega**2) <= 1e-14 * np.abs(stiffness)
    if np.any(pole := close & (damping == 0.0)):
        value = float(np.broadcast_to(omega, pole.shape)[pole].ravel()[0])
        raise ModelError(
            f"The receptance is infinite at omega = {value:g} rad/s: that is the natural frequency "
            "and the damping is zero.",
            remedy="Give a damping above zero, or another frequency.",
        )


def kernel_2(system: PolynomialOscillator, omega_1: Real, omega_2: Real) -> Kernel:
    r"""Return the second-order kernel of a polynomial oscillator.

    $$H_2(\omega_1,\omega_2) = -\rho\,H_1(\omega_1)\,H_1(\omega_2)\,H_1(\omega_1+\omega_2)$$

    Args:
        system: Polynomial oscillator.
        omega_1: First angular frequency [rad/s].
        omega_2: Second angular frequency [rad/s].

    Returns:
        Kernel [m^-1 s^4], complex.

    Reference:
        Eq. (18), as printed.
    """
    h = [kernel_1(system, omega) for omega in (omega_1, omega_2, omega_1 + omega_2)]
    return jnp.asarray(-system.rho * h[0] * h[1] * h[2])


def kernel_3(system: PolynomialOscillator, omega_1: Real, omega_2: Real, omega_3: Real) -> Kernel:
    r"""Return the third-order kernel of a polynomial oscillator.

    $$H_3 = H_1(\omega_1) H_1(\omega_2) H_1(\omega_3) H_1(\omega_1+\omega_2+\omega_3)
      \Bigl[-\lambda_3 + \tfrac{2}{3}\rho^2\bigl(H_1(\omega_1+\omega_2)
      + H_1(\omega_1+\omega_3) + H_1(\omega_2+\omega_3)\bigr)\Bigr]$$

    Args:
        system: Polynomial oscillator.
        omega_1: First angular frequency [rad/s].
        omega_2: Second angular frequency [rad/s].
        omega_3: Third angular frequency [rad/s].

    Returns:
        Kernel [m^-2 s^6], complex.

    Reference:
        Eqs. (18), (27), as printed; the printed (27) is the case rho = 0.
    """

    def h(omega: Real) -> Kernel:
        return kernel_1(system, omega)

    pairs = h(omega_1 + omega_2) + h(omega_1 + omega_3) + h(omega_2 + omega_3)
    bracket = -system.lambda_3 + (2.0 / 3.0) * jnp.square(system.rho) * pairs
    return h(omega_1) * h(omega_2) * h(omega_3) * h(omega_1 + omega_2 + omega_3) * bracket
