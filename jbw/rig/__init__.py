"""The paper's cantilever as a virtual test rig: `measure` a campaign, `write` it into files.

The rig shares no solver, no hold and no noise model with the identification: it integrates the
analog force (`bench`), which a generator plays (`generator`) as planned (`presets`), or takes the
joint alone through a displacement (`machine`), and records what the sensors make of it (`sensors`,
`conditions`).
"""

from jbw.rig.acquisition import RigCampaign, measure
from jbw.rig.mixed import MIXED
from jbw.rig.plans import Plan, Preset
from jbw.rig.presets import LABORATORY, PAPER, TRUTH
from jbw.rig.writing import write

__all__ = [
    "LABORATORY",
    "MIXED",
    "PAPER",
    "TRUTH",
    "Plan",
    "Preset",
    "RigCampaign",
    "measure",
    "write",
]
