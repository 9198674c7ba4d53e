"""The measurements on the rig: a cantilever (Teloli et al.), its tests, six ways to measure it.

`everyday` is a working day of a laboratory: the structure is reassembled on each of three days,
between which omega_n varies by 0.18 % as in Teloli et al. and zeta by 3 %. The laser adds 2 % of
noise to every record. The tests are noise and sweeps at three levels, a free decay and a steady
tone for verification, without probing tones.

`laboratory` (the default) is the programme of Teloli et al., with almost noise-free records. Its
gain is 15 N/kg per volt, so that the three sweeps cause weak, medium and strong hysteresis (peaks
of 1.4, 2.8 and 5.4 mm), and it probes with 0.60 V.

`paper` has a gain of 60 N/kg per volt and the published voltages throughout. Already the sweep of
0.05 V then drives the joint to 5 mm, where z is saturated (delta y = 1.8), and that of 0.20 V to 21
mm: its lowest level equals the strongest of `laboratory`. Steady tones at resonance reach 16 to 80
mm.

`mixed` is a short campaign of many kinds of test, with the shaker's force measured in newtons, so
that one factor, one / modal mass, applies to the shaken tests and the forced loop alike. No
kind is measured well enough to be sufficient alone: noise determines the linear joint, tones near a
third of the resonance its third harmonic, the stepped sine and the sweeps the whole joint, decays
the dissipation, and the loop the stiffness without the resonance.

`controlled` is an afternoon with a controller and a measured shaker force: a phase-locked backbone
and points at another phase, both controlled to half a degree, an S-curve, and free decays.

`modes` is a structure of three modes with the published joint across it, and a shaker whose
armature moves with the structure: tests about the first mode by measured force, tests by voltage,
and a decay with the amplifier at zero volts. The key `drive` of each test says what drives it.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jbw.errors import ConfigError, did_you_mean
from jbw.oscillator.laws import law_named
from jbw.oscillator.oscillator import BoucWen, Oscillator
from jbw.rig.generator import Excitation, Noise, Steps, Sweep, Tone
from jbw.rig.prescribed_motion import Growth, Held, HeldPoints, Locked, s_curve
from jbw.rig.structure import Armature, Shapes

TRUTH = BoucWen(omega_n=2 * np.pi * 18.8, zeta=0.00444, alpha=497.40, delta=340.21, gamma=32.84)
"""The cantilever of the paper, Table 1 (the identified values, taken as the truth)."""

SLIDERS = Oscillator(
    omega_n=2 * np.pi * 18.8,
    zeta=0.00444,
    laws=(
        law_named("jenkins_3").build(
            {
                "stiffness_1": 200.0, "slip_1": 0.3e-3,
                "stiffness_2": 200.0, "slip_2": 1.2e-3,
                "stiffness_3": 100.0, "slip_3": 4.0e-3,
            }
        ),
    ),
)  # fmt: skip
"""A cantilever with the frequency and damping of `TRUTH`; its joint has three sliders.

The sliders begin to slip at 0.3, 1.2 and 4 mm, so that a stronger sweep makes more sliders slip.
"""

PRIOR: Mapping[str, tuple[float, float]] = {
    "zeta": (0.00352, 0.00528),
    "alpha": (424.31, 589.61),
    "delta": (272.80, 409.92),
    "gamma": (17.0, 41.0),
}
"""Bounds of the paper's uniform priors: zeta, alpha and delta of Step 3, gamma of Step 4 [SI]."""

PROBING_HZ = (5.0, 5.5, 6.0, 6.5, 6.75)  # frequencies of the probing tones, around omega_n / 3 [Hz]
# frequency of the tone for loops [Hz]: the resonance of the sliding joint, just below that of the
# fully stuck joint
LOOP_HZ = 18.5
# Frequencies of the stepped sine, closely spaced at the resonance, each for a whole number of
# periods.
STEPPED_HZ: tuple[float, ...] = tuple(
    np.concatenate(
        [np.arange(3.0, 18.0, 2.0), np.arange(17.5, 19.5, 0.0625), np.arange(20.0, 24.0)]
    ).tolist()
)
# frequencies of a short stepped sine [Hz]
RESONANCE_HZ = (17.5, 18.0, 18.25, 18.5, 18.625, 18.75, 18.875, 19.0, 19.5)
BURST_HZ = 18.6  # frequency of the tone before a free decay [Hz]
MODAL_MASS = 1.93  # modal mass of the cantilever's first mode, at the point of the shaker [kg]


@dataclass(frozen=True)
class Plan:
    """A planned test."""

    name: str  # name of the test and of its files
    kind: str  # kind of the campaign's test
    # the signal of the generator, or the prescribed motion of the joint
    excitation: Excitation | Growth | Held | Locked | HeldPoints
    repeats: int  # number of records
    # Band to state for the identification [Hz], if any.
    band_hz: tuple[float, float] | None = None
    settle: float = 0.0  # time to discard after the start of each step [s]
    drive: str = ""  # drive of the test, if the rig has an armature
    # Channels recorded in addition to the velocity: input, force, drive_point.
    sources: tuple[str, ...] = ()


@dataclass(frozen=True)
class Preset:
    """A virtual rig with its programme of tests."""

    name: str  # name of the preset
    # Force per unit mass and volt [N/kg/V]; for a source in newtons, the reciprocal of the modal
    # mass [1/kg].
    gain: float
    input_range: float  # full scale of the recorded source, a power of two [V or N]
    velocity_range: float  # full scale of the laser, a power of two [m/s]
    plans: tuple[Plan, ...]  # the tests
    # The recorded channel of the source: its `input` in volts, or the shaker's `force`.
    source: str = "input"
    source_noise_std: float = 0.5e-6  # noise of the source's recorded channel [V or N]
    displacement_range: float = 1 / 64  # full scale of prescribed displacements, a power of two [m]
    force_range: float = 512.0  # full scale of restoring forces, a power of two [N]
    # Kinds of test to which the joint posterior is fitted (all if empty); other kinds are for
    # comparison.
    fit: tuple[str, ...] = ()
    # Disturbances of the records, unless `measure` is called with other values.
    noise_std: float = 50e-6  # laser noise [m/s]
    # Laser noise relative to the rms of each record, instead of `noise_std` [-].
    noise_ratio: float | None = None
    omega_n_cv: float = 0.0  # coefficient of variation of omega_n from day to day [-]
    zeta_cv: float = 0.0  # coefficient of variation of zeta from day to day [-]
    # Shapes of several modes, beginning with the joint's mode, if an armature drives them.
    shapes: Shapes | None = None
    armature: Armature = field(default_factory=Armature)


def named(kind: str, level: float, unit: str = "V") -> str:
    """Return the name of a test with its level: "sweep_0p05V", "noise_0p005V", without a dot."""
    digits = 2 if round(level, 2) == level else 3
    return f"{kind}_{level:.{digits}f}{unit}".replace(".", "p")


def _plan(
    prefix: str, kind: str, excitation: Excitation, repeats: int, unit: str = "V", **stated: Any
) -> Plan:
    return Plan(named(prefix, excitation.level, unit), kind, excitation, repeats, **stated)


def _noise(level: float, duration: float, unit: str) -> Plan:
    excitation = Noise(level, duration, settle=16.0)
    return _plan("noise", "noise", excitation, 4, unit, band_hz=(17.0, 20.5))


def sweep_plan(level: float) -> Plan:
    """Return a sweep from rest, 0-40 Hz in 8 s, followed by 8 s of free decay."""
    excitation = Sweep(0.0, 40.0, level, burst=8.0, fade=0.2, duration=16.0)
    return _plan("sweep", "sweep", excitation, 48)


def stepped_plan(level: float) -> Plan:
    """Return a stepped sine; its 24 s of settling reduce transients to 3e-6 of a step's change."""
    return _plan("stepped", "stepped", Steps(STEPPED_HZ, level, dwell=32.0), 2, settle=24.0)


def pull_plan(level: float) -> Plan:
    """Return a loop whose prescribed displacement grows for 6 s at 1 Hz."""
    excitation = Growth(1.0, level, duration=6.0)
    return Plan(named("pull", 1e3 * level, "mm"), "loop", excitation, repeats=2)


def _programme(
    probing: float, stepped: tuple[float, ...], loops: tuple[float, ...]
) -> tuple[Plan, ...]:
    tones = (Tone(f, probing, duration=64.0, settle=64.0) for f in PROBING_HZ)
    held = (Tone(LOOP_HZ, level, duration=16.0, settle=32.0) for level in loops)
    return (
        *(_noise(level, 512.0, "V") for level in (0.05, 0.005)),
        *(Plan(named("tone", tone.frequency_hz, "Hz"), "tones", tone, repeats=8) for tone in tones),
        *(sweep_plan(level) for level in (0.05, 0.10, 0.20)),
        *(stepped_plan(level) for level in stepped),
        *(_plan("loop", "tones", tone, 4) for tone in held),
    )


def _short_programme() -> tuple[Plan, ...]:
    """Return plans of short tests of many kinds, with levels in newtons."""
    probing = ((f, level) for level in (6.0, 12.0, 18.0) for f in (5.5, 6.5))
    tones = (Tone(f, level, duration=16.0, settle=32.0) for f, level in probing)
    sweeps = (
        Sweep(10.0, 30.0, level, burst=6.0, fade=0.2, duration=10.0) for level in (1.5, 3.0, 6.0)
    )
    bursts = (
        Sweep(BURST_HZ, BURST_HZ, level, burst=6.0, fade=0.1, duration=10.0, settle=6.0)
        for level in (0.3, 1.0)
    )
    return (
        _noise(0.15, 128.0, "N"),
        *(_plan(named("tone", tone.frequency_hz, "Hz"), "tones", tone, 4, "N") for tone in tones),
        _plan("stepped", "stepped", Steps(RESONANCE_HZ, 0.15, dwell=24.0), 2, "N", settle=20.0),
        *(_plan("sweep", "sweep", sweep, 6, "N") for sweep in sweeps),
        *(_plan("decay", "decay", burst, 2, "N", band_hz=(15.0, 22.0)) for burst in bursts),
        pull_plan(4e-3),
    )


def _controlled_programme() -> tuple[Plan, ...]:
    """Return plans of controlled tests, with 100 periods per point, and of two free decays."""
    levels = tuple(np.geomspace(2e-4, 6e-3, 14).tolist())
    bursts = [Sweep(BURST_HZ, BURST_HZ, v, burst=6.0, fade=0.1, duration=10.0, settle=6.0)
              for v in (0.1, 0.4)]  # fmt: skip
    return (
        Plan("backbone", "backbone", Locked(levels), repeats=2),
        Plan("phase_60", "backbone", Locked(levels, phase=-60.0), repeats=2),
        Plan("s_curve", "curve", s_curve(LOOP_HZ, levels), repeats=2),
        *(_plan("decay", "decay", burst, 2, "N", band_hz=(15.0, 22.0)) for burst in bursts),
    )


def _everyday_programme(days: int = 3) -> tuple[Plan, ...]:
    """Return plans of a morning's tests (records of 10 s to 6 min), repeated on each day."""
    sweeps = (Sweep(10.0, 30.0, v, burst=6.0, fade=0.2, duration=10.0) for v in (0.05, 0.10, 0.20))
    burst = Sweep(BURST_HZ, BURST_HZ, 0.05, burst=6.0, fade=0.1, duration=10.0, settle=6.0)
    held = Tone(LOOP_HZ, 0.05, duration=16.0, settle=32.0)
    return (
        _plan("noise", "noise", Noise(0.005, 384.0, settle=16.0), days, band_hz=(17.0, 20.5)),
        *(_plan("sweep", "sweep", sweep, days) for sweep in sweeps),
        _plan("decay", "decay", burst, days, band_hz=(15.0, 22.0)),
        _plan("loop", "tones", held, days),
    )


def _modes_programme() -> tuple[Plan, ...]:
    """Return plans of tests of the first mode, driven by a shaker's force and by its voltage."""
    near = (12.0, 26.0)
    every, cell = ("input", "force", "drive_point"), ("force",)
    sweeps = [Sweep(10.0, 30.0, v, burst=6.0, fade=0.2, duration=10.0) for v in (0.02, 0.06, 0.2)]
    burst = Sweep(BURST_HZ, BURST_HZ, 0.05, burst=6.0, fade=0.1, duration=10.0, settle=6.0)
    by_force = {"drive": "force", "sources": cell}
    by_voltage = {"drive": "voltage", "sources": every, "band_hz": near}
    return (
        Plan("noise_force", "noise", Noise(0.003, 128.0, settle=16.0), 3, (17.0, 20.5), **by_force),
        *(
            Plan(f"sweep_force_{i}", "sweep", sweep, 3, near, **by_force)
            for i, sweep in enumerate(sweeps, start=1)
        ),
        *(_plan("sweep", "sweep", sweep, 3, **by_voltage) for sweep in sweeps[::2]),
        Plan("decay_shaker", "decay", burst, 3, (15.0, 22.0), drive="voltage"),
    )


EVERYDAY = Preset(
    name="everyday",
    gain=15.0,
    input_range=1.0,
    velocity_range=2.0,
    plans=_everyday_programme(),
    fit=("noise", "sweep"),
    noise_ratio=0.02,
    omega_n_cv=0.0018,
    zeta_cv=0.03,
)
LABORATORY = Preset(
    name="laboratory",
    gain=15.0,
    input_range=1.0,
    velocity_range=2.0,
    plans=_programme(0.60, stepped=(0.005, 0.02, 0.05), loops=(0.02, 0.05, 0.10)),
    fit=("noise", "sweep"),
)
PAPER = Preset(
    name="paper",
    gain=60.0,
    input_range=1.0,
    velocity_range=16.0,
    plans=_programme(0.15, stepped=(0.05, 0.10, 0.20), loops=(0.05, 0.10, 0.20)),
    fit=("noise", "sweep"),
)
MIXED = Preset(
    name="mixed",
    gain=1.0 / MODAL_MASS,
    input_range=32.0,
    velocity_range=2.0,
    source="force",
    source_noise_std=50e-6,
    plans=_short_programme(),
)
MODES = Preset(
    name="modes",
    gain=20.0,
    input_range=1.0,
    velocity_range=2.0,
    plans=_modes_programme(),
    noise_ratio=0.02,
    shapes=Shapes(
        omega=2 * np.pi * np.array([18.8, 57.2, 131.0]), zeta=np.array([0.00444, 0.006, 0.008]),
        drive=np.array([0.7, 0.9, 0.4]), joint=np.array([1.0, -0.8, 0.5]),
        output=np.array([1.0, 0.7, -0.6]),
    ),
    armature=Armature(gain=20.0, mass=0.01, damping=1.2, stiffness=300.0),
)  # fmt: skip
CONTROLLED = Preset(
    name="controlled",
    gain=1.0 / MODAL_MASS,
    input_range=32.0,
    velocity_range=2.0,
    source="force",
    source_noise_std=50e-6,
    plans=_controlled_programme(),
)
PRESETS = {
    preset.name: preset for preset in (EVERYDAY, LABORATORY, PAPER, MIXED, MODES, CONTROLLED)
}


def preset_named(preset: str | Preset) -> Preset:
    """Return the preset of a name; return a `Preset` object unchanged."""
    if isinstance(preset, Preset):
        return preset
    if preset not in PRESETS:
        names = ", ".join(f'"{name}"' for name in PRESETS)
        raise ConfigError(f'Argument `preset` must be one of {names}, but is "{preset}".')
    return PRESETS[preset]


def plans_named(preset: Preset, names: Iterable[str] | None) -> list[Plan]:
    """Return the plans with the given names in the order of the preset, or all if None."""
    if names is None:
        return list(preset.plans)
    requested = [names] if isinstance(names, str) else list(names)
    planned = [plan.name for plan in preset.plans]
    if not requested:
        raise ConfigError("Argument `tests` must name at least one test, but is empty.")
    for name in requested:
        if name not in planned:
            raise ConfigError(
                f'Argument `tests` must name planned tests, but no planned test is named "{name}".',
                remedy=did_you_mean(name, planned) + f"Planned tests: {', '.join(planned)}.",
            )
    return [plan for plan in preset.plans if plan.name in requested]
