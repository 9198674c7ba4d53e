"""Boxes that nobody stated and that the posterior leans on: widened, once."""

from collections.abc import Container
from dataclasses import replace

import xarray as xr

from jbw.identification.prepare import Fitted, refit
from jbw.inference.posterior.remedies import wider
from jbw.inference.posterior.summary import scalars
from jbw.inference.posterior.verdict import leaning
from jbw.inference.space.box import Box, bounds_by_name, box
from jbw.oscillator.laws import vocabulary
from jbw.quantities import OSCILLATOR, RESIDUAL_TERMS

# A share of the stiffness ends where nothing but the joint holds: at its upper bound it says that
# products alone are known.
SHARES = ("1/s^2", "1")


def ending(prior: Box) -> tuple[str, ...]:
    """Parameters of a box that end at their upper bound by themselves: shares of the stiffness."""
    table = {one.name: one for one in (*OSCILLATOR, *RESIDUAL_TERMS)} | vocabulary()
    shares = (name for name in prior.names if name in table and table[name].unit in SHARES)
    return tuple(name for name in shares if name != "zeta")


def widened(tree: xr.DataTree, ready: Fitted, stated: Container[str]) -> Fitted | None:
    """What to sample again: the fit in a box twice as wide where draws lean on it; or None.

    Bounds that the campaign states are kept.
    """
    bounds, sides = bounds_by_name(ready.box), {}
    for name, side, _ in leaning(scalars(tree), ready.box):
        if name not in stated and not (side == "upper" and name in ending(ready.box)):
            sides.setdefault(name, []).append(side)
    bounds |= {name: wider(bounds[name], each) for name, each in sides.items()}
    moved = [f"{name} to [{bounds[name][0]:.3g}, {bounds[name][1]:.3g}]" for name in sides]
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
