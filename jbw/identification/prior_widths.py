"""How much evidence hangs on the width of the priors: the same law in a box twice as wide.

A parameter that the data narrow costs ln 2 = 0.69 nats, one that they leave open nothing, and one
that they push against its bound gains; so the evidence is integrated again and not corrected.
"""

from collections.abc import Collection
from dataclasses import replace

import jax
import xarray as xr
from jaxtyping import Array, Key

from jbw.identification.evidence import Candidate, place_of
from jbw.identification.unseen_runs import weighed_in
from jbw.inference.posterior.verdict import GOOD_KHAT
from jbw.inference.samplers.ladder import about_draws
from jbw.inference.space.box import Box, bounds_by_name, box
from jbw.oscillator.laws import quantities_of


def twice_as_wide(prior: Box, laws: tuple[str, ...], stated: Collection[str] = ()) -> Box:
    """The box with those of the laws' own parameters twice as wide.

    About zero where both signs are possible, otherwise upwards. A part of omega_n^2 has no wider
    prior: it ends where nothing but the joint holds; nor has one whose density is `stated`.
    """
    bounds = bounds_by_name(prior)
    for quantity in quantities_of(laws):
        if quantity.name in bounds and not (quantity.is_share or quantity.name in stated):
            low, high = bounds[quantity.name]
            has_both_signs = quantity.least is None and low < 0.0 < high
            bounds[quantity.name] = (
                (2.0 * low, 2.0 * high) if has_both_signs else (low, 2.0 * high - low)
            )
    return box(bounds)


def log_evidence_wide(key: Key[Array, ""], one: Candidate, draws: xr.DataTree) -> float | None:
    """Log evidence in the wider box [nats]; None where its weights cannot be trusted.

    By points about the fit, or about the moments of the posterior's draws where these are worth
    more.
    """
    data, best, prior = one.fitted.data, one.fitted.fit, one.fitted.box
    wide, log_evidence = (
        twice_as_wide(prior, one.laws, data.stated.names),
        draws.attrs.get("log_evidence"),
    )
    if log_evidence is None or bounds_by_name(wide) == bounds_by_name(prior):
        return log_evidence
    about_fit = place_of(best, replace(one, fitted=replace(one.fitted, box=wide)))
    parametrisations = {
        "fit": lambda: about_fit,
        "draws": lambda: about_draws(draws, wide, about_fit),
    }
    weighed = weighed_in(jax.random.fold_in(key, 2), wide, data, parametrisations)
    return weighed.log_evidence if weighed.khat < GOOD_KHAT else None
