"""The verdict on a posterior: ok, failed or not assessed, with reasons and what to do."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.inference.fit.identifiability import weak_direction_of_draws
from jbw.inference.posterior.finding import Finding, Verdict, judge, limited
from jbw.inference.posterior.modes import modes_finding
from jbw.inference.posterior.summary import diagnose
from jbw.inference.space.box import Box

Draws = dict[str, Float[np.ndarray, "chain draw"]]

R_HAT = 1.01
ESS = 400.0
BFMI = 0.3
FAILED_SOLVES = 0.01
TREE_SHARE = 0.05  # of trajectories cut at the greatest depth
EDGE, PILE = 0.01, 2.0  # share of the box at a bound; excess over a uniform posterior there
CHI_SQUARE = (0.2, 5.0)  # a degree of freedom
GOOD_KHAT = 0.7  # Pareto shape above which weights cannot be trusted (Vehtari et al. 2024)
QUADRATURE = 1e-3  # change by the last refinement, in nats or standard deviations


def verdict(tree: xr.DataTree, box: Box, *, chi_square: tuple[float, int] | None = None) -> Verdict:
    """Judge a posterior that `sample` left.

    Args:
        tree: Groups posterior and sample_stats.
        box: Prior bounds of the parameters; further scalar quantities of the posterior are judged
            for convergence only.
        chi_square: Chi-square of the best fit and its degrees of freedom, where known.

    Returns:
        The verdict, with R-hat < 1.01 and effective sample sizes >= 400 for every quantity.

    Reference:
        Vehtari et al. (2021), Bayesian Analysis 16, 667; Betancourt (2016), arXiv:1604.00695.
    """
    draws: Draws = {
        str(name): np.asarray(variable.values)
        for name, variable in tree["posterior"].to_dataset().items()
        if variable.dims == ("chain", "draw")
    }
    findings = [_finite(draws)]
    if findings[0].status == "ok":
        findings += [_moving(draws), *_convergence(draws), modes_finding(draws)]
        findings += [*_bounds(draws, box), _identified(draws, box)]
    findings += _trajectories(tree["sample_stats"].to_dataset())
    findings += direct_findings(tree.attrs)
    if chi_square is not None:
        findings.append(_fit(*chi_square))
    return judge(findings)


def _finite(draws: Draws) -> Finding:
    counts = {name: int(np.sum(~np.isfinite(values))) for name, values in draws.items()}
    name = max(counts, key=counts.__getitem__)
    reason = f"{counts[name]} draws of {name} are not finite."
    return limited("non_finite", reason, counts[name], 0, "Check the data for NaN.")


def _moving(draws: Draws) -> Finding:
    frozen = {name: int(np.sum(np.ptp(values, axis=1) == 0)) for name, values in draws.items()}
    name = max(frozen, key=frozen.__getitem__)
    reason = f"{frozen[name]} of {len(draws[name])} chains never moved in {name}."
    action = "Start elsewhere, lengthen the warm-up, or doubt a noise that is far too small."
    return limited("frozen_chain", reason, frozen[name], 0, action)


def _convergence(draws: Draws) -> list[Finding]:
    rows = {name: diagnose(values) for name, values in draws.items()}
    more = "Draw more, or start from a fit with its covariance."
    found = []
    for code, low in (("ess_bulk", True), ("ess_tail", True), ("r_hat", False)):
        values = {name: row[code] for name, row in rows.items()}
        if code == "r_hat" and all(len(value) == 1 for value in draws.values()):
            found.append(
                Finding(
                    code,
                    "not assessed",
                    "One chain cannot be compared with itself.",
                    float("nan"),
                    "Run at least two chains, better four.",
                )
            )
            continue
        # A number that cannot be had is the worst of all.
        worst = {n: (-v if low else v) if np.isfinite(v) else np.inf for n, v in values.items()}
        name = max(worst, key=worst.__getitem__)
        value = values[name]
        good = value >= ESS if low else value < R_HAT
        limit = f"at least {ESS:g}" if low else f"below {R_HAT:g}"
        reason = f"{code} of {name} is {value:.4g}; it must be {limit}."
        found.append(Finding(code, "ok" if good else "failed", reason, value, "" if good else more))
    return found


def bands_finding(draws: Draws) -> Finding:
    """Whether the quantities that response bands are made of have converged, all in one finding.

    Args:
        draws: Draws of each, by what it is.

    Returns:
        Of the worst quantity, by the limits of R-hat and of the effective sample sizes.
    """
    found = _convergence(draws)
    worst = next((f for f in found if f.status == "failed"), None)
    worst = worst or next((f for f in found if f.status != "ok"), found[0])
    return replace(worst, code="response_bands")


def _bounds(draws: Draws, box: Box) -> list[Finding]:
    found = []
    for name, lower, upper in zip(box.names, box.lower, box.upper, strict=True):
        x = (draws[name] - float(lower)) / float(upper - lower)
        for side, share in (("lower", np.mean(x < EDGE)), ("upper", np.mean(x > 1 - EDGE))):
            if share > PILE * EDGE:
                found.append(
                    Finding(
                        "at_bound",
                        "failed",
                        f"{share:.1%} of the posterior of {name} lie within {EDGE:.0%} of its "
                        f"{side} bound.",
                        float(share),
                        f"Widen {name} {side}, or doubt the model.",
                    )
                )
    return found or [Finding("at_bound", "ok", "No parameter piles up at its bounds.", 0.0)]


def _identified(draws: Draws, box: Box) -> Finding:
    weak = weak_direction_of_draws(draws, box)
    if weak is None:
        return Finding("unidentified", "ok", "The data narrow every direction.", 0.0)
    return Finding(
        "unidentified",
        "failed",
        f"{weak.text[0].upper()}{weak.text[1:]}: along one direction of {', '.join(weak.names)} "
        f"the posterior has {weak.ratio:.2f} of the prior's standard deviation.",
        weak.ratio,
        "Report the combination, fix one of the parameters, or add tests at higher amplitude.",
    )


def _trajectories(stats: xr.Dataset) -> list[Finding]:
    found = []
    if "diverging" in stats:
        count = int(stats["diverging"].sum())
        reason = (
            f"{count} of {stats['diverging'].size} trajectories diverged or met a failed solve."
        )
        action = "Raise target_accept, or look where in the prior the model cannot be solved."
        found.append(limited("divergences", reason, count, 0, action))
    if "failed" in stats:
        share = float(stats["failed"].mean())
        reason = f"{share:.2%} of the proposals met a failed solve."
        action = "Narrow the prior to where the model can be solved, or solve it more finely."
        found.append(limited("failed_solves", reason, share, FAILED_SOLVES, action))
    if "reached_max_tree_depth" in stats:
        share = float(stats["reached_max_tree_depth"].mean())
        reason = f"{share:.1%} of the trajectories were cut at the greatest tree depth."
        action = "Start from a fit with its covariance, or raise max_tree_depth."
        found.append(limited("tree_depth", reason, share, TREE_SHARE, action))
    if "energy" in stats and stats.sizes["draw"] > 1:
        from arviz_stats.base.array import array_stats  # a second of imports, needed only here

        lowest = float(np.min(array_stats.bfmi(stats["energy"].values)))
        good = lowest >= BFMI
        reason = f"E-BFMI of the worst chain is {lowest:.2f}; it must be at least {BFMI:g}."
        action = "" if good else "Reparametrise: the tails are not explored."
        found.append(Finding("e_bfmi", "ok" if good else "failed", reason, lowest, action))
    return found


def direct_findings(facts: Mapping[Any, Any]) -> list[Finding]:
    """Judge what such a sampler says of itself; nothing for chains.

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
        effective = float(facts["ess_weights"])
        good = effective >= ESS
        reason = f"The weights are worth {effective:.4g} draws; it must be at least {ESS:g}."
        action = "" if good else "Draw more."
        found.append(Finding("ess_weights", "ok" if good else "failed", reason, effective, action))
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


def _fit(chi_square: float, dof: int) -> Finding:
    ratio = chi_square / dof if dof > 0 else float("nan")
    low, high = CHI_SQUARE
    good = low <= ratio <= high
    return Finding(
        "chi_square",
        "ok" if good else "failed",
        f"Chi-square a degree of freedom is {ratio:.3g}; it must be within {low:g} and {high:g}.",
        ratio,
        "" if good else "Doubt the noise, or the model.",
    )
