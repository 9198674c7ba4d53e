"""Weighted draws: smooth the weights, count what they are worth, pool the evidence of runs."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

SMALLEST = -700.0  # log weight that counts as zero, and is still a number


def smoothed(
    log_weights: Float[Array, " draw"],
) -> tuple[Float[Array, " draw"], Float[Array, ""]]:
    """Normalised weights, their tail smoothed by a generalised Pareto fit, and its shape k-hat.

    ArviZ fits the tail; usable under `jit` and `vmap`, which call it once for each set of weights.

    Returns:
        Weights that sum to one, and k-hat: below 0.7 they can be trusted.

    Reference:
        Vehtari et al. (2024), JMLR 25, 72.
    """
    raw = jnp.maximum(log_weights - jnp.max(log_weights), SMALLEST)
    shapes = jax.ShapeDtypeStruct(raw.shape, raw.dtype), jax.ShapeDtypeStruct((), raw.dtype)
    found, khat = jax.pure_callback(_smooth, shapes, raw, vmap_method="sequential")
    return jax.nn.softmax(found), khat


def _smooth(raw: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    from arviz_stats.base.array import array_stats  # a second of imports, needed only here

    stats: Any = array_stats  # its annotations admit tuples that it never returns here
    # ArviZ takes the negative of the log weights, as a leave-one-out log likelihood gives them.
    found, khat = stats.psislw(-np.asarray(raw))
    return np.asarray(found), np.asarray(khat, dtype=float)


def effective_draws(weights: Float[Array, " draw"]) -> Float[Array, ""]:
    r"""Effective number of weighted draws.

    $$\left(\sum_i w_i\right)^2 / \sum_i w_i^2$$

    Reference:
        Kish (1965), Survey Sampling.
    """
    return jnp.sum(weights) ** 2 / jnp.sum(weights**2)


def pooled_evidence(
    log_evidence: Float[Array, " run"], variance: Float[Array, " run"]
) -> dict[str, Float[Array, ""]]:
    r"""Evidence of independent runs together, and the standard error of its logarithm.

    $$\log\hat Z = \log \frac1R \sum_r Z_r, \qquad
    \mathrm{se}^2 = \max\!\left(\bar{s^2},\ \mathrm{var}_r \log Z_r\right) / R$$

    What each run says of its own error may leave something out, and the scatter of few runs may
    be small by chance: the larger of the two is taken.

    Returns:
        log_evidence and log_evidence_error [nats].
    """
    count = log_evidence.size
    scatter = jnp.var(log_evidence, ddof=1) if count > 1 else jnp.zeros(())
    return {
        "log_evidence": jax.nn.logsumexp(log_evidence) - jnp.log(count),
        "log_evidence_error": jnp.sqrt(jnp.maximum(jnp.mean(variance), scatter) / count),
    }
