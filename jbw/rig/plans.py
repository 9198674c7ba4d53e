"""Tests as they are planned: what is played, how often, and what the campaign says of it."""

from dataclasses import dataclass

import numpy as np

from jbw.rig.generator import Excitation, Noise, Steps, Sweep, Tone
from jbw.rig.prescribed_motion import Growth, Held

LOOP_HZ = 18.5
"""Tone of the loops: resonance with the joint sliding, just below it with the joint sticking."""
STEPPED_HZ = tuple(
    float(f)
    for f in np.concatenate(
        [np.arange(3.0, 17.0, 2.0), [17.0], np.arange(17.5, 19.5, 0.0625), np.arange(20.0, 24.0)]
    )
)
"""Frequencies of the stepped sine, dense at the resonance; whole periods in each dwell [Hz]."""

RESONANCE_HZ = (17.5, 18.0, 18.25, 18.5, 18.625, 18.75, 18.875, 19.0, 19.5)
"""Frequencies of a short stepped sine, and of a curve whose response is held [Hz]."""
BURST_HZ = 18.6
"""Tone of the burst before a free decay [Hz]."""


@dataclass(frozen=True)
class Plan:
    """One test as planned.

    Attributes:
        name: Name of the test and of its files.
        kind: Kind of the campaign's test.
        excitation: What the generator plays, or what the joint is taken through.
        repeats: How many records.
        band_hz: Band to use in the identification [Hz], when it should be stated.
        settle: Time to discard after the start of each step [s].
    """

    name: str
    kind: str
    excitation: Excitation | Growth | Held
    repeats: int
    band_hz: tuple[float, float] | None = None
    settle: float = 0.0


@dataclass(frozen=True)
class Preset:
    """A rig and its programme.

    Attributes:
        name: Name of the preset.
        gain: Force per unit mass and volt [N/kg/V], or per newton: one over the modal mass [1/kg].
        input_range: Full scale of the recorded source, a power of two [V or N].
        velocity_range: Full scale of the laser, a power of two [m/s].
        plans: The tests.
        source: What is recorded of the source: its `input` in volts, or the shaker's `force`.
        source_noise_std: Noise of that channel [V or N].
        displacement_range: Full scale of prescribed displacements, a power of two [m].
        force_range: Full scale of restoring forces, a power of two [N].
        fit: Kinds that the joint posterior is fitted to, the others verify; all when empty.
    """

    name: str
    gain: float
    input_range: float
    velocity_range: float
    plans: tuple[Plan, ...]
    source: str = "input"
    source_noise_std: float = 0.5e-6
    displacement_range: float = 1 / 64
    force_range: float = 512.0
    fit: tuple[str, ...] = ()

    @property
    def source_unit(self) -> str:
        """Unit of the recorded source."""
        return "V" if self.source == "input" else "N"


def named(kind: str, level: float, unit: str = "V") -> str:
    """A test's name after its level: "sweep_0p05V", "noise_0p005V", no dot in it."""
    return f"{kind}_{label(level, 2 if round(level, 2) == level else 3)}{unit}"


def label(value: float, digits: int) -> str:
    """0.05 as "0p05"."""
    return f"{value:.{digits}f}".replace(".", "p")


def noise_plan(level: float, duration: float = 512.0, unit: str = "V") -> Plan:
    """White noise for Step 2, after 16 s of settling, four repeats."""
    excitation = Noise(level, duration, settle=16.0)
    return Plan(named("noise", level, unit), "noise", excitation, repeats=4, band_hz=(17.0, 20.5))


def tone_plan(frequency_hz: float, level: float) -> Plan:
    """A probing tone for Step 3: 64 s after 64 s of settling, eight repeats."""
    excitation = Tone(frequency_hz, level, duration=64.0, settle=64.0)
    return Plan(f"tone_{label(frequency_hz, 2)}Hz", "tones", excitation, repeats=8)


def short_tone_plan(frequency_hz: float, level: float) -> Plan:
    """A tone near a third of the resonance: 16 s after 32 s of settling, four repeats."""
    excitation = Tone(frequency_hz, level, duration=16.0, settle=32.0)
    name = named(f"tone_{label(frequency_hz, 2)}Hz", level, "N")
    return Plan(name, "tones", excitation, repeats=4)


def sweep_plan(level: float) -> Plan:
    """A sweep for Step 4: 0-40 Hz in 8 s from rest, 8 s of decay, 48 repeats."""
    excitation = Sweep(0.0, 40.0, level, burst=8.0, fade=0.2, duration=16.0)
    return Plan(named("sweep", level), "sweep", excitation, repeats=48)


def short_sweep_plan(level: float) -> Plan:
    """A sweep from rest: 10-30 Hz in 6 s, 4 s of decay, six repeats."""
    excitation = Sweep(10.0, 30.0, level, burst=6.0, fade=0.2, duration=10.0)
    return Plan(named("sweep", level, "N"), "sweep", excitation, repeats=6)


def stepped_plan(level: float) -> Plan:
    """A stepped sine: 3-23 Hz, 32 s a step of which 24 s settle, two repeats.

    In 24 s a transient falls to 3e-6 of the change between two steps.
    """
    excitation = Steps(STEPPED_HZ, level, dwell=32.0)
    return Plan(named("stepped", level), "stepped", excitation, repeats=2, settle=24.0)


def short_stepped_plan(level: float) -> Plan:
    """A stepped sine through the resonance: 24 s a step of which 20 s settle, two repeats."""
    excitation = Steps(RESONANCE_HZ, level, dwell=24.0)
    return Plan(named("stepped", level, "N"), "stepped", excitation, repeats=2, settle=20.0)


def loop_plan(level: float) -> Plan:
    """A tone near resonance for loops: 16 s after 32 s of settling, four repeats."""
    excitation = Tone(LOOP_HZ, level, duration=16.0, settle=32.0)
    return Plan(named("loop", level), "tones", excitation, repeats=4)


def decay_plan(level: float) -> Plan:
    """Free decay of 10 s after a burst of 6 s at resonance, two repeats."""
    excitation = Sweep(BURST_HZ, BURST_HZ, level, burst=6.0, fade=0.1, duration=10.0, settle=6.0)
    return Plan(named("decay", level, "N"), "decay", excitation, repeats=2, band_hz=(15.0, 22.0))


def pull_plan(level: float) -> Plan:
    """A loop under a prescribed displacement that grows in 6 s at 1 Hz, two repeats."""
    excitation = Growth(1.0, level, duration=6.0)
    return Plan(named("pull", 1e3 * level, "mm"), "loop", excitation, repeats=2)


def curve_plan(level: float) -> Plan:
    """A response curve whose controller holds the displacement, two repeats."""
    excitation = Held(RESONANCE_HZ, level, dwell=4.0)
    return Plan(named("curve", 1e3 * level, "mm"), "frf", excitation, repeats=2)
