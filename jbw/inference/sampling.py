"""Samplers for a user's own likelihood, and the verdict on their draws (`jbw.sampling`).

Examples:
    The likelihood of one measured damping ratio, 0.0050 with a standard deviation of 0.0002, gives
    a posterior with these numbers:

    >>> import jbw; jbw.enable_x64()
    >>> import jax
    >>> def log_likelihood(theta, measured):
    ...     return -0.5 * ((theta["zeta"] - measured) / 2e-4) ** 2
    >>> box, key = jbw.sampling.box({"zeta": (1e-3, 1e-2)}), jax.random.key(0)
    >>> tree = jbw.sampling.sample(key, log_likelihood, box, 0.005, sampler="quadrature")
    >>> print(f"{tree['exact']['mean'].item():.4f}, {tree['exact']['sd'].item():.4f}")
    0.0050, 0.0002
    >>> print(jbw.sampling.verdict(tree, box).status)
    ok
"""

from jbw.inference.posterior.summary import diagnose
from jbw.inference.posterior.verdict import verdict
from jbw.inference.samplers.sampling import sample
from jbw.inference.space.box import box
from jbw.inference.space.ridge import along_ridge

__all__ = ["along_ridge", "box", "diagnose", "sample", "verdict"]
