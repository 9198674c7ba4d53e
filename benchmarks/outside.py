"""Tests of a joint made without jbw's solver or its rig: Runge-Kutta of order 4 in numpy.

All records of a campaign advance together, one array element each. The excitation is a function of
continuous time, so that nothing depends on how samples are joined.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jbw import Record, Test

Array = NDArray[np.float64]
NOISE_LINES = 400  # of random excitation


@dataclass(frozen=True)
class Specimen:
    """An oscillator with a joint.

    Attributes:
        omega_n: Natural frequency at small amplitude [rad/s].
        zeta: Viscous damping ratio [-].
        memories: Number of the joint's memories.
        stuck: Their stiffness as long as all stick, part of omega_n^2 [1/s^2].
        rate: rate(y, v, memory): rates of the memories, shape (memory, record) [N/kg/s].
        limits: Largest force of each memory, beyond which it slides [N/kg].
        spring: spring(y): force beside omega_n^2 y and the memories [N/kg].
    """

    omega_n: float
    zeta: float
    memories: int = 0
    stuck: float = 0.0
    rate: Callable[[Array, Array, Array], Array] = lambda y, v, memory: 0.0 * memory
    limits: Array | None = None
    spring: Callable[[Array], Array] = lambda y: 0.0 * y


def bouc_wen(
    omega_n: float,
    zeta: float,
    alpha: float,
    delta: float,
    gamma: float,
    nu: float = 1.0,
    cubic: float = 0.0,
) -> Specimen:
    """Joint of z' = alpha v - gamma |v| z |z|^(nu - 1) - delta v |z|^nu and a cubic spring."""

    def rate(y: Array, v: Array, z: Array) -> Array:
        size = np.abs(z) ** nu
        return alpha * v - gamma * np.abs(v) * np.sign(z) * size - delta * v * size

    return Specimen(omega_n, zeta, 1, alpha, rate, None, lambda y: cubic * y**3)


def sliders(
    omega_n: float, zeta: float, springs: Sequence[float], slips: Sequence[float]
) -> Specimen:
    """Jenkins elements: each a spring k_i that slides where it is stretched by its slip [m]."""
    k = np.array(springs)[:, None]
    limits = k * np.array(slips)[:, None]

    def rate(y: Array, v: Array, f: Array) -> Array:
        slides = (np.abs(f) >= limits) & (f * v > 0)
        return np.where(slides, 0.0, k * v)

    return Specimen(omega_n, zeta, len(k), float(k.sum()), rate, limits)


def respond(
    specimen: Specimen,
    force: Callable[[float], Array],
    num_samples: int,
    fs: float,
    substeps: int | None = None,
) -> tuple[Array, Array]:
    """Displacement and velocity from rest, shape (record, time).

    Args:
        specimen: Oscillator and joint.
        force: force(t): force per unit modal mass of all records [N/kg].
        num_samples: Samples.
        fs: Sampling frequency [Hz].
        substeps: Steps of Runge-Kutta a sample; 16 when None, 64 where sliders begin to slip amid
            a step.
    """
    substeps = substeps or (16 if specimen.limits is None else 64)
    k = specimen.omega_n**2 - specimen.stuck
    c, h = 2 * specimen.zeta * specimen.omega_n, 1 / (fs * substeps)

    def slope(state: Array, u: Array) -> Array:
        y, v, memory = state[0], state[1], state[2:]
        a = u - c * v - k * y - specimen.spring(y) - memory.sum(axis=0)
        return np.concatenate([[v, a], specimen.rate(y, v, memory)])

    u = force(0.0)
    state = np.zeros((2 + specimen.memories, len(u)))
    found = np.zeros((2, len(u), num_samples))
    for n in range(num_samples):
        found[:, :, n] = state[:2]
        for i in range(substeps):
            t = n / fs + i * h
            half, whole = force(t + h / 2), force(t + h)
            k1 = slope(state, u)
            k2 = slope(state + h / 2 * k1, half)
            k3 = slope(state + h / 2 * k2, half)
            k4 = slope(state + h * k3, whole)
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            if specimen.limits is not None:
                state[2:] = np.clip(state[2:], -specimen.limits, specimen.limits)
            u = whole
    return found[0], found[1]


@dataclass(frozen=True)
class Sweeps:
    """Sweeps of several levels from rest, faded in and out, and the decay after them."""

    levels: tuple[float, ...] = (0.01, 0.03, 0.08)  # peak of the source [V]
    band_hz: tuple[float, float] = (12.0, 26.0)  # from and to [Hz]
    burst: float = 6.0  # length of the sweep [s]
    duration: float = 8.0  # length of the record [s]
    kind = "sweep"

    def source(self, t: float) -> Array:
        """Voltage of every level at a time."""
        if not 0 < t < self.burst:
            return np.zeros(len(self.levels))
        first, last = self.band_hz
        phase = 2 * np.pi * (first * t + (last - first) / self.burst * t**2 / 2)
        envelope = np.sin(np.pi / 2 * min(t, self.burst - t, 0.3) / 0.3) ** 2
        return envelope * np.sin(phase) * np.array(self.levels)


@dataclass(frozen=True)
class Noise:
    """Random excitation, by a sum of lines between two frequencies."""

    levels: tuple[float, ...] = (0.01,)  # rms of the source [V]
    band_hz: tuple[float, float] = (14.0, 24.0)  # [Hz]
    duration: float = 64.0  # length of the record [s]
    kind = "noise"

    def source(self, t: float) -> Array:
        """Voltage of every level at a time."""
        omega, phase = _lines(*self.band_hz)
        return np.sqrt(2 / NOISE_LINES) * np.sin(omega * t + phase).sum() * np.array(self.levels)


@cache
def _lines(first: float, last: float) -> tuple[Array, Array]:
    """Frequencies [rad/s] and phases of the lines of random excitation."""
    rng = np.random.default_rng(7)
    omega = 2 * np.pi * (first + (last - first) * rng.random(NOISE_LINES))
    return omega, 2 * np.pi * rng.random(NOISE_LINES)


@dataclass(frozen=True)
class Decays:
    """Free decays, recorded from the end of a burst at one frequency."""

    levels: tuple[float, ...] = (0.003, 0.02)  # peak of the source during the burst [V]
    tone_hz: float = 18.7  # of the burst [Hz]
    burst: float = 3.0  # its length, before the record [s]
    duration: float = 6.0  # length of the record [s]
    kind = "decay"

    def source(self, t: float) -> Array:
        """Voltage of every level at a time from the start of the burst."""
        if not 0 < t < self.burst:
            return np.zeros(len(self.levels))
        envelope = np.sin(np.pi / 2 * min(t, self.burst - t, 0.1) / 0.1) ** 2
        return envelope * np.sin(2 * np.pi * self.tone_hz * t) * np.array(self.levels)


Excitation = Sweeps | Noise | Decays


def taken(
    specimen: Specimen,
    excitation: Excitation,
    *,
    gain: float,
    fs: float,
    repeats: int,
    noise_std: float,
    seed: int,
    delay: float = 0.0,
) -> list[Test]:
    """Tests of every level, with white noise on the velocity of each repeat.

    Args:
        specimen: Oscillator and joint.
        excitation: What the source plays.
        gain: Force per unit modal mass of one volt [N/kg/V].
        fs: Sampling frequency [Hz].
        repeats: Records a level.
        noise_std: Of the velocity [m/s].
        seed: Of the noise.
        delay: Lag of the velocity channel, which nothing states [s].
    """
    lead = getattr(excitation, "burst", 0.0) if excitation.kind == "decay" else 0.0
    skip, size = round(lead * fs), round((lead + excitation.duration) * fs)
    late = round(delay * fs)
    drive = excitation.source
    _, velocity = respond(specimen, lambda t: gain * drive(t), size, fs)
    volts = np.stack([drive(n / fs) for n in range(size)], axis=1)
    rng = np.random.default_rng(seed)
    made = []
    for level, u, v in zip(excitation.levels, volts, velocity, strict=True):
        shifted = np.concatenate([np.zeros(late), v])[:size]
        records = []
        for _ in range(repeats):
            noisy = shifted + noise_std * rng.standard_normal(size)
            channels, units = {"velocity": noisy[skip:]}, {"velocity": "m/s"}
            if excitation.kind != "decay":
                channels, units = {"input": u, **channels}, {"input": "V", **units}
            records.append(Record(fs, channels, units))
        stated: dict[str, Any] = {}
        if excitation.kind == "decay":
            stated = {"band_hz": (14.0, 24.0), "settle": 0.1}
        elif excitation.kind == "noise":
            stated = {"band_hz": (16.5, 21.5)}
        name = f"{excitation.kind}_{level:g}".replace(".", "p")
        made.append(Test(excitation.kind, tuple(records), name, level=level, **stated))
    return made
