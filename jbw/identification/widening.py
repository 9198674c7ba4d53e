"""Boxes that nobody stated and that the posterior leans on: widened, once."""

from collections.abc import Container
from dataclasses import replace

import xarray as xr

from jbw.identification.prepare import Fitted, refit
from jbw.inference.posterior.remedies import wider
from jbw.inference.posterior.summary import scalars
from jbw.inference.posterior.verdict import leaning
from jbw.inference.space.box import Box, bounds_by_name, box
from jbw.observables.residual_terms import MODES
from jbw.oscillator.laws import quantities_of, vocabulary
from jbw.oscillator.modes.parameters import own_quantities
from jbw.quantities import LINEAR, MODAL, RESIDUAL_TERMS, Quantity
from jbw.quantities import MODES as BESIDE
from jbw.report.messages import posterior as messages

Laws = tuple[str, ...]

# A neighbour's frequency and damping, which would wander off to mend the joint's law.
PLACES = frozenset(name for omega, zeta, _ in MODES for name in (omega, zeta))
# Of further modes at the joint, which keep their places, and whose sizes have priors of their own.
KEPT = PLACES | {quantity.name for mode in BESIDE for quantity in (mode[0], *mode[3:])}


def ending(prior: Box, laws: Laws) -> tuple[str, ...]:
    """Parameters of a box that end at their upper bound by themselves: shares of the stiffness.

    A share ends where nothing but the joint holds: there it says that products alone are known.
    """
    by_name = _known(laws)
    return tuple(name for name in prior.names if name in by_name and by_name[name].is_share)


def _known(laws: Laws) -> dict[str, Quantity]:
    """Quantities by name: the register's, those of laws that carry numbers in their name too."""
    table = (*LINEAR, *RESIDUAL_TERMS, *MODAL, *quantities_of(laws), *own_quantities(laws))
    return vocabulary() | {quantity.name: quantity for quantity in table}


def widened(tree: xr.DataTree, ready: Fitted, stated: Container[str]) -> Fitted | None:
    """What to sample again: the fit in a box twice as wide where draws lean on it; or None.

    Bounds that the campaign states are kept.
    """
    bounds, sides = bounds_by_name(ready.box), {}
    by_name, ends = _known(ready.data.laws), ending(ready.box, ready.data.laws)
    for name, side, _ in leaning(scalars(tree), ready.box):
        stays = name in stated or name in KEPT or (side == "upper" and name in ends)
        if not stays:
            sides.setdefault(name, []).append(side)
    for name, leant_on in sides.items():
        bounds[name] = wider(
            bounds[name], leant_on, by_name[name].least if name in by_name else None
        )
    moved = [f"{name} to [{bounds[name][0]:.3g}, {bounds[name][1]:.3g}]" for name in sides]
    if not moved:
        return None
    wide = box(bounds)
    statement = messages.widened(moved)
    return replace(
        ready,
        box=wide,
        fit=refit(ready.fit, wide, ready.data),
        statements=(*ready.statements, statement),
    )
