"""The test programmes of `panel.py`: sweeps, noise or decays at several levels."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from jbw import Record, Test

from .simulator import Array, Plant, march, substeps_of

NOISE_LINES = 400  # number of spectral lines of random excitation


def bouc_wen(
    omega_n: float, zeta: float, alpha: float, delta: float, gamma: float, nu: float = 1.0,
    cubic: float = 0.0,
) -> Plant:  # fmt: skip
    """Return a mode with a Bouc-Wen joint and a cubic spring."""
    return Plant(omega_n, zeta, alpha=alpha, delta=delta, gamma=gamma, nu=nu, cubic=cubic)


def sliders(omega_n: float, zeta: float, springs: Sequence[float], slips: Sequence[float]) -> Plant:
    """Return a mode with Jenkins elements, given by stiffness [1/s^2] and slip displacement [m]."""
    forces = tuple(np.array(springs) * np.array(slips))
    return Plant(omega_n, zeta, springs=tuple(springs), forces=forces)


def _faded(t: Array, burst: float, fade: float) -> Array:
    """Return an envelope that rises and falls as a sine squared, zero outside the burst."""
    inside = np.clip(np.minimum(t, burst - t), 0.0, fade)
    return np.sin(np.pi / 2 * inside / fade) ** 2


@dataclass(frozen=True)
class Sweeps:
    """Sweeps at several levels from rest, faded in and out, each with its decay."""

    levels: tuple[float, ...] = (0.01, 0.03, 0.08)  # peak of the source [V]
    band_hz: tuple[float, float] = (12.0, 26.0)  # first and last frequency [Hz]
    burst: float = 6.0  # length of the sweep [s]
    duration: float = 8.0  # length of the record [s]
    kind = "sweep"

    def source(self, t: Array) -> Array:
        """Return the voltage of the source at a level of one volt."""
        first, last = self.band_hz
        phase = 2 * np.pi * (first * t + (last - first) / self.burst * t**2 / 2)
        return _faded(t, self.burst, 0.3) * np.sin(phase)


@dataclass(frozen=True)
class Noise:
    """Random excitation as a sum of spectral lines between two frequencies."""

    levels: tuple[float, ...] = (0.01,)  # rms of the source [V]
    band_hz: tuple[float, float] = (14.0, 24.0)  # band of the lines [Hz]
    duration: float = 64.0  # length of the record [s]
    kind = "noise"

    def source(self, t: Array) -> Array:
        """Return the voltage of the source at a level of one volt."""
        lines = zip(*_lines(*self.band_hz), strict=True)
        return np.sqrt(2 / NOISE_LINES) * sum(np.sin(omega * t + phase) for omega, phase in lines)


@cache
def _lines(first: float, last: float) -> tuple[Array, Array]:
    """Return frequencies [rad/s] and phases of the spectral lines of random excitation."""
    rng = np.random.default_rng(7)
    omega = 2 * np.pi * (first + (last - first) * rng.random(NOISE_LINES))
    return omega, 2 * np.pi * rng.random(NOISE_LINES)


@dataclass(frozen=True)
class Decays:
    """Free decays, recorded from the end of a burst of sine on."""

    levels: tuple[float, ...] = (0.003, 0.02)  # peak of the source during the burst [V]
    tone_hz: float = 18.7  # frequency of the burst [Hz]
    burst: float = 3.0  # length of the burst, before the record [s]
    duration: float = 6.0  # length of the record [s]
    kind = "decay"

    def source(self, t: Array) -> Array:
        """Return the voltage of the source at a level of one volt, from the start of the burst."""
        return _faded(t, self.burst, 0.1) * np.sin(2 * np.pi * self.tone_hz * t)


Excitation = Sweeps | Noise | Decays


def taken(
    plant: Plant,
    excitation: Excitation,
    *,
    gain: float,
    fs: float,
    repeats: int,
    noise_std: float,
    seed: int,
    delay: float = 0.0,
) -> list[Test]:
    """Return tests at every level, with white noise on the velocity of each repeat.

    Args:
        plant: The mode and its joint, in SI.
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
    late, substeps = round(delay * fs), substeps_of(2 * np.pi * fs / plant.omega_n)
    fine = excitation.source(np.arange(2 * substeps * (size - 1) + 1) / (2 * substeps * fs))
    rng = np.random.default_rng(seed)
    made = []
    for level in excitation.levels:
        u, v = level * fine[:: 2 * substeps], march(plant, gain * level * fine, fs, substeps)[1]
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
