"""Comments in the campaign files of the virtual rig."""

HEAD = """\
# A campaign of the virtual rig. Each [[test]] is one excitation repeated, one file a repeat.
# Voltages and forces are those at the shaker; the gain to N/kg, or the modal mass, is not given:
# the identification finds it. Files of shaken tests also hold `demand`, what was asked of the
# source. truth.json is for judging only.
"""
IDENTIFY = "# Fixed before any fit: what is fitted; the rest is predicted."
PRIOR = "# Priors: bounds of a uniform one in SI, or a distribution."
PURPOSE = {
    "noise": "White noise: natural frequency, damping and gain (Step 2).",
    "tone": "Probing tone near a third of the natural frequency: Y(3 omega) (Step 3).",
    "sweep": "Sweep from rest, then free decay: all parameters (Step 4).",
    "stepped": "Stepped sine: each frequency in turn; for verification of the FRF.",
    "loop": "Tone near resonance: hysteresis loops, for validation.",
    "multisine": "Multisine, whole periods of a steady motion: all parameters.",
    "decay": "Free decay after a burst: softening and dissipation, without any force.",
    "pull": "Loop under a prescribed displacement: stiffness and hysteretic force.",
    "curve": "Response curve, the response held by a controller.",
    "backbone": "Phase-locked backbone: frequency, force and amplitude at phase resonance.",
    "phase": "Points at another phase that a controller holds.",
    "s": "S-curve: the force that holds each amplitude at one frequency.",
}
"""Of each kind of test, by the beginning of its name."""
