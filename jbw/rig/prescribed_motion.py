r"""The joint under a prescribed displacement: force loops, and curves of a held response.

No oscillator is integrated here, only the force of the joint along a motion that is given, by
the same Runge-Kutta steps. A controller that holds the response is then found exactly: the
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

from jbw.oscillator.oscillator import Joint
from jbw.rig.integrator import Specimen, State, doubles, runge_kutta, specimen_of

STEPS = 16  # Runge-Kutta steps in a sample of a loop
POINTS = 512  # steps in a period of a held response
PERIODS = 40  # until the hysteretic force has forgotten its start
ORDERS = np.array([1, 3, 5, 7])
ROUNDS = 6  # of the higher harmonics, each a hundredth of the one before


@dataclass(frozen=True)
class Growth:
    """A prescribed displacement that grows, A (t / T) sin(2 pi f t): slow, so no mass shows."""

    frequency_hz: float  # frequency f [Hz]
    level: float  # largest displacement A [m]
    duration: float  # length of the record T [s]

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
    """A controller's curve: at each frequency the force that holds the response's amplitude."""

    frequencies_hz: tuple[float, ...]  # frequencies in turn [Hz]
    level: float  # peak of the displacement's fundamental [m]
    dwell: float  # time over which a line is averaged [s]


def pulled(
    joint: Joint | Specimen, growth: Growth, fs: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Displacement [m] and restoring force per unit mass k y + F [N/kg] of a slow loop."""
    specimen, count = specimen_of(joint), round(growth.duration * fs)
    fine = np.arange(2 * STEPS * count + 1) / (2 * STEPS * fs)
    force = np.asarray(_along(doubles(specimen), growth.velocity(fine), 1.0 / (STEPS * fs)))
    y = growth.displacement(np.arange(count) / fs)
    return y, float(specimen.k) * y + force[::STEPS][:count]


def holding_force(joint: Joint | Specimen, held: Held) -> NDArray[np.complex128]:
    """Force F_1 per unit mass at each frequency that holds a response of phase zero [N/kg]."""
    specimen = specimen_of(joint)
    omega = 2.0 * np.pi * np.asarray(held.frequencies_hz)[:, None] * ORDERS
    k, damping = float(specimen.k), float(specimen.zeta * specimen.omega_n)
    dynamic = k - omega**2 + 2j * damping * omega
    motion = np.zeros(omega.shape, complex)
    motion[:, 0] = held.level
    z = np.zeros_like(motion)
    for _ in range(ROUNDS):
        z = _harmonics(specimen, motion, omega)
        motion[:, 1:] = -z[:, 1:] / dynamic[:, 1:]
    return dynamic[:, 0] * motion[:, 0] + z[:, 0]


def _harmonics(
    specimen: Specimen, motion: NDArray[np.complex128], omega: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Odd harmonics of the joint's force along periodic motions, a row each."""
    angle = 2.0 * np.pi * np.arange(2 * POINTS) / (2 * POINTS)
    waves = np.exp(1j * np.outer(ORDERS, angle))
    period = ((1j * omega * motion) @ waves).real
    velocity = np.concatenate([np.tile(period, PERIODS), period[:, :1]], axis=1)
    h = 2.0 * np.pi / omega[:, 0] / POINTS
    z = np.asarray(_along_each(doubles(specimen), velocity, h))[:, -POINTS - 1 : -1]
    return np.asarray(2.0 / POINTS * z @ np.conj(waves[:, ::2]).T, complex)


@jax.jit
def _along(
    specimen: Specimen, v: Float[Array, " half"], h: float | Float[Array, ""]
) -> Float[Array, " step"]:
    """Force of the joint at the ends of the steps, along a velocity given twice a step."""

    def rate(now: State, v: Array) -> State:
        return v, specimen.rates(v, now[1])

    def step(now: State, v: tuple[Array, Array, Array]) -> tuple[State, Array]:
        after = runge_kutta(rate, specimen.settle, now, v, h)
        return after, specimen.joint_force(after[0], v[2], after[1])

    rest = doubles((0.0, specimen.at_rest()))
    _, force = lax.scan(step, rest, (v[:-1:2], v[1::2], v[2::2]))
    return jnp.concatenate([jnp.zeros(1), force])


_along_each = jax.jit(jax.vmap(_along, in_axes=(None, 0, 0)))
