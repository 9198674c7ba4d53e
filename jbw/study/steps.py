"""The procedure in one table: each step's verdict and how well its chains mixed."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray as xr


def steps_group(record: Mapping[str, Any]) -> xr.Dataset:
    """What the summary says of each step, for the flow diagram.

    Args:
        record: What `summary.json` holds.

    Returns:
        Over (step): `verdict`, the least effective draws `ess` [-] and the largest `r_hat` [-]; NaN
        where a step drew nothing. No durations: equal runs leave equal groups.
    """
    steps = record["steps"]
    rows = [
        (
            str((step.get("verdict") or {}).get("status", "")),
            _extreme(step, "ess_bulk", min),
            _extreme(step, "r_hat", max),
        )
        for step in steps.values()
    ]
    verdict, ess, r_hat = zip(*rows, strict=True)
    return xr.Dataset(
        {
            "verdict": ("step", np.asarray(verdict, object)),
            "ess": ("step", np.asarray(ess, float), {"units": "1"}),
            "r_hat": ("step", np.asarray(r_hat, float), {"units": "1"}),
        },
        {"step": np.asarray(list(steps), object)},
        {"main": str(record["main"])},
    )


def _extreme(step: Mapping[str, Any], what: str, choose: Callable[..., float]) -> float:
    """Return the worst number of a step's parameters, NaN where none was drawn."""
    values = [facts.get(what) for facts in (step.get("parameters") or {}).values()]
    known = [float(value) for value in values if value is not None]
    return choose(known) if known else float("nan")
