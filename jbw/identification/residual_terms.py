r"""Residual terms of modes outside the band: where a campaign states them, or a fit shows them.

A fit that leaves no more than noise asks for none. Otherwise a term stays where the fit with it
leaves clearly less,

$$\chi^2_{without} - \chi^2_{with} > 25, \qquad
  1 - \chi^2_{with} / \chi^2_{without} > 0.1$$

with the values counted as independent ones: five standard deviations, and a tenth of the misfit.
"""

from collections.abc import Callable, Mapping

from jbw.inference.fit.fitting import Fit
from jbw.inference.space.box import Box, bounds_by_name, box
from jbw.observables.dataset import Dataset, left_by_label
from jbw.observables.effective_values import is_coloured
from jbw.observables.residual_terms import LOWER, TAKEN, UPPER, bounds
from jbw.quantities import BY_NAME

GROWTH, SHARE = 25.0, 0.1  # of chi-square without a term, at least
TRIED = ((UPPER,), (UPPER, LOWER))

Refit = Callable[[Fit, Box, Dataset], Fit]


def stated_terms(data: Dataset) -> tuple[str, ...]:
    """Terms that tests of a campaign ask for."""
    asked = {name for p in data.parts if p.residuals != "auto" for name in TAKEN[p.residuals]}
    return tuple(name for name in (UPPER, LOWER) if name in asked)


def term_bounds(
    names: tuple[str, ...], omega_n: float, given: Mapping[str, tuple[float, float]]
) -> dict[str, tuple[float, float]]:
    """Bounds of terms by name: those that a campaign gives, else wide ones."""
    wide = bounds(omega_n)
    return {name: given.get(name, wide[name]) for name in names}


def terms_of(prior: Box) -> tuple[str, ...]:
    """Terms among what is inferred."""
    return tuple(name for name in (UPPER, LOWER) if name in prior.names)


def with_terms(prior: Box, names: tuple[str, ...], omega_n: float) -> Box:
    """A box with terms besides, within wide bounds."""
    return box(bounds_by_name(prior) | term_bounds(names, omega_n, {}))


def shown_terms(best: Fit, prior: Box, data: Dataset, refit: Refit) -> tuple[Box, Fit, str] | None:
    """The box with the terms that a fit shows, the fit with them, and a sentence; None of none."""
    omega_n = {**data.held, **best.theta}.get("omega_n")
    if terms_of(prior) or omega_n is None or not _misses(best, data):
        return None
    chosen: tuple[Box, Fit, str] | None = None
    before = 2 * best.cost
    for names in TRIED:
        wider = with_terms(prior, names, float(omega_n))
        found = refit(best, wider, data)
        gained = before - 2 * found.cost
        if not (gained > GROWTH and gained > SHARE * before):
            break
        chosen = wider, found, _sentence(names, found, 1 - found.cost / best.cost)
        before = 2 * found.cost
    return chosen


def _misses(best: Fit, data: Dataset) -> bool:
    """Whether a fit leaves more than noise of data that may take terms."""
    left = left_by_label(best.residual, data)
    own = [label for part in data.parts if part.residuals == "auto" for label in part.labels]
    return any(label in left and is_coloured(left[label]) for label in own)


def _sentence(names: tuple[str, ...], found: Fit, share: float) -> str:
    value = {name: found.theta[name] for name in names}
    told = " and ".join(
        f"{BY_NAME[name].meaning} ({name} = {x:.3g} {BY_NAME[name].unit})".replace(" 1)", ")")
        for name, x in value.items()
    )
    return (
        f"Modes outside the band are seen, and were taken in: {told}. It takes {share:.0%} off "
        'what the fit left; `residuals = "none"` in a test goes without.'
    )
