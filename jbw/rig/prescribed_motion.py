r"""The joint under a prescribed displacement: force loops, and controlled response points.

No oscillator is integrated here, only the force of the joint along a given motion, with the same
Runge-Kutta steps. The response under a controller is then found exactly: the motion is periodic,
its fundamental is the demanded one, and its higher harmonics are those of a sinusoidal force,

$$F_1 = (k - \omega^2 + 2j\zeta\omega_n\omega)\,Y_1 + Z_1, \qquad
  Y_n = -Z_n / (k - n^2\omega^2 + 2j\zeta\omega_n n\omega), \quad n = 3, 5, 7$$

which avoids a search along a curve that folds back.
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

STEPS = 16  # number of Runge-Kutta steps per sample of a loop
POINTS = 512  # number of steps per period of a controlled response
PERIODS = 40  # number of periods until the hysteretic force no longer depends on its start
# number of periods in which the motion grows, because a sudden start would leave an offset
RISE = 30
ORDERS = np.array([1, 3, 5, 7])
# iterations for the higher harmonics; each changes them by a hundredth of the previous change
ROUNDS = 6


@dataclass(frozen=True)
class Growth:
    """A prescribed growing displacement, A (t / T) sin(2 pi f t), too slow for inertia effects."""

    frequency_hz: float  # frequency f [Hz]
    level: float  # largest displacement A [m]
    duration: float  # length of the record T [s]

    def displacement(self, t: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the prescribed displacement at times t [m]."""
        phase = 2.0 * np.pi * self.frequency_hz * t
        return self.level * t / self.duration * np.sin(phase)

    def velocity(self, t: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the velocity of the prescribed displacement at times t [m/s]."""
        omega = 2.0 * np.pi * self.frequency_hz
        rate = np.sin(omega * t) + omega * t * np.cos(omega * t)
        return self.level / self.duration * rate


@dataclass(frozen=True)
class Held:
    """A response-controlled curve: the force that keeps a given amplitude at each frequency."""

    frequencies_hz: tuple[float, ...]  # frequencies in sequence [Hz]
    level: float  # peak of the displacement's fundamental [m]
    dwell: float  # averaging time per line [s]


@dataclass(frozen=True)
class Locked:
    """Points at a controlled phase, one after another; at -90 degrees they form a backbone."""

    levels: tuple[float, ...]  # peaks of the displacement's fundamental in sequence [m]
    phase: float = -90.0  # phase of the displacement relative to the force [deg]
    phase_error: float = 0.5  # standard deviation of the controlled phase [deg]
    amplitude_noise: float = 5e-4  # relative standard deviation of measured amplitudes [-]
    force_noise: float = 5e-3  # relative standard deviation of measured forces [-]
    frequency_noise: float = 1e-5  # relative standard deviation of measured frequencies [-]

    @property
    def level(self) -> float:
        """The largest displacement peak of the points [m]."""
        return max(self.levels)


@dataclass(frozen=True)
class HeldPoints:
    """Points at a controlled amplitude: S-curves, or response curves through their folds.

    With several frequencies at the same amplitudes in sequence, the points form a surface of force.
    """

    frequencies_hz: tuple[float, ...]  # frequency of each point [Hz]
    levels: tuple[float, ...]  # peak of the displacement's fundamental at each point [m]
    amplitude_noise: float = 5e-4  # relative standard deviation of measured amplitudes [-]
    # Relative standard deviation of forces, and standard deviation of their phases [rad].
    force_noise: float = 5e-3

    @property
    def level(self) -> float:
        """The largest displacement peak of the points [m]."""
        return max(self.levels)


def s_curve(frequency_hz: float, levels: tuple[float, ...], **stated: float) -> HeldPoints:
    """Return points at one frequency with controlled amplitudes, in the given order [m]."""
    return HeldPoints((frequency_hz,) * len(levels), levels, **stated)


def pulled(
    joint: Joint | Specimen, growth: Growth, fs: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return displacement [m] and restoring force k y + F [N/kg] along a slow growing loop."""
    specimen, count = specimen_of(joint), round(growth.duration * fs)
    fine = np.arange(2 * STEPS * count + 1) / (2 * STEPS * fs)
    force = np.asarray(_along(doubles(specimen), growth.velocity(fine), 1.0 / (STEPS * fs)))
    y = growth.displacement(np.arange(count) / fs)
    return y, float(specimen.k) * y + force[::STEPS][:count]


def holding_force(joint: Joint | Specimen, held: Held) -> NDArray[np.complex128]:
    """Return the force F_1 per mass [N/kg] at each frequency that holds the response amplitude."""
    levels = (held.level,) * len(held.frequencies_hz)
    return held_points(joint, HeldPoints(held.frequencies_hz, levels))


def held_points(
    joint: Joint | Specimen, points: HeldPoints, distortion: float = 0.0
) -> NDArray[np.complex128]:
    """Return the force F_1 per mass [N/kg] that holds the response amplitude at each point.

    `distortion` is the exciter's third harmonic relative to its fundamental; it follows the phase
    of the fundamental.
    """
    specimen, level = specimen_of(joint), np.asarray(points.levels)
    omega = 2.0 * np.pi * np.asarray(points.frequencies_hz)
    return _held_force(specimen, omega, level, None, distortion)[1]


def locked_points(
    joint: Joint | Specimen, locked: Locked, phase: NDArray[np.float64], distortion: float = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    r"""Return the frequency [Hz] and force per mass [N/kg] at which points have given phases [rad].

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
    """Return frequencies [rad/s] and first harmonics of the force [N/kg].

    If `phase` is given, the frequencies are those at which the force has this phase.
    """
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
        # If psi is the force's phase, the source's fundamental is cos(theta + psi) and its third
        # harmonic is cos 3(theta + psi).
        load[:, 1] = distortion * np.abs(force) * np.exp(3j * np.angle(force))
        motion[:, 1:] = (load - z)[:, 1:] / dynamic[:, 1:]
    return omega, force


def _harmonics(
    specimen: Specimen, motion: NDArray[np.complex128], omega: NDArray[np.float64]
) -> NDArray[np.complex128]:
    r"""Return the odd harmonics of the joint's force along periodic motions (rows).

    The motions grow from rest as $\sin^2(\pi t / 2 T)$, since small motions take thousands of
    periods to forget an offset.
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
    """Return the joint's force at the end of each step, from two velocity samples per step."""

    def rate(now: State, v: Array) -> State:
        return v, specimen.rates(v, now[1])

    def step(now: State, v: tuple[Array, Array, Array]) -> tuple[State, Array]:
        after = runge_kutta(rate, specimen.settle, now, v, h)
        return after, specimen.joint_force(after[0], v[2], after[1])

    rest = doubles((0.0, specimen.at_rest()))
    _, force = lax.scan(step, rest, (v[:-1:2], v[1::2], v[2::2]))
    return jnp.concatenate([jnp.zeros(1), force])


_along_each = jax.jit(jax.vmap(_along, in_axes=(None, 0, 0)))
