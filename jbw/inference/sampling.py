"""Samplers for a user's likelihood, and the verdict on their draws, public as `jbw.sampling`.

box = jbw.sampling.box({"zeta": (1e-3, 1e-2), "alpha": (100.0, 900.0)})
tree = jbw.sampling.sample(key, log_likelihood, box, data, sampler="nuts")
jbw.sampling.verdict(tree, box)
"""

from jbw.inference.posterior.summary import diagnose
from jbw.inference.posterior.verdict import verdict
from jbw.inference.samplers.sampling import sample
from jbw.inference.space.box import box
from jbw.inference.space.ridge import along_ridge

__all__ = ["along_ridge", "box", "diagnose", "sample", "verdict"]
