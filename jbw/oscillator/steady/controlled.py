r"""Steady motion that a controller holds: its first harmonic is known, its force is asked for.

Where several motions answer one force, one force answers a motion: along the amplitude no branch
is chosen and no fold is met. Of the harmonic balance R_n(q) = u_n (`balance.imbalance`, without a
load) with q_1 = Y known, the higher harmonics remain,

$$R_n(Y, q_3, q_5, \dots) = 0, \quad n = 3, 5, \dots, \qquad
  F_1 e^{-j\varphi} = R_1(Y, q_3, q_5, \dots)$$

with phi the phase of the displacement to the force. Where the phase is held as well, the frequency
is one more unknown, and what determines it is that the force has that phase,
$\mathrm{Im}\,(R_1 e^{j\varphi}) = 0$.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from jbw.oscillator.checks import require_periodic
from jbw.oscillator.oscillator import Joint, as_oscillator
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.steady.balance import imbalance, newton_steps
from jbw.oscillator.steady.waveform import orders

NUM_HARMONICS = 4
NUM_STEPS = 3  # of Newton's iteration from the first harmonic alone; the error is squared in each


def force_at(
    joint: Joint,
    omega: Scalar,
    y_peak: Scalar,
    num_harmonics: int = NUM_HARMONICS,
    num_steps: int = NUM_STEPS,
) -> Complex[Array, ""]:
    r"""Fundamental force per unit mass that holds the amplitude at a frequency [N/kg].

    $$F_1 e^{-j\varphi} = (\omega_n^2 - \omega^2 + 2j\zeta\omega_n\omega)\,Y + \sum r_1(q)$$

    Its phase counts from the displacement. Without higher harmonics this is the describing function
    of the laws; what they add is some 1e-4 of the damping's part.

    Args:
        joint: A `BoucWen` with nu = 1, or an `Oscillator`, scalars.
        omega: Angular frequency [rad/s].
        y_peak: Amplitude Y of the displacement's fundamental [m], positive.
        num_harmonics: Odd harmonics that are balanced.
        num_steps: Steps of Newton's iteration.

    Raises:
        ModelError: nu is not 1, or a spring has an even part.
    """
    joint = as_oscillator(joint)
    require_periodic(joint)

    def imbalance(x: Float[Array, " unknown"]) -> Float[Array, " unknown"]:
        return _split(_imbalance(joint, omega, y_peak, x)[1:])

    x = newton_steps(imbalance, jnp.zeros(2 * num_harmonics - 2), num_steps)
    return jnp.asarray(y_peak * _imbalance(joint, omega, y_peak, x)[0])


def tone_at_phase(
    joint: Joint,
    y_peak: Scalar,
    phase: Scalar,
    num_harmonics: int = NUM_HARMONICS,
    num_steps: int = NUM_STEPS,
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    r"""Frequency [rad/s] and force amplitude [N/kg] that hold an amplitude at a phase.

    For y = Y cos(theta), of stiffness K and damping C at amplitude Y, the first harmonic is

    $$\omega = \zeta\omega_n \cot\varphi +
        \sqrt{(\zeta\omega_n \cot\varphi)^2 + k + K + C\cot\varphi}, \qquad
      F = -\frac{2\zeta\omega_n\omega + C}{\sin\varphi}\,Y$$

    from which Newton's iteration finds the higher ones. At -90 degrees it is the backbone.

    Args:
        joint: A `BoucWen` with nu = 1, or an `Oscillator`, scalars.
        y_peak: Amplitude Y of the displacement's fundamental [m], positive.
        phase: Phase of the displacement to the force [rad], between -pi and 0.
        num_harmonics: Odd harmonics that are balanced.
        num_steps: Steps of Newton's iteration.

    Raises:
        ModelError: nu is not 1, or a spring has an even part.
    """
    joint = as_oscillator(joint)
    require_periodic(joint)
    turn = jax.lax.complex(jnp.cos(phase), jnp.sin(phase))

    def imbalance(x: Float[Array, " unknown"]) -> Float[Array, " unknown"]:
        r = _imbalance(joint, x[-1] * joint.omega_n, y_peak, x[:-1])
        return jnp.append(_split(r[1:]), jnp.imag(r[0] * turn)) / joint.omega_n**2

    none = jnp.zeros(2 * num_harmonics - 2)
    cotangent = jnp.cos(phase) / jnp.sin(phase)
    # At omega_n the first harmonic is 2 j zeta omega_n^2 and what the laws add to omega_n^2.
    law = _imbalance(joint, joint.omega_n, y_peak, none)[0] - 2j * joint.zeta * joint.omega_n**2
    half = joint.zeta * joint.omega_n * cotangent
    squared = joint.omega_n**2 + jnp.real(law) + jnp.imag(law) * cotangent
    omega = half + jnp.sqrt(half**2 + squared)
    x = newton_steps(imbalance, jnp.append(none, omega / joint.omega_n), num_steps)
    force = _imbalance(joint, x[-1] * joint.omega_n, y_peak, x[:-1])[0]
    return x[-1] * joint.omega_n, y_peak * jnp.abs(force)  # pyright: ignore[reportReturnType]


def _imbalance(
    joint: Joint, omega: Scalar, y_peak: Scalar, x: Float[Array, " unknown"]
) -> Complex[Array, " harmonic"]:
    """Residual of the balance over Y, by the higher harmonics over Y, real, then imaginary."""
    real, imaginary = jnp.split(x, 2)
    higher = jax.lax.complex(real, imaginary)
    q = jnp.asarray(y_peak * jnp.concatenate([jnp.ones(1, complex), higher]))
    return imbalance(joint, omega, q, 0.0 * orders(q.shape[0])) / y_peak


def _split(values: Complex[Array, " harmonic"]) -> Float[Array, " part"]:
    """Real parts, then imaginary parts."""
    return jnp.concatenate([values.real, values.imag])
