"""Findings on samplers without a chain: weights, temperatures, quadrature."""

from collections.abc import Mapping
from typing import Any

from jbw.inference.finding import Finding, limited

GOOD_KHAT = 0.7
"""Pareto shape above which weights cannot be trusted (Vehtari et al. 2024)."""

WORTH = 400.0  # effective draws, as of chains
QUADRATURE = 1e-3  # change by the last refinement, in nats or standard deviations


def direct_findings(facts: Mapping[Any, Any]) -> list[Finding]:
    """Judge what such a sampler says of itself; nothing for chains.

    Args:
        facts: Attributes of the tree's root.

    Returns:
        A finding each for k-hat, the effective number of the weights, the last temperature and
        the error of the quadrature, where there is one.

    Reference:
        Vehtari et al. (2024), JMLR 25, 72.
    """
    found = []
    chain = "Draw by nuts or tempered_smc: the posterior is not the Laplace approximation."
    if "khat" in facts:
        khat = float(facts["khat"])
        # NaN, from too few weights to tell, is not below the limit.
        good = khat < GOOD_KHAT
        reason = f"Pareto k-hat of the weights is {khat:.2f}; it must be below {GOOD_KHAT:g}."
        found.append(
            Finding("khat", "ok" if good else "failed", reason, khat, "" if good else chain)
        )
    if "ess_weights" in facts:
        worth = float(facts["ess_weights"])
        good = worth >= WORTH
        reason = f"The weights are worth {worth:.4g} draws; it must be at least {WORTH:g}."
        action = "" if good else "Draw more."
        found.append(Finding("ess_weights", "ok" if good else "failed", reason, worth, action))
    if "inverse_temperature" in facts:
        beta = float(facts["inverse_temperature"])
        reason = f"The inverse temperature ended at {beta:.3g}; it must end at 1."
        action = "Narrow the prior, or start from a fit with its covariance."
        found.append(limited("temperature", reason, 1 - beta, 0.0, action))
    if "quadrature_error" in facts:
        error = float(facts["quadrature_error"])
        reason = (
            f"The last refinement of the quadrature changed it by {error:.2g} standard deviations "
            f"or nats; it must be at most {QUADRATURE:g}."
        )
        action = "Narrow the prior, or draw by nuts."
        found.append(limited("quadrature", reason, error, QUADRATURE, action))
    return found


def converged(facts: Mapping[Any, Any]) -> bool:
    """Whether a quadrature states an error small enough to measure others by.

    Args:
        facts: Attributes of the tree's root.
    """
    return float(facts["quadrature_error"]) <= QUADRATURE
