"""The numbers of a comparison of samplers, as `compare.json` holds them."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from jbw.identification.posteriors import Posterior
from jbw.inference.posterior.compare import (
    Row,
    distances,
    exact_numbers,
    furthest,
    numbers,
    reference_of,
    worst_ess,
)
from jbw.inference.posterior.verdict import converged, verdict


class Drawn(NamedTuple):
    """One sampler's draws, and the seconds of its calls.

    Attributes:
        tree: The draws of the last call.
        cold_s: The first call, compiling included.
        warm_s: The second one, with another key; None when there was none.
    """

    tree: xr.DataTree
    cold_s: float
    warm_s: float | None


def record_of(drawn: Mapping[str, Drawn], posterior: Posterior) -> dict[str, Any]:
    """The numbers of all samplers, and their distances from the reference.

    Args:
        drawn: Sampler to draws and times.
        posterior: What was drawn from.

    Returns:
        `reference`, and under `samplers` a row each.
    """
    if not drawn:
        return {"reference": None, "samplers": {}}
    rows = {name: _numbers(one.tree, posterior) for name, one in drawn.items()}
    exact = "quadrature" in drawn and converged(drawn["quadrature"].tree.attrs)
    chains = {name: row for name, row in rows.items() if name != "quadrature"} or rows
    reference = "quadrature" if exact else reference_of(chains)
    truth = exact_numbers(drawn["quadrature"].tree) if exact else rows[reference]
    for sampler, parameters in rows.items():
        if sampler != reference:
            for name, row in parameters.items():
                row |= distances(row, truth[name])
        elif exact:
            for name, row in parameters.items():
                row |= truth[name]
    base = drawn[reference].tree.attrs
    return {
        "reference": reference,
        "samplers": {
            name: _row(one, rows[name], base if name != reference else None, posterior)
            for name, one in drawn.items()
        },
    }


def _numbers(tree: xr.DataTree, posterior: Posterior) -> dict[str, Row]:
    group = tree["posterior"].to_dataset()
    return {name: numbers(group[name].values) for name in posterior.box.names}


def _row(
    one: Drawn, rows: Mapping[str, Row], base: Mapping[Any, Any] | None, posterior: Posterior
) -> dict[str, Any]:
    """One sampler in plain values."""
    attrs, ess = one.tree.attrs, worst_ess(rows)
    found = verdict(one.tree, posterior.box)
    sizes = one.tree["posterior"].to_dataset().sizes
    return {
        "draws": int(sizes["chain"] * sizes["draw"]),
        "ess": ess,
        "num_evaluations": int(attrs["num_evaluations"]),
        "wall_cold_s": round(one.cold_s, 4),
        "wall_warm_s": None if one.warm_s is None else round(one.warm_s, 4),
        "ess_per_s_cold": None if ess is None else ess / one.cold_s,
        "ess_per_s_warm": None if ess is None or one.warm_s is None else ess / one.warm_s,
        "log_evidence": attrs.get("log_evidence"),
        "log_evidence_error": attrs.get("log_evidence_error"),
        "z_log_evidence": None if base is None else _evidence_distance(attrs, base),
        "furthest": furthest(list(rows.values())),
        "verdict": found.status,
        "failed": [finding.code for finding in found.findings if finding.status == "failed"],
        "parameters": dict(rows),
    }


def _evidence_distance(attrs: Mapping[Any, Any], base: Mapping[Any, Any]) -> float | None:
    if "log_evidence" not in attrs or "log_evidence" not in base:
        return None
    error = float(np.hypot(attrs["log_evidence_error"], base["log_evidence_error"]))
    return float(attrs["log_evidence"] - base["log_evidence"]) / error if error > 0 else None
