"""Boxes that nobody stated and that the posterior leans on: widened, once."""

from collections.abc import Container
from dataclasses import replace

import xarray as xr

from jbw.identification.prepare import Fitted, refit
from jbw.inference.posterior.summary import scalars
from jbw.inference.posterior.verdict import leaning
from jbw.inference.space.box import bounds_by_name, box
from jbw.oscillator.laws import quantities_of, vocabulary
from jbw.quantities import OSCILLATOR, RESIDUAL_TERMS

NEARER = 0.1  # of a bound's distance from the least value that makes sense


def widened(tree: xr.DataTree, ready: Fitted, stated: Container[str]) -> Fitted | None:
    """What to sample again: the fit in a box twice as wide where draws lean on it; or None.

    Bounds that the campaign states are kept.
    """
    bounds, moved = bounds_by_name(ready.box), []
    known = (*OSCILLATOR, *RESIDUAL_TERMS, *quantities_of(ready.data.laws))
    table = vocabulary() | {one.name: one for one in known}
    for name, side, _ in leaning(scalars(tree), ready.box):
        quantity = table.get(name)
        # A share of the stiffness ends where nothing but the joint holds: at its upper bound it
        # says that products alone are known.
        ends = quantity is not None and quantity.is_share and side == "upper"
        if name in stated or ends:
            continue
        least = None if quantity is None else quantity.least
        bounds[name] = _wider(*bounds[name], side, least)
        moved.append(f"{name} to [{bounds[name][0]:.3g}, {bounds[name][1]:.3g}]")
    if not moved:
        return None
    wide = box(bounds)
    said = (
        f"The posterior leant on a bound that the campaign does not state: {', '.join(moved)}, it "
        "was sampled again."
    )
    return replace(
        ready,
        box=wide,
        fit=refit(ready.fit, wide, ready.data),
        statements=(*ready.statements, said),
    )


def _wider(low: float, high: float, side: str, least: float | None) -> tuple[float, float]:
    """Bounds twice as wide on a side; the lower stays above the least, what is positive so."""
    if side == "upper":
        return low, high + (high - low)
    end = 0.0 if least is None and low > 0.0 else least
    further = low - (high - low)
    return further if end is None else max(further, end + NEARER * (low - end)), high
