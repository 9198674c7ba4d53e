"""What is measured on the rig: the paper's cantilever, its tests and two ways to drive it.

`laboratory` (the default) has a gain of 15 N/kg per volt, so that the three sweeps meet weak,
middle and strong hysteresis (peaks of 1.4, 2.8 and 5.4 mm), and probes with 0.60 V.

`paper` has a gain of 60 N/kg per volt and the paper's voltages throughout. Then already the sweep
of 0.05 V drives the joint to 5 mm, where z is saturated (delta y = 1.8), and that of 0.20 V to
21 mm: its lowest level is the strongest of `laboratory`. Held tones at resonance reach 16 to 80 mm.
"""

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from jbw.errors import ConfigError
from jbw.oscillator.parameters import BoucWen
from jbw.rig.generator import Excitation, Noise, Steps, Sweep, Tone

TRUTH = BoucWen(omega_n=2 * np.pi * 18.8, zeta=0.00444, alpha=497.40, delta=340.21, gamma=32.84)
"""The cantilever of the paper, Table 1 (the identified values, taken as the truth)."""

PRIOR: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "zeta": (0.00352, 0.00528),
        "alpha": (425.0, 590.0),
        "delta": (272.0, 408.0),
        "gamma": (20.0, 48.0),
    }
)
"""The paper's boxes, as far as the stated bounds and coefficients of variation give them."""

PROBING_HZ = (5.0, 5.5, 6.0, 6.5, 6.75)
"""Probing tones, around omega_n / 3 [Hz]."""
LOOP_HZ = 18.5
"""Tone of the loops: resonance with the joint sliding, just below it with the joint sticking."""
STEPPED_HZ = tuple(
    float(f)
    for f in np.concatenate(
        [np.arange(3.0, 17.0, 2.0), [17.0], np.arange(17.5, 19.5, 0.0625), np.arange(20.0, 24.0)]
    )
)
"""Frequencies of the stepped sine, dense at the resonance; whole periods in each dwell [Hz]."""


@dataclass(frozen=True)
class Plan:
    """One test as planned.

    Attributes:
        name: Name of the test and of its files.
        kind: Kind of the campaign's test.
        excitation: What the generator plays.
        repeats: How many records.
        band_hz: Band to use in the identification [Hz], when it should be stated.
        settle: Time to discard after the start of each step [s].
    """

    name: str
    kind: str
    excitation: Excitation
    repeats: int
    band_hz: tuple[float, float] | None = None
    settle: float = 0.0


@dataclass(frozen=True)
class Preset:
    """A rig and its programme.

    Attributes:
        name: Name of the preset.
        gain: Force per unit mass and volt [N/kg/V].
        input_range: Full scale of the recorded input, a power of two [V].
        velocity_range: Full scale of the laser, a power of two [m/s].
        plans: The tests.
    """

    name: str
    gain: float
    input_range: float
    velocity_range: float
    plans: tuple[Plan, ...]


def _label(value: float, digits: int) -> str:
    """0.05 as "0p05": no dot in the name of a file."""
    return f"{value:.{digits}f}".replace(".", "p")


def _volts(level: float) -> str:
    """A level as in the names of tests: "0p05V", "0p005V"."""
    return _label(level, 2 if round(level, 2) == level else 3) + "V"


def noise_plan(level: float) -> Plan:
    """White noise for Step 2: 512 s after 16 s of settling, four repeats."""
    excitation = Noise(level, duration=512.0, settle=16.0)
    return Plan(f"noise_{_volts(level)}", "noise", excitation, repeats=4, band_hz=(17.0, 20.5))


def tone_plan(frequency_hz: float, level: float) -> Plan:
    """A probing tone for Step 3: 64 s after 64 s of settling, eight repeats."""
    excitation = Tone(frequency_hz, level, duration=64.0, settle=64.0)
    return Plan(f"tone_{_label(frequency_hz, 2)}Hz", "tones", excitation, repeats=8)


def sweep_plan(level: float) -> Plan:
    """A sweep for Step 4: 0-40 Hz in 8 s from rest, 8 s of decay, 48 repeats."""
    excitation = Sweep(0.0, 40.0, level, burst=8.0, fade=0.2, duration=16.0)
    return Plan(f"sweep_{_volts(level)}", "sweep", excitation, repeats=48)


def stepped_plan(level: float) -> Plan:
    """A stepped sine: 3-23 Hz, 32 s a step of which 24 s settle, two repeats.

    In 24 s a transient falls to 3e-6 of the change between two steps.
    """
    excitation = Steps(STEPPED_HZ, level, dwell=32.0)
    return Plan(f"stepped_{_volts(level)}", "stepped", excitation, repeats=2, settle=24.0)


def loop_plan(level: float) -> Plan:
    """A tone near resonance for loops: 16 s after 32 s of settling, four repeats."""
    excitation = Tone(LOOP_HZ, level, duration=16.0, settle=32.0)
    return Plan(f"loop_{_volts(level)}", "tones", excitation, repeats=4)


def _programme(
    probing: float, stepped: tuple[float, ...], loops: tuple[float, ...]
) -> tuple[Plan, ...]:
    return (
        *(noise_plan(level) for level in (0.05, 0.005)),
        *(tone_plan(frequency, probing) for frequency in PROBING_HZ),
        *(sweep_plan(level) for level in (0.05, 0.10, 0.20)),
        *(stepped_plan(level) for level in stepped),
        *(loop_plan(level) for level in loops),
    )


LABORATORY = Preset(
    name="laboratory",
    gain=15.0,
    input_range=1.0,
    velocity_range=2.0,
    plans=_programme(0.60, stepped=(0.005, 0.02, 0.05), loops=(0.02, 0.05, 0.10)),
)
PAPER = Preset(
    name="paper",
    gain=60.0,
    input_range=1.0,
    velocity_range=16.0,
    plans=_programme(0.15, stepped=(0.05, 0.10, 0.20), loops=(0.05, 0.10, 0.20)),
)
PRESETS: Mapping[str, Preset] = MappingProxyType({p.name: p for p in (LABORATORY, PAPER)})


def preset_named(preset: str | Preset) -> Preset:
    """A preset by its name, or a preset of one's own as it is.

    Raises:
        ConfigError: For an unknown name.
    """
    if isinstance(preset, Preset):
        return preset
    if preset not in PRESETS:
        known = " or ".join(f'"{name}"' for name in PRESETS)
        raise ConfigError(f'Argument `preset` must be {known}, but is "{preset}".')
    return PRESETS[preset]


def plans_named(preset: Preset, names: Iterable[str] | None) -> list[Plan]:
    """The plans with these names, in the order of the preset; all when None.

    Raises:
        ConfigError: For an unknown name, or none.
    """
    if names is None:
        return list(preset.plans)
    wanted = [names] if isinstance(names, str) else list(names)
    known = [plan.name for plan in preset.plans]
    if not wanted:
        raise ConfigError("Argument `tests` must name at least one test, but is empty.")
    for name in wanted:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1) or known
            raise ConfigError(
                f'Argument `tests` must name planned tests, but holds "{name}".',
                remedy=f"Did you mean {' or '.join(near)}?",
            )
    return [plan for plan in preset.plans if plan.name in wanted]
