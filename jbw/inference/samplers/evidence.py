r"""Reference densities of samplers, and the model evidence from weighted draws.

Samplers that give the evidence use the posterior only through its ratio to a reference density
r(w),

$$Z = \int L(\theta)\,\pi(\theta)\,\mathrm{d}\theta = E_r\!\left[e^{\ell(w)}\right], \qquad
\ell(w) = \log p(w, D) - \log r(w)$$

where r is Student's t distribution of 5 degrees of freedom if a fit has whitened w, with heavier
tails than a posterior, and otherwise the prior itself: the logit of a uniform coordinate has the
logistic distribution.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpyro.distributions as dist
from jaxtyping import Array, Bool, Float
from numpyro.distributions import Distribution

from jbw.errors import ModelError
from jbw.inference.space.problem import Problem

# degrees of freedom of Student's t distribution around a fit, few enough for heavy tails
HEAVY = 5.0
# finite log density that represents zero density, so that zero times it is not NaN
FORBIDDEN = -1e30


def reference(problem: Problem) -> Distribution:
    """Return the reference density of the importance weights, in normalised coordinates."""
    size = len(problem.box.names)
    if problem.located:
        return dist.MultivariateStudentT(HEAVY, jnp.zeros(size), jnp.eye(size))
    return dist.Logistic(jnp.zeros(size), 1.0).to_event(1)


def log_ratio(problem: Problem, w: Float[Array, " parameter"]) -> Float[Array, ""]:
    """Return log posterior minus log reference density [nats]; FORBIDDEN if the former is -inf."""
    value = problem.log_density(w) - reference(problem).log_prob(w)
    return jnp.where(jnp.isfinite(value), value, FORBIDDEN)


def is_possible(log_ratios: Float[Array, "..."]) -> Bool[Array, ""]:
    """Return whether the posterior density is positive at any of the points."""
    return jnp.any(log_ratios > FORBIDDEN / 2)


def require_possible(possible: bool) -> None:
    """Raise a ModelError if the posterior density is zero at all points."""
    if not possible:
        raise ModelError(
            "The log likelihood is not finite at any evaluated point.",
            remedy="Check the data for NaN and the noise for zero. Check whether the prior "
            "contains parameters for which the model has no solution.",
        )


def effective_draws(weights: Float[Array, " draw"]) -> Float[Array, ""]:
    r"""Return the effective number of draws, $(\sum_i w_i)^2 / \sum_i w_i^2$ (Kish, 1965)."""
    return jnp.sum(weights) ** 2 / jnp.sum(weights**2)


def weighted_moments(
    weights: Float[Array, " draw"], points: Float[Array, "draw parameter"]
) -> tuple[Float[Array, " parameter"], Float[Array, "parameter parameter"]]:
    """Return the mean and covariance of points whose weights sum to one."""
    mean = weights @ points
    deviations = points - mean
    return mean, (weights[:, None] * deviations).T @ deviations


def highest_power(
    effective: Callable[[Array], Array],
    least: Float[Array, ""] | float,
    ends: tuple[Array, Array],
    halvings: int,
) -> Float[Array, ""]:
    """Return the highest power of weights with at least `least` effective draws, by bisection."""

    def halve(_: int, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = ends
        middle = (low + high) / 2
        enough = effective(middle) >= least
        return jnp.where(enough, middle, low), jnp.where(enough, high, middle)

    return jax.lax.fori_loop(0, halvings, halve, ends)[0]


def pooled_evidence(
    log_evidence: Float[Array, " run"], variance: Float[Array, " run"]
) -> dict[str, Float[Array, ""]]:
    r"""Combine the log evidence [nats] of independent runs; return it with its standard error.

    $$\log\hat Z = \log \frac1R \sum_r Z_r, \qquad
    \mathrm{se}^2 = \max\!\left(\bar{s^2},\ \mathrm{var}_r \log Z_r\right) / R$$

    The larger of two variances is used: a run's own error may be incomplete, and the scatter of few
    runs may be small by chance.
    """
    count = log_evidence.size
    scatter = jnp.var(log_evidence, ddof=1) if count > 1 else jnp.zeros(())
    return {
        "log_evidence": jax.nn.logsumexp(log_evidence) - jnp.log(count),
        "log_evidence_error": jnp.sqrt(jnp.maximum(jnp.mean(variance), scatter) / count),
    }
