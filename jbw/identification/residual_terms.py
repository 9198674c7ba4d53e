r"""Residual terms of modes outside the band, which a campaign states or a fit needs.

A fit without misfit beyond noise needs no terms. Otherwise terms are kept if the fit with them has
a clearly smaller residual,

$$\chi^2_{without} - \chi^2_{with} > 25, \qquad
  1 - \chi^2_{with} / \chi^2_{without} > 0.1$$

where only independent values count: five standard deviations, and a tenth of the misfit. The
constants of modes outside the band are tried first, then one more neighbouring mode if it would
explain most of the residual. Neighbours that `modes` states are tried before them. They are known
to exist, so a tenth of the misfit is enough for them.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from jbw.campaign.settings import Identify
from jbw.identification.causes import MOSTLY, other_mode
from jbw.inference.fit.fitting import Fit
from jbw.inference.space.box import Box, bounds_by_name, box
from jbw.observables.dataset import Dataset, residual_by_label
from jbw.observables.effective_values import is_coloured
from jbw.observables.residual_terms import (
    LOWER,
    MODES,
    OF_MODES,
    TAKEN,
    UPPER,
    bounds,
    neighbours_of,
)
from jbw.quantities import BY_NAME
from jbw.report.messages import residuals as messages

# A term is kept if its omission increases chi-square by at least this much: absolute and relative
# increase.
GROWTH, SHARE = 25.0, 0.1
TRIED = ((UPPER,), (UPPER, LOWER))
# factors on the stated frequency of a neighbouring mode with which fits are tried
ABOUT = np.linspace(0.97, 1.03, 7)
USUAL_ZETA = 0.01  # starting damping ratio of a neighbouring mode if no spectrum shows it

Refit = Callable[..., Fit]
Bounds = dict[str, tuple[float, float]]


class Taken(NamedTuple):
    """The prior with the accepted residual terms, the fit with them, and sentences on them."""

    box: Box
    fit: Fit
    words: tuple[str, ...] = ()


def stated_terms(data: Dataset) -> tuple[str, ...]:
    """Return the names of the constant residual terms that a campaign's tests request."""
    stated = {name for p in data.parts if p.residuals != "auto" for name in TAKEN[p.residuals]}
    return tuple(name for name in (UPPER, LOWER) if name in stated)


def term_bounds(
    names: tuple[str, ...], omega_n: float, given: Mapping[str, tuple[float, float]]
) -> Bounds:
    """Return the bounds of constant residual terms: the stated ones, or wide defaults."""
    wide = bounds(omega_n)
    return {name: given.get(name, wide[name]) for name in names}


def terms_of(prior: Box) -> Bounds:
    """Return the bounds of the residual terms in a prior box, by name."""
    return {n: pair for n, pair in bounds_by_name(prior).items() if n in (UPPER, LOWER, *OF_MODES)}


def with_terms(prior: Box, terms: Bounds) -> Box:
    """Return prior bounds with residual terms added."""
    return box(bounds_by_name(prior) | terms)


def shown_terms(
    best: Fit, prior: Box, data: Dataset, settings: Identify, refit: Refit
) -> Taken | None:
    """Add the residual terms that a fit needs, and fit again; None if it needs none."""
    # With several measured points, a term could not be assigned to one of them.
    several = data.modes is not None and data.modes.points
    if several or "omega_n" not in data.held | best.theta:
        return None
    accepted = Taken(prior, best)
    for hz in settings.modes[1:] if isinstance(settings.modes, tuple) else ():
        accepted = _with_neighbour(accepted, data, settings, refit, 2 * np.pi * hz)
    accepted = _with_constants(accepted, data, refit)
    accepted = _with_neighbour(accepted, data, settings, refit)
    return accepted if accepted.words else None


def _with_constants(accepted: Taken, data: Dataset, refit: Refit) -> Taken:
    """Add constant residual terms if they improve the fit and the campaign states none."""
    omega_n = float({**data.held, **accepted.fit.theta}["omega_n"])
    if {UPPER, LOWER} & set(accepted.box.names) or not _misses(accepted.fit, data, ("auto",)):
        return accepted
    chosen, before = accepted, accepted.fit
    for names in TRIED:
        wider = with_terms(accepted.box, term_bounds(names, omega_n, {}))
        wider_fit = refit(accepted.fit, wider, data)
        if not _falls(before, wider_fit):
            break
        sentence = _constants_sentence(names, wider_fit, 1 - wider_fit.cost / accepted.fit.cost)
        chosen, before = Taken(wider, wider_fit, (*accepted.words, sentence)), wider_fit
    return chosen


def _with_neighbour(
    accepted: Taken, data: Dataset, settings: Identify, refit: Refit, omega: float | None = None
) -> Taken:
    """Add a neighbouring mode if it is stated, or if it explains most of the residual."""
    neighbours = neighbours_of(accepted.fit.theta)
    takers = tuple(name for name, terms in TAKEN.items() if set(OF_MODES) & set(terms))
    if len(neighbours) == len(MODES) or not _misses(accepted.fit, data, takers):
        return accepted
    theta = {**data.held, **accepted.fit.theta}
    start = _start(accepted.fit, data, omega)
    if start is None:
        return accepted
    names, wide = MODES[len(neighbours)], bounds(float(theta["omega_n"]), (*neighbours, start[0]))
    mode_terms = [name for mode in MODES[: len(neighbours) + 1] for name in mode]
    wider = with_terms(
        accepted.box, {name: settings.prior.get(name, wide[name]) for name in mode_terms}
    )
    begun = {**accepted.fit.theta, **dict(zip(names, start, strict=True))}
    wider_fit = refit(accepted.fit, wider, data, theta=begun)
    if not _falls(accepted.fit, wider_fit, GROWTH if omega is None else 0.0):
        return accepted
    omega_next, zeta, share = (wider_fit.theta[name] for name in names)
    falls = 1 - wider_fit.cost / accepted.fit.cost
    sentence = messages.neighbour(omega_next / (2 * np.pi), zeta, share, falls)
    return Taken(wider, wider_fit, (*accepted.words, sentence))


def _start(best: Fit, data: Dataset, omega: float | None) -> tuple[float, float, float] | None:
    """Return starting frequency, damping and relative gain of a neighbouring mode, or None."""
    cause = other_mode(best, data, () if omega is None else omega * ABOUT)
    if cause is None or cause.mode is None:
        return None if omega is None else (omega, USUAL_ZETA, 0.0)
    if omega is None and cause.explained < MOSTLY:
        return None
    gain = float({**data.held, **best.theta}.get("gain", 1.0))
    place, zeta, residue = cause.mode
    return place, zeta, residue / gain


def _falls(before: Fit, after: Fit, growth: float = GROWTH) -> bool:
    """Return whether chi-square falls clearly: by more than `growth`, and by more than a tenth."""
    gained = 2 * (before.cost - after.cost)
    return gained > growth and gained > SHARE * 2 * before.cost


def _misses(best: Fit, data: Dataset, takers: tuple[str, ...]) -> bool:
    """Return whether residuals are correlated in data that may have terms of other modes."""
    residuals = residual_by_label(best.residual, data)
    labels = (
        label for part in data.parts if part.residuals in takers for label in part.groups.labels
    )
    return any(label in residuals and is_coloured(residuals[label]) for label in labels)


def _constants_sentence(names: tuple[str, ...], fit: Fit, share: float) -> str:
    terms = " and ".join(
        f"{BY_NAME[name].meaning} ({name} = {fit.theta[name]:.3g} {BY_NAME[name].unit})".replace(
            " 1)", ")"
        )
        for name in names
    )
    return messages.outside_band(terms, share)
