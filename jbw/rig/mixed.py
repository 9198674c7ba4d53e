"""A short campaign of many kinds of test on one joint, the shaker's force measured in newtons.

So one factor, one over the modal mass, serves the shaken tests and the forced loop alike. No kind
is measured well enough to do without the others: noise knows the linear joint, tones near a third
of the resonance its third harmonic, the stepped sine and the sweeps all of it, decays what it
dissipates, and the loop its stiffness without the resonance.
"""

from jbw.rig.generator import Multisine, Noise, Steps, Sweep, Tone
from jbw.rig.machine import Growth, Held
from jbw.rig.plans import Plan, Preset, label, named

MODAL_MASS = 1.93
"""Of the cantilever's first mode, at the point of the shaker [kg]."""
PROBING_HZ = (5.5, 6.5)
PROBING_LEVELS = (6.0, 12.0, 18.0)
STEPPED_HZ = (17.5, 18.0, 18.25, 18.5, 18.625, 18.75, 18.875, 19.0, 19.5)
BURST_HZ = 18.6
BAND_HZ = (17.0, 20.5)


def noise_plan(level: float) -> Plan:
    """Weak white noise: 128 s after 16 s of settling, four repeats."""
    excitation = Noise(level, duration=128.0, settle=16.0)
    return Plan(named("noise", level, "N"), "noise", excitation, repeats=4, band_hz=BAND_HZ)


def multisine_plan(level: float) -> Plan:
    """Lines from 16 to 21 Hz, 8 periods of 8 s after 24 s of settling, two repeats."""
    excitation = Multisine(level, period=8.0, low_hz=16.0, high_hz=21.0, periods=8, settle=24.0)
    name = named("multisine", level, "N")
    return Plan(name, "multisine", excitation, repeats=2, band_hz=BAND_HZ)


def tone_plan(frequency_hz: float, level: float) -> Plan:
    """A tone near a third of the resonance: 16 s after 32 s of settling, four repeats."""
    excitation = Tone(frequency_hz, level, duration=16.0, settle=32.0)
    name = named(f"tone_{label(frequency_hz, 2)}Hz", level, "N")
    return Plan(name, "tones", excitation, repeats=4)


def stepped_plan(level: float) -> Plan:
    """A stepped sine through the resonance: 24 s a step of which 20 s settle, two repeats."""
    excitation = Steps(STEPPED_HZ, level, dwell=24.0)
    return Plan(named("stepped", level, "N"), "stepped", excitation, repeats=2, settle=20.0)


def sweep_plan(level: float) -> Plan:
    """A sweep from rest: 10-30 Hz in 6 s, 4 s of decay, six repeats."""
    excitation = Sweep(10.0, 30.0, level, burst=6.0, fade=0.2, duration=10.0)
    return Plan(named("sweep", level, "N"), "sweep", excitation, repeats=6)


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
    excitation = Held(STEPPED_HZ, level, dwell=4.0)
    return Plan(named("curve", 1e3 * level, "mm"), "frf", excitation, repeats=2)


MIXED = Preset(
    name="mixed",
    gain=1.0 / MODAL_MASS,
    input_range=32.0,
    velocity_range=2.0,
    source="force",
    source_noise_std=50e-6,
    plans=(
        noise_plan(0.15),
        *(tone_plan(frequency, level) for level in PROBING_LEVELS for frequency in PROBING_HZ),
        stepped_plan(0.15),
        *(sweep_plan(level) for level in (1.5, 3.0, 6.0)),
        *(decay_plan(level) for level in (0.3, 1.0)),
        pull_plan(4e-3),
    ),
)
