"""What is measured on the rig: the paper's cantilever, its tests and three ways to drive it.

`laboratory` (the default) has a gain of 15 N/kg per volt, so that the three sweeps meet weak,
middle and strong hysteresis (peaks of 1.4, 2.8 and 5.4 mm), and probes with 0.60 V.

`paper` has a gain of 60 N/kg per volt and the paper's voltages throughout. Then already the sweep
of 0.05 V drives the joint to 5 mm, where z is saturated (delta y = 1.8), and that of 0.20 V to
21 mm: its lowest level is the strongest of `laboratory`. Held tones at resonance reach 16 to 80 mm.

`mixed` is a short campaign of many kinds of test, with the shaker's force measured in newtons, so
that one factor, one over the modal mass, serves the shaken tests and the forced loop alike. No kind
is measured well enough to do without the others: noise knows the linear joint, tones near a third
of the resonance its third harmonic, the stepped sine and the sweeps all of it, decays what it
dissipates, and the loop its stiffness without the resonance.
"""

import difflib
from collections.abc import Iterable, Mapping
from types import MappingProxyType

import numpy as np

from jbw.errors import ConfigError
from jbw.oscillator.laws import law_named
from jbw.oscillator.oscillator import BoucWen, Oscillator
from jbw.rig.plans import (
    Plan,
    Preset,
    decay_plan,
    loop_plan,
    noise_plan,
    pull_plan,
    short_stepped_plan,
    short_sweep_plan,
    short_tone_plan,
    stepped_plan,
    sweep_plan,
    tone_plan,
)

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
"""Another specimen of the same size: three sliders, from the weakest sweep to the strongest."""

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
MODAL_MASS = 1.93
"""Of the cantilever's first mode, at the point of the shaker [kg]."""
MIXED_TONES = tuple((f, level) for level in (6.0, 12.0, 18.0) for f in (5.5, 6.5))
"""Probing tones of `mixed` [Hz], [N]."""


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
    plans=(
        noise_plan(0.15, duration=128.0, unit="N"),
        *(short_tone_plan(frequency, level) for frequency, level in MIXED_TONES),
        short_stepped_plan(0.15),
        *(short_sweep_plan(level) for level in (1.5, 3.0, 6.0)),
        *(decay_plan(level) for level in (0.3, 1.0)),
        pull_plan(4e-3),
    ),
)
PRESETS: Mapping[str, Preset] = MappingProxyType({p.name: p for p in (LABORATORY, PAPER, MIXED)})


def preset_named(preset: str | Preset) -> Preset:
    """A preset by its name, or a preset of one's own as it is.

    Raises:
        ConfigError: For an unknown name.
    """
    if isinstance(preset, Preset):
        return preset
    if preset not in PRESETS:
        known = ", ".join(f'"{name}"' for name in PRESETS)
        raise ConfigError(f'Argument `preset` must be one of {known}, but is "{preset}".')
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
