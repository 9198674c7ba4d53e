"""The verdict on a posterior: ok, failed or not assessed, with the values that decide it."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float
from scipy.stats import gaussian_kde

from jbw.inference.fit.identifiability import weak_direction_of_draws
from jbw.inference.posterior.finding import WORST_FIRST, Finding, Verdict, checked, judge
from jbw.inference.posterior.remedies import (
    NUM_WARMUP,
    more_draws,
    other_sampler,
    put_bounds,
    wider,
)
from jbw.inference.posterior.summary import diagnose, scalars
from jbw.inference.space.box import Box, bounds_by_name
from jbw.results.attributes import DrawnPosterior

Draws = Mapping[str, Float[np.ndarray, "chain draw"]]

R_HAT = 1.01
ESS = 400.0
BFMI = 0.3
FAILED_SOLVES = 0.01
# largest allowed fraction of NUTS trajectories that end at the maximum tree depth
TREE_SHARE = 0.05
NUM_CHAINS = 4  # number of chains that is suggested if there is only one
# Width of the strip at a prior bound, relative to a 99 % interval, and the largest density of draws
# in the strip, relative to that of a uniform posterior. Half a normal distribution at its bound has
# a relative density of 2.2; a normal distribution whose mean is one standard deviation away from
# the bound has 1.0.
EDGE, PILE = 0.01, 1.5
# limits of chi-square per degree of freedom between which a fit agrees with the noise
CHI_SQUARE = (0.2, 5.0)
GOOD_KHAT = 0.7  # Pareto shape above which weights cannot be trusted (Vehtari et al. 2024)
# largest change by the last refinement of a quadrature, in nats or standard deviations
QUADRATURE = 1e-3


SUBSTEPS = 8  # number of solver steps per sample of a posterior that does not state it
# Two peaks are separate modes if the density between them is below this fraction of the lower one.
DEPTH = 0.5
LEAST_SIDE = 0.02  # smallest fraction of the draws that counts as a mode; fewer draws are a tail
# number of standard errors by which a mode's fraction of the draws must exceed `LEAST_SIDE`
SURE_SIDE = 2.0
NUM_POINTS = 256
# smallest number of draws for a density estimate, so that stuck chains do not look like modes
FEWEST = 100
CROSSED = 100.0  # A mode's weight is reliable if at least this many effective draws lie in it.
AGREED = 1.05  # largest R-hat of the fraction of draws in a mode


def verdict(
    tree: xr.DataTree,
    box: Box,
    *,
    chi_square: tuple[float, int] | None = None,
    ending: Collection[str] = (),
) -> Verdict:
    """Judge a posterior's convergence and bounds: R-hat < 1.01, effective sizes >= 400, and more.

    Scalar quantities that the box does not name are judged for convergence only. `chi_square` is
    that of the best fit with its degrees of freedom, if known. For parameters named in `ending`,
    which end naturally at their upper bound, no wider bound is suggested there.

    Reference:
        Vehtari et al. (2021), Bayesian Analysis 16, 667; Betancourt (2016), arXiv:1604.00695.
    """
    draws, facts = scalars(tree), DrawnPosterior.of(tree)
    findings = [_finite(draws)]
    if findings[0].status == "ok":
        sampler = facts.sampler
        findings += [_moving(draws), *_convergence(draws, sampler), *modes_findings(draws)]
        findings += [*bounds_findings(draws, box, ending), _identified(draws, box)]
    findings += _trajectories(tree["sample_stats"].to_dataset(), facts)
    findings += _at_once(facts)
    findings += _budget(facts, findings)
    if chi_square is not None:
        findings.append(_fit(*chi_square))
    return judge(findings)


def _finite(draws: Draws) -> Finding:
    counts = {name: int(np.sum(~np.isfinite(values))) for name, values in draws.items()}
    name, count = max(counts.items(), key=itemgetter(1))
    return checked("non_finite", count == 0, {"count": count, "name": name}, count)


def _moving(draws: Draws) -> Finding:
    frozen = {name: int(np.sum(np.ptp(values, axis=1) == 0)) for name, values in draws.items()}
    name, count = max(frozen.items(), key=itemgetter(1))
    values = {"count": count, "num_chains": len(draws[name]), "name": name}
    return checked("frozen_chain", count == 0, values, count)


def _convergence(draws: Draws, sampler: str = "") -> list[Finding]:
    rows = {name: diagnose(values) for name, values in draws.items()}
    findings = []
    for code in ("ess_bulk", "ess_tail"):
        name = min(rows, key=lambda name: np.nan_to_num(rows[name][code], nan=-np.inf))
        size = rows[name][code]
        values = {"name": name, "size": size, "limit": ESS}
        remedy = _more(draws[name], size, sampler)
        findings.append(checked(code, size >= ESS, values, size, remedy))
    if all(len(values) == 1 for values in draws.values()):
        chains = {"num_chains": NUM_CHAINS}
        unknown = float("nan")
        one_chain = Finding("r_hat", "not assessed", {}, unknown, chains, entry="r_hat.one_chain")
        return [*findings, one_chain]
    # If R-hat cannot be computed, it counts as the worst.
    r_hats = {name: row["r_hat"] for name, row in rows.items()}
    name, r_hat = max(r_hats.items(), key=lambda pair: np.nan_to_num(pair[1], nan=np.inf))
    values = {"name": name, "r_hat": r_hat, "limit": R_HAT}
    remedy = _more(draws[name], min(row["ess_bulk"] for row in rows.values()), sampler)
    return [*findings, checked("r_hat", r_hat < R_HAT, values, r_hat, remedy)]


def _more(draws: Float[np.ndarray, "chain draw"], size: float, sampler: str) -> dict[str, Any]:
    return more_draws(draws.shape[1], float(np.nan_to_num(size)), ESS, sampler)


def bands_finding(draws: Draws) -> Finding:
    """Return the worst convergence finding among the quantities of response bands."""
    worst = min(_convergence(draws), key=lambda finding: WORST_FIRST.index(finding.status))
    return replace(worst, code="response_bands", entry=worst.entry or worst.code)


def leaning(draws: Draws, box: Box) -> Iterator[tuple[str, str, float]]:
    """Yield each parameter that a prior bound truncates, the bound's side, and its share of draws.

    A lower bound of zero is not reported: a quantity ends there naturally, and an upper limit is a
    valid result.
    """
    for name, (lower, upper) in bounds_by_name(box).items():
        edge = EDGE * float(np.diff(np.quantile(draws[name], (0.005, 0.995)))[0])
        near = {"upper": draws[name] > upper - edge}
        if lower != 0.0:
            near["lower"] = draws[name] < lower + edge
        for side, share in ((side, float(np.mean(draw))) for side, draw in near.items()):
            if share > PILE * EDGE:
                yield name, side, share


def bounds_findings(draws: Draws, box: Box, ending: Collection[str]) -> list[Finding]:
    """Return a finding for each prior bound that truncates the draws, or a single ok finding."""
    findings, bounds = [], bounds_by_name(box)
    truncated = list(leaning(draws, box))
    for name, side, share in truncated:
        values = {"name": name, "side": side, "share": share, "edge": EDGE}
        ends = name in ending
        sides = [s for n, s, _ in truncated if n == name and not (ends and s == "upper")]
        if side in sides:
            line = put_bounds(name, wider(bounds[name], sides))
            finding = checked("at_bound", False, values, share, {"line": line})
        else:
            remedy = {"name": name}
            finding = Finding("at_bound", "usable", remedy, share, remedy, entry="at_bound.ends")
        findings.append(finding)
    return findings or [Finding("at_bound", "ok", {}, 0.0)]


def _identified(draws: Draws, box: Box) -> Finding:
    weak = weak_direction_of_draws(draws, box)
    if weak is None:
        return Finding("unidentified", "ok", {}, 0.0)
    values = {"names": weak.names, "text": weak.text, "ratio": weak.ratio}
    name = weak.names[0]
    low, high = bounds_by_name(box)[name]
    remedy = {"name": name, "low": low, "high": high}
    return checked("unidentified", False, values, weak.ratio, remedy)


def _trajectories(stats: xr.Dataset, facts: DrawnPosterior) -> list[Finding]:
    findings = []
    finer = {"substeps": 2 * (facts.substeps or SUBSTEPS)}
    if "diverging" in stats:
        diverging = stats["diverging"]
        count = int(diverging.sum())
        values = {"count": count, "size": diverging.size}
        findings.append(checked("divergences", count == 0, values, count, finer))
    if "failed" in stats:
        share = float(stats["failed"].mean())
        values = {"share": share, "limit": FAILED_SOLVES}
        findings.append(checked("failed_solves", share <= FAILED_SOLVES, values, share, finer))
    if "reached_max_tree_depth" in stats:
        share = float(stats["reached_max_tree_depth"].mean())
        values = {"share": share, "limit": TREE_SHARE}
        longer = {"num_warmup": 2 * (facts.num_warmup or NUM_WARMUP)}
        findings.append(checked("tree_depth", share <= TREE_SHARE, values, share, longer))
    if "energy" in stats and stats.sizes["draw"] > 1:
        from arviz_stats.base.array import array_stats  # an import of one second, needed only here

        lowest = float(np.min(array_stats.bfmi(stats["energy"].values)))
        values = {"e_bfmi": lowest, "limit": BFMI}
        findings.append(checked("e_bfmi", lowest >= BFMI, values, lowest))
    return findings


def _at_once(facts: DrawnPosterior) -> list[Finding]:
    """Return the findings on a sampler without Markov chains, from its statistics."""
    findings = []
    other = {"sampler": other_sampler()}
    if (khat := facts.khat) is not None:
        values = {"khat": khat, "limit": GOOD_KHAT}
        # NaN, the result of too few weights, is not below the limit.
        findings.append(checked("khat", khat < GOOD_KHAT, values, khat, other))
    if (size := facts.ess_weights) is not None:
        values = {"size": size, "limit": ESS}
        findings.append(checked("ess_weights", size >= ESS, values, size, other))
    if (beta := facts.inverse_temperature) is not None:
        findings.append(checked("temperature", beta >= 1, {"beta": beta}, 1 - beta, other))
    if (error := facts.quadrature_error) is not None:
        values = {"error": error, "limit": QUADRATURE}
        findings.append(checked("quadrature", converged(facts), values, error, other))
    return findings


def _budget(facts: DrawnPosterior, findings: Iterable[Finding]) -> list[Finding]:
    """Return a finding if time ran out before enough draws were made; state the time needed."""
    if (spent := facts.budget_spent_s) is None:
        return []
    sizes = [finding.number for finding in findings if finding.code in ("ess_bulk", "ess_tail")]
    least = min((size for size in sizes if size > 0), default=1.0)
    needed = float(f"{spent * max(ESS / least, 2.0):.2g}")
    return [checked("budget", False, {"spent": spent}, spent, {"budget": needed})]


def enough(draws: Draws) -> bool:
    """Return whether draws pass all convergence checks of a verdict."""
    finite = all(np.all(np.isfinite(values)) for values in draws.values())
    return finite and all(finding.status != "failed" for finding in _convergence(draws))


def converged(facts: DrawnPosterior) -> bool:
    """Return whether a quadrature's stated error is small enough to serve as a reference."""
    return facts.quadrature_error is not None and facts.quadrature_error <= QUADRATURE


def _fit(chi_square: float, dof: int) -> Finding:
    ratio = chi_square / dof if dof > 0 else float("nan")
    low, high = CHI_SQUARE
    values = {"ratio": ratio, "low": low, "high": high}
    return checked("chi_square", low <= ratio <= high, values, ratio)


class ModeSplit(NamedTuple):
    """A quantity whose posterior has two modes, and the depth of the valley between them.

    `depth` is relative to the lower peak's density. `weight` is the share of the draws below the
    valley. Its `error` is NaN if too few chains cross, so that the share depends on the starts.
    """

    name: str
    below: float
    above: float
    weight: float
    error: float
    depth: float


def deepest_split(draws: Draws) -> ModeSplit | None:
    """Return the quantity whose posterior has the most clearly separate modes, or None.

    Each side must clearly have more than 2 % of the draws, because fewer are a tail. Modes that
    overlap in every marginal are not detected.
    """
    valleys = [_valley(name, values) for name, values in draws.items()]
    return min(filter(None, valleys), key=lambda split: split.depth, default=None)


def _valley(name: str, values: Float[np.ndarray, "chain draw"]) -> ModeSplit | None:
    flat = values.ravel()
    if np.ptp(flat) == 0:
        return None
    ess = diagnose(values)["ess_bulk"]
    count = np.clip(np.nan_to_num(ess), min(FEWEST, flat.size), flat.size)
    grid = np.linspace(flat.min(), flat.max(), NUM_POINTS)
    density = gaussian_kde(flat, bw_method=count**-0.2)(grid)
    peak_below = np.maximum.accumulate(density)
    peak_above = np.maximum.accumulate(density[::-1])[::-1]
    depth = density / np.minimum(peak_below, peak_above)
    share = np.searchsorted(np.sort(flat), grid) / flat.size
    # Few draws of a heavy tail form clumps, so the smaller mode must exceed its standard error.
    error = np.maximum(np.sqrt(share * (1 - share) / count), _repeated(flat, grid))
    depth[np.minimum(share, 1 - share) - SURE_SIDE * error < LEAST_SIDE] = 1.0
    i = int(np.argmin(depth))
    if depth[i] >= DEPTH:
        return None
    below = float(grid[np.argmax(density[: i + 1])])
    above = float(grid[i + 1 + np.argmax(density[i + 1 :])])
    side = (values < grid[i]).astype(float)
    return ModeSplit(name, below, above, float(side.mean()), _error(side), float(depth[i]))


def _repeated(
    values: Float[np.ndarray, " draw"], grid: Float[np.ndarray, " place"]
) -> Float[np.ndarray, " place"]:
    r"""Return the standard error of the share s of draws below a value, if draws are repeated.

    $$(1 - s)^2 \sum_{below} w^2 + s^2 \sum_{above} w^2$$
    """
    points, times = np.unique(values, return_counts=True)
    weights = times / values.size
    share, squares = (np.concatenate([[0.0], np.cumsum(x)]) for x in (weights, weights**2))
    at = np.searchsorted(points, grid)
    s, below = share[at], squares[at]
    return np.sqrt((1 - s) ** 2 * below + s**2 * (squares[-1] - below))


def _error(side: Float[np.ndarray, "chain draw"]) -> float:
    """Return the standard error of a mode's weight; NaN if the chains disagree on the weight."""
    row = diagnose(side)
    crossed = row["ess_bulk"] >= CROSSED and not row["r_hat"] >= AGREED
    return float(side.std() / np.sqrt(row["ess_bulk"])) if crossed else float("nan")


def modes_findings(draws: Draws) -> list[Finding]:
    """Return findings on the weights of modes, and on quantities with two modes.

    Two modes with known weights are two solutions of the data; no mean or interval describes them.
    """
    split = deepest_split(draws)
    if split is None:
        return [Finding("crossing", "ok", {}, 0.0)]
    peaks = {
        "name": split.name, "below": split.below, "above": split.above, "weight": split.weight,
    }  # fmt: skip
    smaller = min(split.weight, 1 - split.weight)
    if np.isnan(split.error):
        return [Finding("crossing", "failed", peaks, smaller)]
    weighed = {**peaks, "rest": 1 - split.weight, "error": split.error}
    return [
        Finding("crossing", "ok", {"name": split.name}, split.error, entry="crossing.weighed"),
        Finding("modes", "failed", weighed, smaller),
    ]
