"""Step 4 by the paper's cut: gamma alone, the earlier steps held at their means."""

from collections.abc import Mapping
from time import perf_counter
from typing import Any

import jax
import numpy as np
from jaxtyping import Key

from jbw.identification.linear import PooledFit
from jbw.identification.opening import OpeningData, log_likelihood, opening_data, residual
from jbw.identification.priors import stated
from jbw.identification.step import ATTRS, Step, finished
from jbw.inference.box import box
from jbw.inference.fitting import fit
from jbw.inference.sampling import sample

REACH = 3.0  # of delta: where gamma is looked for when the campaign states no prior


def opening_steps(
    key: Key,
    data: OpeningData,
    linear: PooledFit,
    third_order: Step,
    settings: Mapping[str, Any],
) -> dict[str, Step]:
    """Posterior of gamma by NUTS and by the paper's walk, everything else held.

    Args:
        key: Random key.
        data: The sweeps.
        linear: Step 2: omega_n and gain.
        third_order: Step 3: zeta, alpha and delta, taken at their means.
        settings: The campaign's [identify] table.

    Returns:
        The steps "opening_nuts" and "opening_paper".

    Reference:
        Eqs. (37), (41), (42).
    """
    started = perf_counter()
    means = {n: float(v.mean()) for n, v in third_order.posterior["posterior"].data_vars.items()}
    held = {"omega_n": linear.omega_n, "gain": linear.gain, **means}
    bounds = stated(settings).get("gamma", (0.0, REACH * means["delta"]))
    prior = box({"gamma": bounds})
    cut = opening_data(data.records, held, (linear.gain, np.inf))
    fit_key, *keys = jax.random.split(key, 3)
    best = fit(residual, prior, cut, starts=4, key=fit_key)
    said = (
        "Gamma is conditional on the means of Steps 2 and 3: their errors are in it, "
        "not in its interval.",
    )
    steps = {}
    for name, one, options in (
        ("opening_nuts", keys[0], _nuts(best.theta, best.covariance, settings)),
        ("opening_paper", keys[1], {"sampler": "random_walk_paper", "chain_method": "vectorized"}),
    ):
        tree = sample(one, log_likelihood, prior, cut, attrs=ATTRS, **options)
        steps[name] = finished(name, tree, prior, best, started, statements=said, held=held)
        started = perf_counter()
    return steps


def _nuts(theta: dict, covariance: np.ndarray, settings: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "num_warmup": 100,
        "num_samples": 200,
        "num_chains": settings.get("num_chains", 4),
        "start": theta,
        "covariance": covariance,
        "chain_method": "vectorized",
        "forward_mode": True,
    }
