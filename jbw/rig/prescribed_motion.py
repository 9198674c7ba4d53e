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
RISE = 30  # of these, in which the motion grows: a force that starts at once keeps an offset
ORDERS = np.array([1, 3, 5, 7])
ROUNDS = 6  # of the higher harmonics, each a hundredth of the one before


@dataclass(frozen=True)
class Growth:
    """A prescribed displacement that grows, A (t / T) sin(2 pi f t): slow, so no mass shows."""

    frequency_hz: float  # frequency f [Hz]
    level: float  # largest displacement A [m]
    duration: float  # length of the record T [s]

    def displacement(self, t: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the displacement at times t [m]."""
        phase = 2.0 * np.pi * self.frequency_hz * t
        return self.level * t / self.duration * np.sin(phase)

    def velocity(self, t: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the velocity at times t [m/s]."""
        omega = 2.0 * np.pi * self.frequency_hz
        rate = np.sin(omega * t) + omega * t * np.cos(omega * t)
        return self.level / self.duration * rate


@dataclass(frozen=True)
class Held:
    """A controller's curve: at each frequency the force that holds the response's amplitude."""

    frequencies_hz: tuple[float, ...]  # frequencies in turn [Hz]
    level: float  # peak of the displacement's fundamental [m]
    dwell: float  # time over which a line is averaged [s]


@dataclass(frozen=True)
class Locked:
    """Points at which a controller holds the phase, in turn: a backbone at -90 degrees."""

    levels: tuple[float, ...]  # peaks of the displacement's fundamental in turn [m]
    phase: float = -90.0  # of the displacement to the force [deg]
    phase_error: float = 0.5  # standard deviation of the phase that is held [deg]
    amplitude_noise: float = 5e-4  # relative standard deviation of measured amplitudes [-]
    force_noise: float = 5e-3  # the same of forces [-]
    frequency_noise: float = 1e-5  # the same of frequencies [-]

    @property
    def level(self) -> float:
        """The largest of them [m]."""
        return max(self.levels)


@dataclass(frozen=True)
class HeldPoints:
    """Points at which a controller holds the amplitude: S-curves, or curves through their folds.

    By several frequencies at the same amplitudes, one behind the other, a surface of force.
    """

    frequencies_hz: tuple[float, ...]  # of each point [Hz]
    levels: tuple[float, ...]  # peaks of the displacement's fundamental, of each point [m]
    amplitude_noise: float = 5e-4  # relative standard deviation of measured amplitudes [-]
    force_noise: float = 5e-3  # the same of forces, and of their phases [rad]

    @property
    def level(self) -> float:
        """The largest of them [m]."""
        return max(self.levels)


def s_curve(frequency_hz: float, levels: tuple[float, ...], **stated: float) -> HeldPoints:
    """Return the amplitudes in turn at one frequency."""
    return HeldPoints((frequency_hz,) * len(levels), levels, **stated)


def pulled(
    joint: Joint | Specimen, growth: Growth, fs: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return displacement [m] and restoring force per unit mass k y + F [N/kg] of a slow loop."""
    specimen, count = specimen_of(joint), round(growth.duration * fs)
    fine = np.arange(2 * STEPS * count + 1) / (2 * STEPS * fs)
    force = np.asarray(_along(doubles(specimen), growth.velocity(fine), 1.0 / (STEPS * fs)))
    y = growth.displacement(np.arange(count) / fs)
    return y, float(specimen.k) * y + force[::STEPS][:count]


def holding_force(joint: Joint | Specimen, held: Held) -> NDArray[np.complex128]:
    """Return the force F_1 per mass at each frequency for a response of phase zero [N/kg]."""
    levels = (held.level,) * len(held.frequencies_hz)
    return held_points(joint, HeldPoints(held.frequencies_hz, levels))


def held_points(
    joint: Joint | Specimen, points: HeldPoints, distortion: float = 0.0
) -> NDArray[np.complex128]:
    """Return the force F_1 per unit mass of each point that holds a response of phase zero [N/kg].

    The exciter's third harmonic is so large a part of its first, and moves along with its phase.
    """
    specimen, level = specimen_of(joint), np.asarray(points.levels)
    omega = 2.0 * np.pi * np.asarray(points.frequencies_hz)
    return _held_force(specimen, omega, level, None, distortion)[1]


def locked_points(
    joint: Joint | Specimen, locked: Locked, phase: NDArray[np.float64], distortion: float = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    r"""Return frequency [Hz] and force per mass [N/kg] at which points have their phase [rad].

    $$\omega^2 - 2\zeta\omega_n \cot\varphi\,\omega - (k + \mathrm{Re}\,Z_1/Y +
      \cot\varphi\,\mathrm{Im}\,Z_1/Y) = 0$$
    """
    specimen, level = specimen_of(joint), np.asarray(locked.levels)
    start = np.full(level.size, float(specimen.omega_n))
    omega, force = _held_force(specimen, start, level, phase, distortion)
    return omega / (2.0 * np.pi), np.abs(force)


def _held_force(
    specimen: Specimen,
    omega: NDArray[np.float64],
    level: NDArray[np.float64],
    phase: NDArray[np.float64] | None,
    distortion: float,
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    """Return frequencies [rad/s] and fundamental forces [N/kg]; phases set the frequencies."""
    k, damping = float(specimen.k), float(specimen.zeta * specimen.omega_n)
    motion = np.zeros((level.size, ORDERS.size), complex)
    motion[:, 0] = level
    force = np.zeros(level.size, complex)
    for _ in range(ROUNDS):
        z = _harmonics(specimen, motion, omega[:, None] * ORDERS)
        if phase is not None:
            cotangent, z_1 = 1.0 / np.tan(phase), z[:, 0] / level
            stiffness = k + z_1.real + cotangent * z_1.imag
            omega = damping * cotangent + np.sqrt((damping * cotangent) ** 2 + stiffness)
        frequencies = omega[:, None] * ORDERS
        dynamic = k - frequencies**2 + 2j * damping * frequencies
        force = dynamic[:, 0] * level + z[:, 0]
        load = np.zeros_like(motion)
        # cos 3(theta + psi) beside cos(theta + psi), psi being the force's phase.
        load[:, 1] = distortion * np.abs(force) * np.exp(3j * np.angle(force))
        motion[:, 1:] = (load - z)[:, 1:] / dynamic[:, 1:]
    return omega, force


def _harmonics(
    specimen: Specimen, motion: NDArray[np.complex128], omega: NDArray[np.float64]
) -> NDArray[np.complex128]:
    r"""Return odd harmonics of the joint's force along periodic motions, one row per motion.

    The motions grow from rest as $\sin^2(\pi t / 2 T)$: small ones forget an offset in thousands of
    periods.
    """
    angle = 2.0 * np.pi * np.arange(2 * POINTS) / (2 * POINTS)
    waves = np.exp(1j * np.outer(ORDERS, angle))
    moved, moving = (motion @ waves).real, ((1j * omega * motion) @ waves).real
    moved, moving = (
        np.tile(x, PERIODS + 1)[:, : 2 * POINTS * PERIODS + 1] for x in (moved, moving)
    )
    rise = np.minimum(np.arange(moved.shape[1]) / (2 * POINTS * RISE), 1.0)
    slope = 0.5 * np.pi * np.sin(np.pi * rise) * omega[:, :1] / (2.0 * np.pi * RISE)
    velocity = np.sin(0.5 * np.pi * rise) ** 2 * moving + slope * moved
    h = 2.0 * np.pi / omega[:, 0] / POINTS
    z = np.asarray(_along_each(doubles(specimen), velocity, h))[:, -POINTS - 1 : -1]
    return np.asarray(2.0 / POINTS * z @ np.conj(waves[:, ::2]).T, complex)


@jax.jit
def _along(
    specimen: Specimen, v: Float[Array, " half"], h: float | Float[Array, ""]
) -> Float[Array, " step"]:
    """Integrate the joint's force at the steps' ends, from two velocity samples per step."""

    def rate(now: State, v: Array) -> State:
        return v, specimen.rates(v, now[1])

    def step(now: State, v: tuple[Array, Array, Array]) -> tuple[State, Array]:
        after = runge_kutta(rate, specimen.settle, now, v, h)
        return after, specimen.joint_force(after[0], v[2], after[1])

    rest = doubles((0.0, specimen.at_rest()))
    _, force = lax.scan(step, rest, (v[:-1:2], v[1::2], v[2::2]))
    return jnp.concatenate([jnp.zeros(1), force])


_along_each = jax.jit(jax.vmap(_along, in_axes=(None, 0, 0)))
