"""Boxes that nobody stated and that the posterior leans on: widened, once."""

from collections.abc import Container
from dataclasses import replace

import xarray as xr

from jbw.identification.prepare import Fitted, refit
from jbw.inference.posterior.summary import scalars
from jbw.inference.posterior.verdict import leaning
from jbw.inference.space.box import bounds_by_name, box
from jbw.observables.drives import plain
from jbw.oscillator.laws import vocabulary
from jbw.quantities import LINEAR, RESIDUAL_TERMS

# A share of the stiffness ends where nothing but the joint holds: at its upper bound it says that
# products alone are known.
SHARES = ("1/s^2", "1")


def widened(tree: xr.DataTree, ready: Fitted, stated: Container[str]) -> Fitted | None:
    """What to sample again: the fit in a box twice as wide where draws lean on it; or None.

    Bounds that the campaign states are kept.
    """
    bounds, moved = bounds_by_name(ready.box), []
    table = {one.name: one for one in (*LINEAR, *RESIDUAL_TERMS)} | vocabulary()
    for name, side, _ in leaning(scalars(tree), ready.box):
        quantity = table.get(name)
        share = quantity is not None and plain(name) != "zeta" and quantity.unit in SHARES
        if name in stated or (share and side == "upper"):
            continue
        low, high = bounds[name]
        further = high + (high - low) if side == "upper" else low - (high - low)
        if side == "lower" and low > 0:
            further = max(further, 0.1 * low)  # what is positive stays so
        bounds[name] = (low, further) if side == "upper" else (further, high)
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
