"""Comments in the campaign files of the virtual rig."""

HEAD = """\
# A campaign of the virtual rig. Each [[test]] is one excitation; each of its files is a repeat.
# Voltages and forces are those at the shaker. The gain to N/kg, or the modal mass, is not given:
# the identification finds it. Files of shaken tests also contain `demand`, the signal that was
# sent to the source. truth.json contains the true parameters, only to judge the result.
"""
IDENTIFY = "# Chosen before any fit: the tests that are fitted; the others are predicted."
PRIOR = "# Priors: the bounds of a uniform distribution in SI, or another distribution."
PURPOSE = {
    "noise": "White noise: natural frequency, damping and gain (Step 2).",
    "tone": (
        "Probing tone near a third of the natural frequency: third-order kernel Y(3 omega) "
        "(Step 3)."
    ),
    "sweep": "Sweep from rest, then free decay: all parameters (Step 4).",
    "stepped": "Stepped sine, one frequency after another, for verification of the FRF.",
    "loop": "Tone near resonance: hysteresis loops, for validation.",
    "multisine": "Multisine in whole periods of steady motion: all parameters.",
    "decay": "Free decay after a burst: softening and dissipation, without any force.",
    "pull": "Loop under a prescribed displacement: stiffness and hysteretic force.",
    "curve": "Response curve; a controller holds the amplitude of the response.",
    "backbone": "Phase-locked backbone: frequency, force and amplitude at phase resonance.",
    "phase": "Points at a phase other than that of resonance, held by a controller.",
    "s": "S-curve: the force that holds each amplitude at one frequency.",
}
"""The purpose of each kind of test, by the beginning of its name."""
