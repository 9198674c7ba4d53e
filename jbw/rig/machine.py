r"""The joint under a prescribed displacement: force loops, and curves of a held response.

No oscillator is integrated here, only the hysteretic force along a motion that is given, by
Runge-Kutta steps as on the bench. A controller that holds the response is then found exactly: the
motion is periodic, its fundamental is what was asked, and its higher harmonics are those that a
sinusoidal force leaves,

$$F_1 = (k - \omega^2 + 2j\zeta\omega_n\omega)\,Y_1 + Z_1, \qquad
  Y_n = -Z_n / (k - n^2\omega^2 + 2j\zeta\omega_n n\omega), \quad n = 3, 5, 7$$

which needs no search along a curve that bends over.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jbw.oscillator.parameters import BoucWen

STEPS = 16  # Runge-Kutta steps in a sample of a loop
POINTS = 512  # steps in a period of a held response
PERIODS = 40  # until the hysteretic force has forgotten its start
ORDERS = np.array([1, 3, 5, 7])
ROUNDS = 6  # of the higher harmonics, each a hundredth of the one before


@dataclass(frozen=True)
class Growth:
    """A prescribed displacement that grows, A (t / T) sin(2 pi f t): slow, so that no mass shows.

    Attributes:
        frequency_hz: Frequency f [Hz].
        level: Largest displacement A [m].
        duration: Length of the record T [s].
    """

    frequency_hz: float
    level: float
    duration: float

    def displacement(self, t: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacement at times t [m]."""
        phase = 2.0 * np.pi * self.frequency_hz * t
        return self.level * t / self.duration * np.sin(phase)

    def velocity(self, t: NDArray[np.float64]) -> NDArray[np.float64]:
        """Velocity at times t [m/s]."""
        omega = 2.0 * np.pi * self.frequency_hz
        rate = np.sin(omega * t) + omega * t * np.cos(omega * t)
        return self.level / self.duration * rate


@dataclass(frozen=True)
class Held:
    """A controller's curve: at each frequency the force that holds the response's amplitude.

    Attributes:
        frequencies_hz: Frequencies in turn [Hz].
        level: Peak of the displacement's fundamental [m].
        dwell: Time over which a line is averaged [s].
    """

    frequencies_hz: tuple[float, ...]
    level: float
    dwell: float


def pulled(
    joint: BoucWen, growth: Growth, fs: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Displacement [m] and restoring force per unit mass k y + z [N/kg] of a slow loop.

    Args:
        joint: The specimen; nu = 1.
        growth: The prescribed displacement.
        fs: Sampling frequency [Hz].
    """
    count = round(growth.duration * fs)
    fine = np.arange(2 * STEPS * count + 1) / (2 * STEPS * fs)
    z = np.asarray(_slip(_leaves(joint), growth.velocity(fine), 1.0 / (STEPS * fs)))
    y = growth.displacement(np.arange(count) / fs)
    return y, float(joint.k) * y + z[::STEPS][:count]


def holding_force(joint: BoucWen, held: Held) -> NDArray[np.complex128]:
    """Sinusoidal force per unit mass that holds the response, its phase against it [N/kg].

    Args:
        joint: The specimen; nu = 1.
        held: The curve.

    Returns:
        F_1 at each frequency, for a fundamental of the displacement of phase zero.
    """
    omega = 2.0 * np.pi * np.asarray(held.frequencies_hz)[:, None] * ORDERS
    dynamic = float(joint.k) - omega**2 + 2j * float(joint.zeta * joint.omega_n) * omega
    motion = np.zeros(omega.shape, complex)
    motion[:, 0] = held.level
    z = np.zeros_like(motion)
    for _ in range(ROUNDS):
        z = _harmonics(joint, motion, omega)
        motion[:, 1:] = -z[:, 1:] / dynamic[:, 1:]
    return dynamic[:, 0] * motion[:, 0] + z[:, 0]


def _harmonics(
    joint: BoucWen, motion: NDArray[np.complex128], omega: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Odd harmonics of the hysteretic force along periodic motions, a row each."""
    angle = 2.0 * np.pi * np.arange(2 * POINTS) / (2 * POINTS)
    waves = np.exp(1j * np.outer(ORDERS, angle))
    period = ((1j * omega * motion) @ waves).real
    velocity = np.concatenate([np.tile(period, PERIODS), period[:, :1]], axis=1)
    h = 2.0 * np.pi / omega[:, 0] / POINTS
    z = np.asarray(_slip_together(_leaves(joint), velocity, h))[:, -POINTS - 1 : -1]
    return np.asarray(2.0 / POINTS * z @ np.conj(waves[:, ::2]).T, complex)


@jax.jit
def _slip(
    joint: BoucWen, v: Float[Array, " half"], h: float | Float[Array, ""]
) -> Float[Array, " step"]:
    """Hysteretic force at the ends of the steps, along a velocity given twice a step.

    Reference:
        Eq. (2) at nu = 1.
    """

    def rate(z: Array, v: Array) -> Array:
        return joint.alpha * v - joint.gamma * abs(v) * z - joint.delta * v * abs(z)

    def step(z: Array, v: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        k_1 = rate(z, v[0])
        k_2 = rate(z + h / 2 * k_1, v[1])
        k_3 = rate(z + h / 2 * k_2, v[1])
        k_4 = rate(z + h * k_3, v[2])
        after = z + h / 6 * (k_1 + 2 * k_2 + 2 * k_3 + k_4)
        return after, after

    _, z = lax.scan(step, jnp.zeros(()), (v[:-1:2], v[1::2], v[2::2]))
    return jnp.concatenate([jnp.zeros(1), z])


_slip_together = jax.jit(jax.vmap(_slip, in_axes=(None, 0, 0)))


def _leaves(joint: BoucWen) -> BoucWen:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), joint)
