"""The verdict on a posterior: ok, failed or not assessed, with reasons and what to do."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from operator import itemgetter
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.inference.fit.identifiability import weak_direction_of_draws
from jbw.inference.posterior.finding import WORST_FIRST, Finding, Verdict, checked, judge
from jbw.inference.posterior.modes import modes_findings
from jbw.inference.posterior.remedies import (
    NUM_WARMUP,
    more_draws,
    other_sampler,
    put,
    put_bounds,
    wider,
)
from jbw.inference.posterior.summary import Row, diagnose, scalars
from jbw.inference.space.box import Box, bounds_by_name

Draws = Mapping[str, Float[np.ndarray, "chain draw"]]

R_HAT = 1.01
ESS = 400.0
BFMI = 0.3
FAILED_SOLVES = 0.01
TREE_SHARE = 0.05  # of trajectories cut at the greatest depth
# Share of a posterior's own 99 % span that counts as its bound's edge, and the excess there over
# a uniform posterior; half a normal distribution at its bound has 2.2, one a deviation away 1.0.
EDGE, PILE = 0.01, 1.5
CHI_SQUARE = (0.2, 5.0)  # a degree of freedom
GOOD_KHAT = 0.7  # Pareto shape above which weights cannot be trusted (Vehtari et al. 2024)
QUADRATURE = 1e-3  # change by the last refinement, in nats or standard deviations


SUBSTEPS = 8  # solver steps a sample, where a posterior does not say


def verdict(
    tree: xr.DataTree,
    box: Box,
    *,
    chi_square: tuple[float, int] | None = None,
    ending: Collection[str] = (),
) -> Verdict:
    """Judge a posterior of `sample`: R-hat < 1.01 and effective sizes >= 400 among others.

    Scalar quantities that the box does not name are judged for convergence only. `chi_square` is
    that of the best fit with its degrees of freedom, where known; parameters that are `ending` by
    themselves at their upper bound are not asked to be widened there.

    Reference:
        Vehtari et al. (2021), Bayesian Analysis 16, 667; Betancourt (2016), arXiv:1604.00695.
    """
    draws = scalars(tree)
    findings = [_finite(draws)]
    if findings[0].status == "ok":
        sampler = str(tree.attrs.get("sampler", ""))
        findings += [_moving(draws), *_convergence(draws, sampler), *modes_findings(draws)]
        findings += [*_bounds(draws, box, ending), _identified(draws, box)]
    findings += _trajectories(tree["sample_stats"].to_dataset(), tree.attrs)
    findings += _at_once(tree.attrs)
    findings += _budget(tree.attrs, findings)
    if chi_square is not None:
        findings.append(_fit(*chi_square))
    return judge(findings)


def _finite(draws: Draws) -> Finding:
    counts = {name: int(np.sum(~np.isfinite(values))) for name, values in draws.items()}
    name, count = max(counts.items(), key=itemgetter(1))
    reason = f"{count} draws of {name} are not finite."
    return checked("non_finite", count == 0, reason, count, "Look for NaN in the data: jbw check.")


def _moving(draws: Draws) -> Finding:
    frozen = {name: int(np.sum(np.ptp(values, axis=1) == 0)) for name, values in draws.items()}
    name, count = max(frozen.items(), key=itemgetter(1))
    reason = f"{count} of {len(draws[name])} chains never moved in {name}."
    action = f"{put('identify', 'sampler', 'tempered_smc')} It starts from the whole prior."
    return checked("frozen_chain", count == 0, reason, count, action)


def _convergence(draws: Draws, sampler: str = "") -> list[Finding]:
    rows = {name: diagnose(values) for name, values in draws.items()}
    findings = [_least_effective(code, rows, draws, sampler) for code in ("ess_bulk", "ess_tail")]
    if all(len(values) == 1 for values in draws.values()):
        reason = "One chain cannot be compared with itself."
        action = put("identify", "num_chains", 4)
        return [*findings, Finding("r_hat", "not assessed", reason, float("nan"), action)]
    # An R-hat that cannot be computed counts as the worst.
    name = max(rows, key=lambda name: np.nan_to_num(rows[name]["r_hat"], nan=np.inf))
    r_hat = rows[name]["r_hat"]
    reason = f"r_hat of {name} is {r_hat:.4g}; it must be below {R_HAT:g}."
    remedy = _more(draws[name], min(row["ess_bulk"] for row in rows.values()), sampler)
    return [*findings, checked("r_hat", r_hat < R_HAT, reason, r_hat, remedy)]


def _more(draws: Float[np.ndarray, "chain draw"], size: float, sampler: str) -> str:
    return more_draws(draws.shape[1], float(np.nan_to_num(size)), ESS, sampler)


def _least_effective(
    code: str, rows: Mapping[str, Row], draws: Draws, sampler: str = ""
) -> Finding:
    name = min(rows, key=lambda name: np.nan_to_num(rows[name][code], nan=-np.inf))
    size = rows[name][code]
    reason = f"{code} of {name} is {size:.4g}; it must be at least {ESS:g}."
    return checked(code, size >= ESS, reason, size, _more(draws[name], size, sampler))


def bands_finding(draws: Draws) -> Finding:
    """Whether the quantities that response bands are made of have converged: the worst by name."""
    worst = min(_convergence(draws), key=lambda finding: WORST_FIRST.index(finding.status))
    return replace(worst, code="response_bands")


def leaning(draws: Draws, box: Box) -> Iterator[tuple[str, str, float]]:
    """Parameters that a prior bound truncates, which bound, and the share of their draws there.

    Not where a lower bound is zero: there a quantity ends by itself, and an upper limit is an
    answer.
    """
    for name, (lower, upper) in bounds_by_name(box).items():
        edge = EDGE * float(np.diff(np.quantile(draws[name], (0.005, 0.995)))[0])
        near = {"upper": draws[name] > upper - edge}
        if lower != 0.0:
            near["lower"] = draws[name] < lower + edge
        for side, share in ((side, float(np.mean(draw))) for side, draw in near.items()):
            if share > PILE * EDGE:
                yield name, side, share


def _bounds(draws: Draws, box: Box, ending: Collection[str]) -> list[Finding]:
    findings, bounds = [], bounds_by_name(box)
    truncated = list(leaning(draws, box))
    for name, side, share in truncated:
        where = f"within {EDGE:.0%} of its 99 % span from its {side} bound"
        reason = f"{share:.1%} of the posterior of {name} lie {where}."
        ends = name in ending
        sides = [s for n, s, _ in truncated if n == name and not (ends and s == "upper")]
        if side in sides:
            action = f"{put_bounds(name, wider(bounds[name], sides))} Or doubt the model."
        else:
            action = f"The whole stiffness ends {name} there: use its products, which are known."
        findings.append(checked("at_bound", False, reason, share, action))
    return findings or [Finding("at_bound", "ok", "No parameter piles up at its bounds.", 0.0)]


def _identified(draws: Draws, box: Box) -> Finding:
    weak = weak_direction_of_draws(draws, box)
    if weak is None:
        return Finding(
            "unidentified", "ok", "The data identify every combination of the parameters.", 0.0
        )
    reason = (
        f"{weak.text[0].upper()}{weak.text[1:]}: along one direction of {', '.join(weak.names)} "
        f"the posterior has {weak.ratio:.2f} of the prior's standard deviation."
    )
    name = weak.names[0]
    low, high = bounds_by_name(box)[name]
    # The remedy never states the posterior's interval: as a prior it would count the data twice.
    action = (
        "Report the combination, or add tests at higher amplitude (jbw plan). If you know "
        f"{name} from another source, put its range in the place of the present bounds, "
        f"{low:.3g} to {high:.3g}, under [identify.prior]."
    )
    return checked("unidentified", False, reason, weak.ratio, action)


def _trajectories(stats: xr.Dataset, facts: Mapping[Any, Any]) -> list[Finding]:
    findings = []
    finer = put("identify", "substeps", 2 * int(facts.get("substeps", SUBSTEPS)))
    if "diverging" in stats:
        count = int(stats["diverging"].sum())
        reason = (
            f"{count} of {stats['diverging'].size} trajectories diverged or met a failed solve."
        )
        action = (
            f"{put('identify', 'sampler', 'tempered_smc')} It follows no trajectories. "
            f"Solve more finely where it is the solves that fail. {finer}"
        )
        findings.append(checked("divergences", count == 0, reason, count, action))
    if "failed" in stats:
        share = float(stats["failed"].mean())
        reason = f"{share:.2%} of the proposals met a failed solve."
        action = f"Solve more finely, or narrow the prior. {finer}"
        findings.append(checked("failed_solves", share <= FAILED_SOLVES, reason, share, action))
    if "reached_max_tree_depth" in stats:
        share = float(stats["reached_max_tree_depth"].mean())
        reason = f"{share:.1%} of the trajectories were cut at the greatest tree depth."
        longer = 2 * int(facts.get("num_warmup", NUM_WARMUP))
        action = f"Adapt longer. {put('identify', 'num_warmup', longer)}"
        findings.append(checked("tree_depth", share <= TREE_SHARE, reason, share, action))
    if "energy" in stats and stats.sizes["draw"] > 1:
        from arviz_stats.base.array import array_stats  # a second of imports, needed only here

        lowest = float(np.min(array_stats.bfmi(stats["energy"].values)))
        reason = f"E-BFMI of the worst chain is {lowest:.2f}; it must be at least {BFMI:g}."
        action = f"The tails are not explored. {put('identify', 'sampler', 'tempered_smc')}"
        findings.append(checked("e_bfmi", lowest >= BFMI, reason, lowest, action))
    return findings


def _at_once(facts: Mapping[Any, Any]) -> list[Finding]:
    """Findings from the tree's attributes of a sampler that draws everything at once."""
    findings = []
    if "khat" in facts:
        khat = float(facts["khat"])
        reason = f"Pareto k-hat of the weights is {khat:.2f}; it must be below {GOOD_KHAT:g}."
        action = f"The posterior is no Gaussian about the fit. {other_sampler()}"
        # NaN, from too few weights to tell, is not below the limit.
        findings.append(checked("khat", khat < GOOD_KHAT, reason, khat, action))
    if "ess_weights" in facts:
        size = float(facts["ess_weights"])
        reason = f"The weights are worth {size:.4g} draws; it must be at least {ESS:g}."
        action = f"The weights fall on few points. {other_sampler()}"
        findings.append(checked("ess_weights", size >= ESS, reason, size, action))
    if "inverse_temperature" in facts:
        beta = float(facts["inverse_temperature"])
        reason = f"The inverse temperature ended at {beta:.3g}; it must end at 1."
        action = f"The budget ended before the tempering. {other_sampler()}"
        findings.append(checked("temperature", beta >= 1, reason, 1 - beta, action))
    if "quadrature_error" in facts:
        error = float(facts["quadrature_error"])
        reason = (
            f"The last refinement of the quadrature changed it by {error:.2g} standard deviations "
            f"or nats; it must be at most {QUADRATURE:g}."
        )
        action = f"The grid is too coarse for this posterior. {other_sampler()}"
        findings.append(checked("quadrature", converged(facts), reason, error, action))
    return findings


def _budget(facts: Mapping[Any, Any], findings: Iterable[Finding]) -> list[Finding]:
    """Whether the time was spent before the draws were enough, and what they would have taken."""
    if "budget_spent_s" not in facts:
        return []
    spent = float(facts["budget_spent_s"])
    sizes = [finding.number for finding in findings if finding.code in ("ess_bulk", "ess_tail")]
    least = min((size for size in sizes if size > 0), default=1.0)
    budget = spent * max(ESS / least, 2.0)
    reason = f"The budget of {spent:.3g} s was spent before the draws were enough."
    action = f"{put('identify', 'budget_s', float(f'{budget:.2g}'))} At the rate so far."
    return [checked("budget", False, reason, spent, action)]


def enough(draws: Draws) -> bool:
    """Whether draws pass every check of convergence of a verdict."""
    finite = all(np.all(np.isfinite(values)) for values in draws.values())
    return finite and all(finding.status != "failed" for finding in _convergence(draws))


def converged(facts: Mapping[Any, Any]) -> bool:
    """Whether a quadrature states, in its tree's attributes, an error to measure others by."""
    return float(facts["quadrature_error"]) <= QUADRATURE


def _fit(chi_square: float, dof: int) -> Finding:
    ratio = chi_square / dof if dof > 0 else float("nan")
    low, high = CHI_SQUARE
    reason = (
        f"Chi-square a degree of freedom is {ratio:.3g}; it must be within {low:g} and {high:g}."
    )
    action = "Repeats must be records of their own. Else doubt the law: jbw laws tries others."
    return checked("chi_square", low <= ratio <= high, reason, ratio, action)
