"""Samplers without a Markov chain of their own, which give the evidence: one door."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key
from numpy.typing import NDArray

from jbw.inference.bridge import Drawn
from jbw.inference.chains import evaluate_chains
from jbw.inference.kernels import Problem, Settings
from jbw.inference.laplace_importance import importance_draws
from jbw.inference.nested import nested_draws
from jbw.inference.quadrature import quadrature_draws
from jbw.inference.tempering import tempered_draws

DIRECT = ("importance", "tempered_smc", "nested", "quadrature")


def draw_directly(
    key: Key[Array, ""], problem: Problem, num_samples: int, num_chains: int, settings: Settings
) -> tuple[Drawn, NDArray[np.float64], NDArray[np.float64]]:
    """Draws of equal weight, with the terms of the log likelihood at each.

    Args:
        key: Random key.
        problem: The posterior.
        num_samples: Draws of each chain.
        num_chains: Independent groups of draws, or runs.
        settings: The sampler, whether it knows a covariance, and how chains share the machine.

    Returns:
        The draws, the terms (chain, draw, term) and the further log prior (chain, draw) [nats].

    Raises:
        ConfigError: Quadrature of too many parameters.
        ModelError: The posterior is impossible everywhere, or a run came to no end.
    """
    whitened, method = settings.whitened, settings.chain_method
    ask = key, problem, num_samples, num_chains
    match settings.sampler:
        case "importance":
            drawn = importance_draws(*ask)
        case "tempered_smc":
            drawn = tempered_draws(*ask, whitened=whitened, chain_method=method)
        case "nested":
            drawn = nested_draws(*ask, whitened=whitened)
        case _:
            drawn = quadrature_draws(*ask)
    theta = {name: jnp.asarray(values) for name, values in drawn.theta.items()}
    bounds = jnp.asarray(0), jnp.asarray(num_samples)
    terms, extra = evaluate_chains(theta, *bounds, problem, settings)
    return drawn, *jax.tree.map(np.asarray, (terms, extra))
