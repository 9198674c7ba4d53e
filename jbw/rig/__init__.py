"""The cantilever of Teloli et al. as a virtual test rig: `measure` a campaign, `write` its files.

`measure_fleet` takes the joint apart and tightens it again, at several torques. `lapped_beams`,
`portal_frame` and `plate_chain` return the matrices of structures with several joints.

The rig shares no solver, no hold and no noise model with the identification. It integrates the
response of a specimen to an analog force (`integrator`), which a generator plays (`generator`) as
planned (`presets`), or moves the joint alone through a displacement (`prescribed_motion`), and
records the output of the sensors (`record_test`, `conditions`).

Examples:
    Two sweeps of the virtual cantilever are written as a laboratory would leave them:

    >>> import jbw; jbw.enable_x64()
    >>> campaign = jbw.rig.measure(tests=["sweep_0p20V"], repeats=2, noise_std=1e-3)
    >>> path = jbw.rig.write(campaign, "beam")
    >>> print(path.as_posix(), sorted(file.name for file in path.parent.glob("*.h5")))
    beam/campaign.toml ['sweep_0p20V_01.h5', 'sweep_0p20V_02.h5']
"""

from jbw.rig.acquisition import RigCampaign, measure, write
from jbw.rig.assemblies import BeamSection, JointedModel, lapped_beams, plate_chain, portal_frame
from jbw.rig.generator import Noise, Sweep
from jbw.rig.prescribed_motion import Held, HeldPoints, Locked, s_curve
from jbw.rig.presets import (
    CONTROLLED,
    LABORATORY,
    MIXED,
    MODES,
    PAPER,
    PRIOR,
    SLIDERS,
    TRUTH,
    Plan,
    Preset,
)
from jbw.rig.structure import Armature, Shapes, law_of_mode, modal_truth
from jbw.rig.tightening import Tightening, measure_fleet, tightened

__all__ = [
    "CONTROLLED",
    "LABORATORY",
    "MIXED",
    "MODES",
    "PAPER",
    "PRIOR",
    "SLIDERS",
    "TRUTH",
    "Armature",
    "BeamSection",
    "Held",
    "HeldPoints",
    "JointedModel",
    "Locked",
    "Noise",
    "Plan",
    "Preset",
    "RigCampaign",
    "Shapes",
    "Sweep",
    "Tightening",
    "lapped_beams",
    "law_of_mode",
    "measure",
    "measure_fleet",
    "modal_truth",
    "plate_chain",
    "portal_frame",
    "s_curve",
    "tightened",
    "write",
]
