"""Widening of default prior bounds that a fit or a posterior reaches."""

from collections.abc import Callable, Container, Iterable, Sequence
from dataclasses import replace

import xarray as xr

from jbw.identification.prepare import Fitted, refit
from jbw.inference.posterior.remedies import wider
from jbw.inference.posterior.summary import scalars
from jbw.inference.posterior.verdict import leaning
from jbw.inference.space.box import Box, bounds_by_name, box
from jbw.observables import dataset
from jbw.observables.residual_terms import MODES
from jbw.oscillator.law import Bounds, Scales
from jbw.oscillator.laws import quantities_of, vocabulary
from jbw.oscillator.modes.parameters import own_quantities
from jbw.oscillator.oscillator import prior_of
from jbw.quantities import LINEAR, MODAL, RESIDUAL_TERMS, Quantity
from jbw.quantities import MODES as BESIDE
from jbw.report.messages import posterior as messages

Laws = tuple[str, ...]

# With wider bounds, the frequency and damping of a neighbouring mode would move far away and hide
# an error of the law.
PLACES = frozenset(name for omega, zeta, _ in MODES for name in (omega, zeta))
# Parameters whose bounds are never widened: also the frequencies of additional modes that move the
# joint, and the joint's motion in these modes, which has a separate prior.
KEPT = PLACES | {quantity.name for mode in BESIDE for quantity in (mode[0], *mode[3:])}


def ending(prior: Box, laws: Laws) -> tuple[str, ...]:
    """Return the parameters that may end at their upper bound: shares of the whole stiffness.

    A share ends where the joint provides the whole stiffness. A posterior at this end means that
    only products are determined.
    """
    by_name = _known(laws)
    return tuple(name for name in prior.names if name in by_name and by_name[name].is_share)


def _known(laws: Laws) -> dict[str, Quantity]:
    """Return all quantities of the model and of its laws by name."""
    table = (*LINEAR, *RESIDUAL_TERMS, *MODAL, *quantities_of(laws), *own_quantities(laws))
    return vocabulary() | {quantity.name: quantity for quantity in table}


def widened(tree: xr.DataTree, ready: Fitted, stated: Container[str]) -> Fitted | None:
    """Return the fit with a wider prior if draws reach a default bound, or else None.

    Bounds that the campaign states are kept.
    """
    leant_on = ((name, side) for name, side, _ in leaning(scalars(tree), ready.box))
    return _refitted(ready, leant_on, stated, messages.widened)


def widened_by_fit(ready: Fitted, stated: Container[str]) -> Fitted | None:
    """Return the fit with a wider prior if it ends at a default bound, or else None.

    Bounds that the campaign states are kept, and so are lower bounds of zero, where a quantity
    ends.
    """
    bounds = bounds_by_name(ready.box)
    reached = (
        (name, side)
        for name, side in ready.fit.at_bound.items()
        if side == "upper" or bounds[name][0] != 0.0
    )
    return _refitted(ready, reached, stated, messages.widened_fit)


def _refitted(
    ready: Fitted,
    reached: Iterable[tuple[str, str]],
    stated: Container[str],
    said: Callable[[Sequence[str]], str],
) -> Fitted | None:
    """Widen the prior at the reached bounds and fit again; None if no bound can be widened.

    They move by the width of the box, or to the default bound for the weakest record alone if that
    is farther, so that a stronger record does not determine the box.
    """
    bounds, sides = bounds_by_name(ready.box), {}
    by_name, ends = _known(ready.data.laws), ending(ready.box, ready.data.laws)
    for name, side in reached:
        stays = name in stated or name in KEPT or (side == "upper" and name in ends)
        if not stays:
            sides.setdefault(name, []).append(side)
    if not sides:
        return None
    of_weakest = _bounds_of_weakest(ready)
    for name, leant_on in sides.items():
        least = by_name[name].least if name in by_name else None
        low, high = wider(bounds[name], leant_on, least)
        weakest = of_weakest.get(name, (low, high))
        bounds[name] = (
            min(low, weakest[0]) if "lower" in leant_on else low,
            max(high, weakest[1]) if "upper" in leant_on else high,
        )
    moved = [f"{name} to [{bounds[name][0]:.3g}, {bounds[name][1]:.3g}]" for name in sides]
    wide = box(bounds)
    return replace(
        ready,
        box=wide,
        fit=refit(ready.fit, wide, ready.data),
        statements=(*ready.statements, said(moved)),
    )


def _bounds_of_weakest(ready: Fitted) -> Bounds:
    """Return default bounds of the laws' parameters for the motion of the weakest record."""
    data = ready.data
    theta = {**data.held, **ready.fit.theta}
    if data.modes is not None or not {"omega_n", "zeta"} <= theta.keys():
        return {}
    omega_n, zeta = float(theta["omega_n"]), float(theta["zeta"])
    peak = dataset.smallest_displacement(data, omega_n)
    forced = all("zeta" not in part.informs for part in data.parts)
    return prior_of(data.laws, Scales(omega_n, zeta, peak, forced)) if peak > 0 else {}
